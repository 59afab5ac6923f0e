"""Exact kd-tree of SciPy beside a brute-force comparison of what was added since it was built."""

import numpy as np
from scipy.spatial import cKDTree

from explore_slam.slam.checkpoint import State
from explore_slam.slam.descriptors.index import ROUNDING, BruteForceIndex, Distances, Ids
from explore_slam.slam.descriptors.kinds import Vectors

# The tree is rebuilt when this part of it, and at least so many vectors, have been added: the cost
# of building, spread over the insertions, then stays in the order of a query.
_REBUILD_FRACTION = 0.25
_REBUILD_COUNT = 64


class KdTreeIndex(BruteForceIndex):
    """Exact kd-tree over most vectors, matrix product over the tail added since it was built."""

    def __init__(self, dimensions: int) -> None:
        super().__init__(dimensions)
        self.bulk = np.empty(0, np.int64)
        self._tree: cKDTree | None = None
        self.tail: dict[int, None] = {}

    def add(self, ids: Ids, vectors: Vectors) -> None:
        """See DescriptorIndex."""
        self.store(ids, vectors)
        self.tail.update(dict.fromkeys(ids.tolist()))
        if len(self.tail) > _REBUILD_FRACTION * len(self.bulk) + _REBUILD_COUNT:
            self._build()

    def remove(self, ids: Ids) -> None:
        """See DescriptorIndex."""
        super().remove(ids)
        if np.isin(ids, self.bulk).any():
            self._build()
        for item in ids.tolist():
            self.tail.pop(item, None)

    def _build(self) -> None:
        self._set_bulk(np.flatnonzero(self.alive), np.empty(0, np.int64))

    def state_dict(self) -> State:
        """See DescriptorIndex."""
        tail = np.array(list(self.tail), np.int64)
        return super().state_dict() | {'bulk': self.bulk, 'tail': tail}

    def restore(self, state: State) -> None:
        """See DescriptorIndex."""
        super().restore(state)
        self._set_bulk(state['bulk'], state['tail'])

    def _set_bulk(self, bulk: Ids, tail: Ids) -> None:
        """Set which ids are in the tree and which are compared one by one."""
        self.bulk = bulk.copy()
        self.tail = dict.fromkeys(tail.tolist())
        self._tree = cKDTree(self.table[self.bulk]) if len(self.bulk) else None

    def query(self, vectors: Vectors, radius: float, count: int) -> tuple[Ids, Distances]:
        """See DescriptorIndex."""
        tail = BruteForceIndex(self.table.shape[1])
        tail_ids = np.array(list(self.tail), np.int64)
        tail.store(np.arange(len(tail_ids)), self.table[tail_ids])
        places, far = tail.query(vectors, radius, count)
        near_ids = np.where(places >= 0, tail_ids[places] if len(tail_ids) else -1, -1)
        if self._tree is None or not len(vectors):
            return near_ids, far
        bound = np.sqrt(radius + ROUNDING)
        lengths, rows = self._tree.query(
            vectors, k=np.arange(1, count + 1), distance_upper_bound=bound
        )
        inside = np.isfinite(lengths)
        bulk_ids = np.where(inside, self.bulk[np.where(inside, rows, 0)], -1)
        ids = np.concatenate([near_ids, bulk_ids], 1)
        distances = np.concatenate([far, (lengths**2).astype(np.float32)], 1)
        order = np.argsort(distances, axis=1, kind='stable')[:, :count]
        return np.take_along_axis(ids, order, 1), np.take_along_axis(distances, order, 1)
