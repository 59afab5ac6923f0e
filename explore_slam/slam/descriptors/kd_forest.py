"""Randomized kd-forest over descriptors that grows one descriptor at a time.

Several kd-trees are searched together, nearest branches first, until a number of descriptors
has been compared (Muja and Lowe, 2009). Leaves are buckets; a full bucket splits at the mean of
one of its dimensions of largest variance, drawn at random from a fixed seed: nothing is ever
rebuilt, and the same insertions give the same forest.
"""

import math

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.data import DESCRIPTOR_LENGTH
from explore_slam.slam.descriptors.index import ROUNDING, Descriptors, DescriptorTable, Ids

BUCKET = 16
_HEAP = 4096
_TOP = 5

Nodes = NDArray[np.int32]
Values = NDArray[np.float32]
Coarse = NDArray[np.int8]

# Descriptors are compared in bytes first: an eighth of the memory traffic of the exact distance.
_STEPS = 127.0
_COARSE_MARGIN = 0.02
# The halves lie apart, one cache line each: most comparisons end after the first.
_HALF = DESCRIPTOR_LENGTH // 2
_LINE = 64


@kernel(reassociate=True)
def squared_distance(
    a: Values, b: Values, bound: np.float32
) -> np.float32:  # pragma: no cover - compiled
    """Squared distance, left off at the first quarter that exceeds the bound."""
    total = np.float32(0.0)
    for begin in (0, 32, 64, 96):
        part = np.float32(0.0)
        for i in range(begin, begin + 32):
            difference = a[i] - b[i]
            part += difference * difference
        total += part
        if total > bound:
            break
    return total


@kernel
def _coarse_distance(
    a: Coarse, coarse: Coarse, item: int, bound: int
) -> np.int32:  # pragma: no cover - compiled
    """Squared distance of rounded descriptors, left off at the half that exceeds the bound."""
    total = np.int32(0)
    for half in (0, 1):
        b = coarse[half, item]
        for i in range(_HALF):
            difference = np.int32(a[half * _HALF + i]) - np.int32(b[i])
            total += difference * difference
        if total > bound:
            break
    return total


@kernel
def _find_leaf(
    nodes: Nodes, values: Values, tree: int, point: Values
) -> int:  # pragma: no cover - compiled
    node = 0
    while nodes[tree, node, 0] >= 0:
        side = 0 if point[nodes[tree, node, 0]] < values[tree, node] else 1
        node = nodes[tree, node, 1] + side
    return node


@kernel
def _next_random(state: NDArray[np.uint64]) -> np.int64:  # pragma: no cover - compiled
    """64-bit linear congruential generator (Knuth's MMIX); its upper bits."""
    state[0] = state[0] * np.uint64(6364136223846793005) + np.uint64(1442695040888963407)
    return np.int64(state[0] >> np.uint64(40))


@kernel
def _split_dimension(
    table: Values, members: Nodes, state: NDArray[np.uint64]
) -> tuple[int, float]:  # pragma: no cover - compiled
    """Return a dimension of large variance and its mean; dimension -1 where all are equal."""
    count = len(members)
    mean = np.zeros(DESCRIPTOR_LENGTH, np.float32)
    for m in members:
        mean += table[m]
    mean /= np.float32(count)
    variance = np.zeros(DESCRIPTOR_LENGTH, np.float32)
    for m in members:
        difference = table[m] - mean
        variance += difference * difference
    top = np.empty(_TOP, np.int64)
    for i in range(_TOP):
        best = int(np.argmax(variance))
        top[i] = best if variance[best] > 1e-12 else -1
        variance[best] = 0.0
    usable = 0
    while usable < _TOP and top[usable] >= 0:
        usable += 1
    if usable == 0:
        return -1, 0.0
    chosen = top[_next_random(state) % usable]
    return chosen, mean[chosen]


