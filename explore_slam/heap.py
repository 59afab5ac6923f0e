"""A binary heap for kernels: keys and items in two arrays, the smallest key first.

The caller keeps the size and makes sure that the arrays have room. Equal keys come out in an order
that depends on the calls alone.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel


@kernel
def push(
    keys: NDArray[Any], items: NDArray[Any], size: int, key: float, item: int | np.int64
) -> None:
    """Insert an item into a heap of a size, which then has one entry more."""
    at = size
    while at > 0:
        parent = (at - 1) >> 1
        if keys[parent] <= key:
            break
        keys[at], items[at] = keys[parent], items[parent]
        at = parent
    keys[at], items[at] = key, item


@kernel
def remove_first(keys: NDArray[Any], items: NDArray[Any], size: int) -> None:
    """Remove the first entry, which was read before; size: of the heap without it."""
    key, item = keys[size], items[size]
    at = 0
    while True:
        child = 2 * at + 1
        if child >= size:
            break
        if child + 1 < size and keys[child + 1] < keys[child]:
            child += 1
        if keys[child] >= key:
            break
        keys[at], items[at] = keys[child], items[child]
        at = child
    keys[at], items[at] = key, item
