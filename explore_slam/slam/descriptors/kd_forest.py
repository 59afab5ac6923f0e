"""Randomized kd-forest over descriptors that grows one descriptor at a time.

Several kd-trees are searched together, nearest branches first, until a number of descriptors has
been compared (Muja and Lowe, "Fast approximate nearest neighbors with automatic algorithm
configuration", 2009). Leaves are buckets; a full bucket splits at the mean of one of its
dimensions
of largest variance, drawn at random from a fixed seed: nothing is ever rebuilt, and the same
insertions give the same forest.

Descriptors are compared in bytes first, a quarter of the memory traffic of the exact distance. The
two halves of the bytes lie apart, each at the beginning of a cache line: most comparisons end
after the first.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.heap import push, remove_first
from explore_slam.slam.checkpoint import State
from explore_slam.slam.descriptors.index import ROUNDING, DescriptorTable, Distances, Ids
from explore_slam.slam.descriptors.kinds import STEP, Vectors

TREES = 4  # as Muja and Lowe (2009); recall by benchmarks/slam_speed.py index
BUCKET = 16  # members per leaf
_SPLIT_AMONG = 5  # dimensions of largest variance to draw from (as FLANN, Muja and Lowe, 2009)
_HEAP = 4096  # branches remembered per query; far more than are visited
_LINE = 64  # bytes of a cache line
_MINIMUM_VARIANCE = 1e-12  # of a dimension to split at: above the rounding of float32
# Steps per unit of the rounded descriptors, and how far their squared distance may exceed the
# exact one before a landmark is ruled out: several standard deviations of the rounding error.
_STEPS = 127.0
_COARSE_MARGIN = 0.02

Nodes = NDArray[np.int32]
Values = NDArray[np.float32]
Coarse = NDArray[np.int8]


class Forest(NamedTuple):
    """The arrays of a forest of T trees over n vectors, as the kernels see them.

    table (n, D) vectors; coarse (2, n, D / 2) the same in bytes; nodes (T, N, 2): dimension and
    first child of a node, or -1 and the bucket of a leaf; values (T, N) where a node splits;
    buckets (B, 2 + BUCKET): number of members, next bucket of the leaf or -1, members.
    """

    table: Values
    coarse: Coarse
    nodes: Nodes
    values: Values
    buckets: Nodes


@kernel(reassociate=True)
def squared_distance(
    a: Values, b: Values, bound: np.float32
) -> np.float32:  # pragma: no cover - compiled
    """Return the squared distance, or a part of it above the bound, in steps of STEP numbers."""
    total = np.float32(0.0)
    for begin in range(0, len(a), STEP):
        part = np.float32(0.0)
        for i in range(begin, begin + STEP):
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
    """Return the squared distance of rounded descriptors, or its first half if above the bound."""
    total = np.int32(0)
    size = coarse.shape[2]
    for half in (0, 1):
        b = coarse[half, item]
        for i in range(size):
            difference = np.int32(a[half * size + i]) - np.int32(b[i])
            total += difference * difference
        if total > bound:
            break
    return total


@kernel
def _find_leaf(
    nodes: Nodes, values: Values, tree: int, point: Values
) -> int:  # pragma: no cover - compiled
    """Return the leaf that a vector belongs to."""
    node = 0
    while nodes[tree, node, 0] >= 0:
        side = 0 if point[nodes[tree, node, 0]] < values[tree, node] else 1
        node = nodes[tree, node, 1] + side
    return node


@kernel
def _next_random(state: NDArray[np.uint64]) -> np.int64:  # pragma: no cover - compiled
    """Return the upper bits of a 64-bit linear congruential generator (Knuth's MMIX)."""
    state[0] = state[0] * np.uint64(6364136223846793005) + np.uint64(1442695040888963407)
    return np.int64(state[0] >> np.uint64(40))


@kernel
def _split_dimension(
    table: Values, members: Nodes, state: NDArray[np.uint64]
) -> tuple[int, float]:  # pragma: no cover - compiled
    """Return a dimension of large variance and its mean; dimension -1 where all are equal."""
    count = len(members)
    mean = np.zeros(table.shape[1], np.float32)
    for m in members:
        mean += table[m]
    mean /= np.float32(count)
    variance = np.zeros(table.shape[1], np.float32)
    for m in members:
        difference = table[m] - mean
        variance += difference * difference
    top = np.empty(_SPLIT_AMONG, np.int64)
    for i in range(_SPLIT_AMONG):
        best = int(np.argmax(variance))
        top[i] = best if variance[best] > _MINIMUM_VARIANCE else -1
        variance[best] = 0.0
    usable = 0
    while usable < _SPLIT_AMONG and top[usable] >= 0:
        usable += 1
    if usable == 0:
        return -1, 0.0
    chosen = top[_next_random(state) % usable]
    return chosen, mean[chosen]


@kernel
def _insert(
    forest: Forest, ids: Ids, used: NDArray[np.int64], state: NDArray[np.uint64]
) -> None:  # pragma: no cover - compiled
    """Insert ids into all trees. used (T + 1,): nodes in use per tree, then buckets in use."""
    table, nodes, values, buckets = forest.table, forest.nodes, forest.values, forest.buckets
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
                        side = bucket if table[m, dimension] < value else other
                        buckets[side, 2 + buckets[side, 0]] = m
                        buckets[side, 0] += 1
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
def _remove(forest: Forest, ids: Ids) -> None:  # pragma: no cover - compiled
    """Remove ids from all trees; the nodes stay."""
    table, nodes, values, buckets = forest.table, forest.nodes, forest.values, forest.buckets
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
def _add_branch(
    keys: Values, branches: Ids, size: int, key: float, tree: int, node: int
) -> int:  # pragma: no cover - compiled
    """Push a branch on the heap, nearest first, and return its size; ignored if full."""
    if size >= _HEAP:
        return size
    push(keys, branches, size, key, np.int64(tree) << 32 | node)
    return size + 1


@kernel
def _search(  # noqa: C901 - a kernel
    forest: Forest,
    queries: Values,
    stamps: Nodes,
    radius: float,
    checks: int,
    ids: Ids,
    distances: Values,
) -> None:  # pragma: no cover - compiled
    """Fill ids and distances (K, C) with the nearest to queries (K, D) within the radius.

    stamps (n,): zeros, which receive the last query that a vector was compared with.
    """
    table, coarse, buckets = forest.table, forest.coarse, forest.buckets
    nodes, values = forest.nodes, forest.values
    keys = np.empty(_HEAP, np.float32)
    branches = np.empty(_HEAP, np.int64)  # tree and node, 32 bits each
    count = ids.shape[1]
    rounded = np.empty(queries.shape[1], np.int8)
    for q in range(len(queries)):
        query = queries[q]
        for i in range(queries.shape[1]):
            rounded[i] = np.int8(round(query[i] * _STEPS))
        size = 0
        for tree in range(len(nodes)):
            size = _add_branch(keys, branches, size, 0.0, tree, 0)
        left = checks
        while size > 0 and left > 0:
            base = keys[0]
            tree, node = branches[0] >> 32, branches[0] & 0xFFFFFFFF
            size -= 1
            remove_first(keys, branches, size)
            bound = min(np.float32(radius), distances[q, count - 1])
            if base > bound:
                continue
            while nodes[tree, node, 0] >= 0:
                gap = query[nodes[tree, node, 0]] - values[tree, node]
                child = nodes[tree, node, 1]
                near, away = (child, child + 1) if gap < 0.0 else (child + 1, child)
                size = _add_branch(keys, branches, size, base + gap * gap, tree, away)
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
    """Return zeros (bytes) that begin at a cache line."""
    size = math.prod(shape)
    memory = np.zeros(size + _LINE, np.int8)
    begin = -memory.ctypes.data % _LINE
    return memory[begin : begin + size].reshape(shape)


_FOREST = ('nodes', 'values', 'buckets', 'used', 'state')


class KdForestIndex(DescriptorTable):
    """Randomized kd-forest: log N per query, recall near one.

    checks: vectors compared per query.
    """

    def __init__(
        self, dimensions: int, checks: int = 256, trees: int = TREES, seed: int = 1
    ) -> None:
        super().__init__(dimensions)
        self.checks = checks
        self.coarse = np.zeros((2, 0, dimensions // 2), np.int8)
        self.nodes = np.full((trees, 1, 2), -1, np.int32)
        self.values = np.zeros((trees, 1), np.float32)
        self.buckets = np.zeros((trees, 2 + BUCKET), np.int32)
        self.buckets[:, 1] = -1
        self.nodes[:, 0, 1] = np.arange(trees)
        self.used = np.array([1] * trees + [trees], np.int64)
        self.state = np.array([seed], np.uint64)

    def add(self, ids: Ids, vectors: Vectors) -> None:
        """See DescriptorIndex."""
        self.store(ids, vectors)
        self._round(ids)
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
        _insert(self._forest(), ids, self.used, self.state)

    def _round(self, ids: Ids) -> None:
        """Set the rounded vectors of ids from the exact ones."""
        _, have, half = self.coarse.shape
        if have < len(self.table):
            grown = _in_cache_lines((2, len(self.table), half))
            grown[:, :have] = self.coarse
            self.coarse = grown
        rounded = np.rint(self.table[ids] * _STEPS).astype(np.int8)
        self.coarse[:, ids] = rounded.reshape(-1, 2, half).transpose(1, 0, 2)

    def remove(self, ids: Ids) -> None:
        """See DescriptorIndex."""
        self.alive[ids] = False
        _remove(self._forest(), ids)

    def query(self, vectors: Vectors, radius: float, count: int) -> tuple[Ids, Distances]:
        """See DescriptorIndex; the nearest are found with a probability below one."""
        ids = np.full((len(vectors), count), -1, np.int64)
        distances = np.full((len(vectors), count), np.inf, np.float32)
        if len(self.table) and len(vectors):
            stamps = np.zeros(len(self.table), np.int32)
            queries = np.ascontiguousarray(vectors, np.float32)
            _search(
                self._forest(), queries, stamps, radius + ROUNDING, self.checks, ids, distances
            )
        return ids, distances

    def _forest(self) -> Forest:
        return Forest(self.table, self.coarse, self.nodes, self.values, self.buckets)

    def state_dict(self) -> State:
        """See DescriptorIndex."""
        return super().state_dict() | {name: getattr(self, name) for name in _FOREST}

    def restore(self, state: State) -> None:
        """See DescriptorIndex."""
        super().restore(state)
        for name in _FOREST:
            setattr(self, name, state[name].copy())
        self._round(np.arange(len(self.table)))
