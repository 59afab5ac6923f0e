"""The one decorator of compiled functions: numba, cached on disk, types kept."""

from collections.abc import Callable
from typing import Any, Literal, overload

import numba

# LLVM flags that let a loop be split over vector lanes; results may differ in the last bits
# from one processor to another, infinities and NaN keep their meaning.
_REASSOCIATION = {'reassoc', 'nsz', 'contract'}


@overload
def kernel[F: Callable[..., Any]](function: F, /) -> F: ...


@overload
def kernel[F: Callable[..., Any]](
    *, nogil: bool = True, inline: Literal['never', 'always'] = 'never', reassociate: bool = False
) -> Callable[[F], F]: ...


def kernel(
    function: Callable[..., Any] | None = None,
    /,
    *,
    nogil: bool = True,
    inline: Literal['never', 'always'] = 'never',
    reassociate: bool = False,
) -> Any:
    """Compile a function of arrays, numbers and NamedTuples of them at its first call.

    Use it bare, `@kernel`, or with options, `@kernel(inline='always')`. Division by zero gives
    inf, NaN or integer 0 as in NumPy; no exception is raised.

    nogil: release the interpreter lock, so that threads run the function at the same time.
    inline: 'always' copies the body into compiled callers, for small functions in hot loops.
    reassociate: allow sums in another order; never where the result enters the filter's state.
    """

    def compile_it(function: Callable[..., Any]) -> Any:
        return numba.njit(
            cache=True,
            nogil=nogil,
            error_model='numpy',
            inline=inline,
            fastmath=_REASSOCIATION if reassociate else False,
        )(function)

    return compile_it if function is None else compile_it(function)