@kernel
def _insert(
    table: Values,
    ids: Ids,
    nodes: Nodes,
    values: Values,
    buckets: Nodes,
    used: NDArray[np.int64],
    state: NDArray[np.uint64],
) -> None:  # pragma: no cover - compiled
    """Put ids into all trees. nodes (T, n, 2): dimension and first child, or -1 and bucket.

    buckets (b, 2 + BUCKET): number of members, next bucket or -1, members.
    used: nodes per tree, then buckets.
    """
    trees = len(nodes)
    for item in ids:
        for tree in range(trees):
            node = _find_leaf(nodes, values, tree, table[item])
            bucket = nodes[tree, node, 1]
            if buckets[bucket, 0] == BUCKET and buckets[bucket, 1] < 0:
                members = buckets[bucket, 2 : 2 + BUCKET].copy()
                dimension, value = _split_dimension(table, members, state)
                if dimension >= 0:
                    child = used[tree]
                    used[tree] += 2
                    other = used[trees]
                    used[trees] += 1
                    nodes[tree, node, 0] = dimension
                    nodes[tree, node, 1] = child
                    values[tree, node] = value
                    nodes[tree, child, 0] = -1
                    nodes[tree, child, 1] = bucket
                    nodes[tree, child + 1, 0] = -1
                    nodes[tree, child + 1, 1] = other
                    buckets[bucket, 0] = 0
                    buckets[other, 0] = 0
                    buckets[other, 1] = -1
                    for m in members:
                        home = bucket if table[m, dimension] < value else other
                        buckets[home, 2 + buckets[home, 0]] = m
                        buckets[home, 0] += 1
                    bucket = bucket if table[item, dimension] < value else other
            while buckets[bucket, 0] == BUCKET:
                if buckets[bucket, 1] < 0:
                    buckets[bucket, 1] = used[trees]
                    buckets[used[trees], 0] = 0
                    buckets[used[trees], 1] = -1
                    used[trees] += 1
                bucket = buckets[bucket, 1]
            buckets[bucket, 2 + buckets[bucket, 0]] = item
            buckets[bucket, 0] += 1


@kernel
def _remove(
    table: Values, ids: Ids, nodes: Nodes, values: Values, buckets: Nodes
) -> None:  # pragma: no cover - compiled
    for item in ids:
        for tree in range(len(nodes)):
            bucket = nodes[tree, _find_leaf(nodes, values, tree, table[item]), 1]
            while bucket >= 0:
                count = buckets[bucket, 0]
                for i in range(count):
                    if buckets[bucket, 2 + i] == item:
                        buckets[bucket, 2 + i] = buckets[bucket, 1 + count]
                        buckets[bucket, 0] = count - 1
                        break
                bucket = buckets[bucket, 1]


@kernel
def _push(
    keys: Values, places: Nodes, size: int, key: float, tree: int, node: int
) -> int:  # pragma: no cover - compiled
    """Push on a binary heap; the nearest branch comes out first. A full heap takes no more."""
    if size >= _HEAP:
        return size
    i = size
    while i > 0:
        parent = (i - 1) >> 1
        if keys[parent] <= key:
            break
        keys[i] = keys[parent]
        places[i] = places[parent]
        i = parent
    keys[i] = key
    places[i, 0] = tree
    places[i, 1] = node
    return size + 1


@kernel
def _pop(keys: Values, places: Nodes, size: int) -> int:  # pragma: no cover - compiled
    """Remove the first of the heap (read it before)."""
    size -= 1
    key = keys[size]
    tree, node = places[size, 0], places[size, 1]
    i = 0
    while True:
        child = 2 * i + 1
        if child >= size:
            break
        if child + 1 < size and keys[child + 1] < keys[child]:
            child += 1
        if keys[child] >= key:
            break
        keys[i] = keys[child]
        places[i] = places[child]
        i = child
    keys[i] = key
    places[i, 0] = tree
    places[i, 1] = node
    return size


@kernel
def _search(  # noqa: C901 - a kernel
    table: Values,
    coarse: Coarse,
    queries: Values,
    nodes: Nodes,
    values: Values,
    buckets: Nodes,
    stamps: Nodes,
    radius: float,
    checks: int,
    ids: Ids,
    distances: Values,
) -> None:  # pragma: no cover - compiled
    keys = np.empty(_HEAP, np.float32)
    places = np.empty((_HEAP, 2), np.int32)
    count = ids.shape[1]
    rounded = np.empty(DESCRIPTOR_LENGTH, np.int8)
    for q in range(len(queries)):
        query = queries[q]
        for i in range(DESCRIPTOR_LENGTH):
            rounded[i] = np.int8(round(query[i] * _STEPS))
        size = 0
        for tree in range(len(nodes)):
            size = _push(keys, places, size, 0.0, tree, 0)
        left = checks
        while size > 0 and left > 0:
            base = keys[0]
            tree, node = places[0, 0], places[0, 1]
            size = _pop(keys, places, size)
            bound = min(np.float32(radius), distances[q, count - 1])
            if base > bound:
                continue
            while nodes[tree, node, 0] >= 0:
                gap = query[nodes[tree, node, 0]] - values[tree, node]
                child = nodes[tree, node, 1]
                near, away = (child, child + 1) if gap < 0.0 else (child + 1, child)
                size = _push(keys, places, size, base + gap * gap, tree, away)
                node = near
            bucket = nodes[tree, node, 1]
            while bucket >= 0:
                for i in range(buckets[bucket, 0]):
                    item = buckets[bucket, 2 + i]
                    if stamps[item] == q + 1:
                        continue
                    stamps[item] = q + 1
                    left -= 1
                    bound = min(np.float32(radius), distances[q, count - 1])
                    limit = min((bound + _COARSE_MARGIN) * (_STEPS * _STEPS), 1e9)
                    if _coarse_distance(rounded, coarse, item, int(limit)) > limit:
                        continue
                    distance = squared_distance(query, table[item], bound)
                    if distance > bound or distance >= distances[q, count - 1]:
                        continue
                    place = count - 1
                    while place > 0 and distances[q, place - 1] > distance:
                        distances[q, place] = distances[q, place - 1]
                        ids[q, place] = ids[q, place - 1]
                        place -= 1
                    distances[q, place] = distance
                    ids[q, place] = item
                bucket = buckets[bucket, 1]


