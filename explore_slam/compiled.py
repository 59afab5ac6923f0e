"""The one way in which the package compiles a hot loop: numba, cached on disk, types kept."""

from collections.abc import Callable
from typing import TypeVar

import numba

F = TypeVar('F', bound=Callable[..., object])


def kernel(function: F) -> F:
    """Compile a function of arrays and numbers at its first call; the result is cached on disk."""
    compiled: F = numba.njit(cache=True)(function)
    return compiled
