"""The one decorator of compiled functions: numba, cached on disk, types kept."""

import functools
import logging
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, overload

import numba

from explore_slam.environment import is_writable, scratch_folder

logger = logging.getLogger(__name__)

# LLVM flags that let a loop be split over vector lanes; results may differ in the last bits
# from one processor to another, infinities and NaN keep their meaning.
_REASSOCIATION = {'reassoc', 'nsz', 'contract'}


def _cache_folder() -> Path | None:
    """Return a folder for compiled functions where none of those that Numba uses can be written.

    Those are NUMBA_CACHE_DIR, else __pycache__ beside the source, else ~/.cache/numba. A container
    may run as a user without a home, and without rights on an installed package.
    """
    given = os.environ.get('NUMBA_CACHE_DIR')
    home = Path(os.environ.get('XDG_CACHE_HOME') or Path(os.environ.get('HOME') or '/') / '.cache')
    usual = [Path(given)] if given else [Path(__file__).parent / '__pycache__', home / 'numba']
    if any(is_writable(folder) for folder in usual):
        return None
    folder = scratch_folder() / 'numba'
    logger.warning(
        'compiled functions are kept in %s: %s cannot be written',
        folder,
        ' and '.join(map(str, usual)),
    )
    return folder


_CACHE_FOLDER = _cache_folder()
if _CACHE_FOLDER is not None:
    os.environ['NUMBA_CACHE_DIR'] = str(_CACHE_FOLDER)  # of processes that this one starts
    numba.config.CACHE_DIR = str(_CACHE_FOLDER)


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
        compiled = numba.njit(
            cache=True,
            nogil=nogil,
            error_model='numpy',
            inline=inline,
            fastmath=_REASSOCIATION if reassociate else False,
        )(function)
        _ignore_unreadable_cache(compiled)
        _ignore_unwritable_cache(compiled)
        return compiled

    return compile_it if function is None else compile_it(function)


def _ignore_unreadable_cache(compiled: Any) -> None:
    """Let a cache whose index cannot be read count as empty.

    An index names the types of arguments. When one of them has been renamed since, Numba raises
    AttributeError before it looks whether the source has changed: an update of the package would
    end in a traceback. The attributes are not part of Numba's interface; without them, nothing is
    changed.
    """
    cache_file = getattr(getattr(compiled, '_cache', None), '_cache_file', None)
    load = getattr(cache_file, '_load_index', None)
    if cache_file is None or load is None:
        return

    def load_index() -> Any:
        try:
            return load()
        except (AttributeError, ImportError, EOFError, pickle.UnpicklingError):
            return {}

    cache_file._load_index = load_index


def _ignore_unwritable_cache(compiled: Any) -> None:
    """Let a function that cannot be cached, on a full disk, be compiled again in the next run."""
    cache = getattr(compiled, '_cache', None)
    save = getattr(cache, 'save_overload', None)
    if cache is None or save is None:
        return

    def save_overload(*arguments: Any) -> None:
        try:
            save(*arguments)
        except OSError as error:
            _note_unwritable(error.strerror or str(error))

    cache.save_overload = save_overload


@functools.cache
def _note_unwritable(reason: str) -> None:
    logger.warning('compiled functions cannot be kept for the next run: %s', reason)