def _in_cache_lines(shape: tuple[int, ...]) -> Coarse:
    """Return zeros that begin at a cache line."""
    size = math.prod(shape)
    memory = np.zeros(size + _LINE, np.int8)
    begin = -memory.ctypes.data % _LINE
    return memory[begin : begin + size].reshape(shape)


class KdForestIndex(DescriptorTable):
    """Randomized kd-forest: log N per query, recall near one; see DescriptorIndex."""

    def __init__(self, trees: int = 4, checks: int = 256, seed: int = 1) -> None:
        super().__init__()
        self.checks = checks
        self.coarse = np.zeros((2, 0, _HALF), np.int8)
        self.nodes = np.full((trees, 1, 2), -1, np.int32)
        self.values = np.zeros((trees, 1), np.float32)
        self.buckets = np.zeros((trees, 2 + BUCKET), np.int32)
        self.buckets[:, 1] = -1
        self.nodes[:, 0, 1] = np.arange(trees)
        self.used = np.array([1] * trees + [trees], np.int64)
        self.state = np.array([seed], np.uint64)

    def add(self, ids: Ids, descriptors: Descriptors) -> None:
        """See DescriptorIndex."""
        self.store(ids, descriptors)
        self.round_table(ids)
        trees = len(self.nodes)
        nodes = int(self.used[:trees].max()) + 2 * len(ids)
        if nodes > self.nodes.shape[1]:
            extra = nodes + nodes // 2 - self.nodes.shape[1]
            self.nodes = np.pad(self.nodes, ((0, 0), (0, extra), (0, 0)))
            self.values = np.pad(self.values, ((0, 0), (0, extra)))
        buckets = int(self.used[trees]) + trees * len(ids)
        if buckets > len(self.buckets):
            extra = buckets + buckets // 2 - len(self.buckets)
            self.buckets = np.pad(self.buckets, ((0, extra), (0, 0)))
        _insert(self.table, ids, self.nodes, self.values, self.buckets, self.used, self.state)

    def round_table(self, ids: Ids) -> None:
        """Set the rounded descriptors of ids from the exact ones."""
        have = self.coarse.shape[1]
        if have < len(self.table):
            grown = _in_cache_lines((2, len(self.table), _HALF))
            grown[:, :have] = self.coarse
            self.coarse = grown
        rounded = np.rint(self.table[ids] * _STEPS).astype(np.int8)
        self.coarse[:, ids] = rounded.reshape(-1, 2, _HALF).transpose(1, 0, 2)

    def remove(self, ids: Ids) -> None:
        """See DescriptorIndex."""
        self.alive[ids] = False
        _remove(self.table, ids, self.nodes, self.values, self.buckets)

    def query(
        self, descriptors: Descriptors, radius: float, count: int
    ) -> tuple[Ids, NDArray[np.float32]]:
        """See DescriptorIndex; the nearest are found with a probability below one."""
        ids = np.full((len(descriptors), count), -1, np.int64)
        distances = np.full((len(descriptors), count), np.inf, np.float32)
        if len(self.table) and len(descriptors):
            stamps = np.zeros(len(self.table), np.int32)
            queries = np.ascontiguousarray(descriptors, np.float32)
            _search(
                self.table, self.coarse, queries, self.nodes, self.values, self.buckets, stamps,
                radius + ROUNDING, self.checks, ids, distances,
            )  # fmt: skip
        return ids, distances
