"""Order in which the nodes are eliminated, and the blocks of the Cholesky factor that it gives.

Minimum degree (George and Liu, The evolution of the minimum degree ordering algorithm, 1989) on
the explicit elimination graph, which is kept as one row of bits per node: eliminating a node is
an OR of rows, a degree is a population count. The neighbours that a node has when it is
eliminated are the rows of its column of the factor.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.slam.graph.factors import Factors, Integers

Bits = NDArray[np.uint64]
_ONE, _TWO, _FOUR, _TOP = np.uint64(1), np.uint64(2), np.uint64(4), np.uint64(56)
_PAIRS = np.uint64(0x5555555555555555)
_NIBBLES = np.uint64(0x3333333333333333)
_BYTES = np.uint64(0x0F0F0F0F0F0F0F0F)
_SUM = np.uint64(0x0101010101010101)


class Structure(NamedTuple):
    """Positions of the blocks of a lower triangular factor, column by column."""

    place: Integers  # (N,) row of each node
    first: Integers  # (N + 1,) first block of each column
    rows: Integers  # (n,) row of each block below the diagonal, ascending in each column
    slots: Integers  # (F,) block that each factor adds to; −1 for factors of one node
    calibration_slots: Integers  # (F, 2) blocks of nodes a and b with the calibration; −1: none


@kernel
def _bit_count(word: np.uint64) -> np.int64:
    word = word - ((word >> _ONE) & _PAIRS)
    word = (word & _NIBBLES) + ((word >> _TWO) & _NIBBLES)
    word = (word + (word >> _FOUR)) & _BYTES
    return np.int64((word * _SUM) >> _TOP)


@kernel
def _unlink(
    node: int, degree: np.int64, head: Integers, after: Integers, before: Integers
) -> None:
    if before[node] >= 0:
        after[before[node]] = after[node]
    else:
        head[degree] = after[node]
    if after[node] >= 0:
        before[after[node]] = before[node]


@kernel
def _link(node: int, degree: np.int64, head: Integers, after: Integers, before: Integers) -> None:
    after[node], before[node] = head[degree], -1
    if head[degree] >= 0:
        before[head[degree]] = node
    head[degree] = node


@kernel
def _neighbours(row: Bits, out: Integers) -> int:
    """Write the numbers of the bits that are set, ascending; returns how many there are."""
    n = 0
    for w in range(len(row)):
        word = row[w]
        while word:
            lowest = word & (~word + _ONE)
            out[n] = 64 * w + _bit_count(lowest - _ONE)
            word = word ^ lowest
            n += 1
    return n


@kernel
def _eliminate(a: Integers, b: Integers, nodes: int) -> tuple[Integers, Integers, Integers]:
    """Return place (N,), first (N + 1,) and, per column, the neighbours as node numbers."""
    words = (nodes + 63) // 64
    graph = np.zeros((nodes, words), np.uint64)
    for f in range(len(a)):
        if a[f] >= 0 and a[f] != b[f]:
            graph[a[f], b[f] // 64] |= _ONE << np.uint64(b[f] % 64)
            graph[b[f], a[f] // 64] |= _ONE << np.uint64(a[f] % 64)
    degree = np.zeros(nodes, np.int64)
    head, after, before = np.full(nodes, -1), np.full(nodes, -1), np.full(nodes, -1)
    for n in range(nodes - 1, -1, -1):
        for w in range(words):
            degree[n] += _bit_count(graph[n, w])
        _link(n, degree[n], head, after, before)
    place, first = np.empty(nodes, np.int64), np.zeros(nodes + 1, np.int64)
    rows = np.empty(4 * len(a) + nodes, np.int64)
    near = np.empty(nodes, np.int64)
    least = np.int64(0)
    for step in range(nodes):
        while head[least] < 0:
            least += 1
        pivot = head[least]
        _unlink(pivot, least, head, after, before)
        place[pivot] = step
        count = _neighbours(graph[pivot], near)
        begin = first[step]
        first[step + 1] = begin + count
        if begin + count > len(rows):
            rows = np.concatenate((rows, np.empty(len(rows) + count, np.int64)))
        rows[begin : begin + count] = near[:count]
        for i in range(count):
            n = near[i]
            _unlink(n, degree[n], head, after, before)
            union = graph[n]
            for w in range(words):
                union[w] |= graph[pivot, w]
            union[n // 64] &= ~(_ONE << np.uint64(n % 64))
            union[pivot // 64] &= ~(_ONE << np.uint64(pivot % 64))
            total = np.int64(0)
            for w in range(words):
                total += _bit_count(union[w])
            degree[n] = total
            _link(n, total, head, after, before)
            least = min(least, total)
    return place, first, rows[: first[nodes]]


@kernel
def _sorted_rows(place: Integers, first: Integers, rows: Integers) -> None:
    """Turn node numbers into places and sort each column, in place."""
    for i in range(len(rows)):
        rows[i] = place[rows[i]]
    for j in range(len(first) - 1):
        rows[first[j] : first[j + 1]] = np.sort(rows[first[j] : first[j + 1]])


@kernel
def find_block(first: Integers, rows: Integers, row: int, column: int) -> np.int64:
    """Return the number of the block at (row, column), which must exist, by bisection."""
    low: np.int64 = first[column]
    high: np.int64 = first[column + 1]
    while high - low > 1:
        middle = (low + high) // 2
        if rows[middle] <= row:
            low = middle
        else:
            high = middle
    return low


@kernel
def _slots(a: Integers, b: Integers, place: Integers, first: Integers, rows: Integers) -> Integers:
    slots = np.full(len(a), -1, np.int64)
    for f in range(len(a)):
        if a[f] >= 0 and a[f] != b[f]:
            i, j = place[a[f]], place[b[f]]
            slots[f] = find_block(first, rows, max(i, j), min(i, j))
    return slots


def eliminate(factors: Factors, nodes: int) -> Structure:
    """Order the nodes of a graph so that its Cholesky factor stays sparse, and lay it out."""
    some = factors.c >= 0
    a = np.concatenate([factors.a, factors.a[some], factors.b[some]])
    b = np.concatenate([factors.b, factors.c[some], factors.c[some]])
    place, first, rows = _eliminate(a, b, nodes)
    _sorted_rows(place, first, rows)
    ends = [np.where(some, end, -1) for end in (factors.a, factors.b)]
    return Structure(
        place,
        first,
        rows,
        _slots(factors.a, factors.b, place, first, rows),
        np.stack([_slots(end, factors.c, place, first, rows) for end in ends], axis=1),
    )
