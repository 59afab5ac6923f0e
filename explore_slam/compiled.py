"""The one way in which the package compiles a hot loop: numba, cached on disk, types kept."""

from collections.abc import Callable

import numba


def kernel[F: Callable[..., object]](function: F) -> F:
    """Compile a function of arrays and numbers at its first call; the result is cached on disk."""
    compiled: F = numba.njit(cache=True)(function)
    return compiled
