"""Large scratch arrays of which only what is touched takes memory."""

import mmap
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

# Smaller arrays fit into the caches of a processor, where huge pages are an advantage
_LARGE = 2**23  # bytes
_NO_HUGE_PAGES = getattr(mmap, 'MADV_NOHUGEPAGE', None)  # Linux
_RELEASE = getattr(mmap, 'MADV_DONTNEED', None)


class SparseArray:
    """Zeros (size,) until they are written; memory is taken by small pages as they are touched.

    A search touches few cells of a large grid, here and there. With the huge pages of Linux (2 MB)
    nearly the whole array would become resident all the same.
    """

    def __init__(self, size: int, dtype: DTypeLike) -> None:
        kind = np.dtype(dtype)
        self._map: mmap.mmap | None = None
        if size * kind.itemsize < _LARGE or _NO_HUGE_PAGES is None or _RELEASE is None:
            self.values: NDArray[Any] = np.zeros(size, kind)
            return
        self._map = mmap.mmap(-1, size * kind.itemsize, flags=mmap.MAP_PRIVATE)
        self._map.madvise(_NO_HUGE_PAGES)
        self.values = np.frombuffer(self._map, kind)

    def clear(self) -> None:
        """Set all to zero; what a large array takes is given back."""
        if self._map is not None and _RELEASE is not None:
            self._map.madvise(_RELEASE)
        else:
            self.values[:] = 0
