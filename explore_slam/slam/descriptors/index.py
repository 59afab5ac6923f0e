"""Lookup of landmarks by descriptor: which landmarks lie within E0 of each observed descriptor.

Descriptors belong to landmarks, not to particles, so one index serves all particles. Distances
are squared Euclidean distances of unit vectors (E of the paper).
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import DESCRIPTOR_LENGTH

Descriptors = NDArray[np.float32]
Ids = NDArray[np.int64]


class DescriptorIndex(Protocol):
    """What the filter needs of an index; ids are small integers chosen by the caller."""

    def add(self, ids: Ids, descriptors: Descriptors) -> None:
        """Take in descriptors (n, 128) under ids (n,) that are not in use."""

    def remove(self, ids: Ids) -> None:
        """Take ids (n,) out."""

    def query(
        self, descriptors: Descriptors, radius: float, count: int
    ) -> tuple[Ids, NDArray[np.float32]]:
        """Return ids (K, count) and squared distances of the nearest within radius, nearest first.

        radius is a squared distance, inclusive up to rounding; places without a match hold id -1
        and distance inf.
        """

    def descriptors(self, ids: Ids) -> Descriptors:
        """Return the descriptors (n, 128) of ids (n,)."""


#: Squared distance of two equal unit vectors is zero up to rounding of float32.
ROUNDING = 1e-5


class DescriptorTable:
    """Descriptors by id, in one growing array."""

    def __init__(self) -> None:
        self.table = np.zeros((0, DESCRIPTOR_LENGTH), np.float32)
        self.alive = np.zeros(0, bool)

    def store(self, ids: Ids, descriptors: Descriptors) -> None:
        """Write descriptors (n, 128) to the places of ids (n,)."""
        if not len(ids):
            return
        need = int(ids.max()) + 1
        if need > len(self.table):
            capacity = max(need, int(1.5 * len(self.table)) + 256)
            table = np.zeros((capacity, DESCRIPTOR_LENGTH), np.float32)
            table[: len(self.table)] = self.table
            alive = np.zeros(capacity, bool)
            alive[: len(self.alive)] = self.alive
            self.table, self.alive = table, alive
        self.table[ids] = descriptors
        self.alive[ids] = True

    def descriptors(self, ids: Ids) -> Descriptors:
        """Return the descriptors (n, 128) of ids (n,)."""
        return self.table[ids]


class BruteForceIndex(DescriptorTable):
    """All distances by one matrix product: exact, and linear in the number of landmarks."""

    def add(self, ids: Ids, descriptors: Descriptors) -> None:
        """See DescriptorIndex."""
        self.store(ids, descriptors)

    def remove(self, ids: Ids) -> None:
        """See DescriptorIndex."""
        self.alive[ids] = False

    def query(
        self, descriptors: Descriptors, radius: float, count: int
    ) -> tuple[Ids, NDArray[np.float32]]:
        """See DescriptorIndex."""
        ids = np.full((len(descriptors), count), -1, np.int64)
        distances = np.full((len(descriptors), count), np.inf, np.float32)
        known = np.flatnonzero(self.alive)
        if not len(known) or not len(descriptors):
            return ids, distances
        table = self.table[known]
        squares = np.einsum('ij,ij->i', table, table)
        own = np.einsum('ij,ij->i', descriptors, descriptors)
        all_distances = own[:, None] + squares[None, :] - 2.0 * (descriptors @ table.T)
        found = min(count, len(known))
        nearest = np.argpartition(all_distances, found - 1, axis=1)[:, :found]
        chosen = table[nearest] - descriptors[:, None, :]
        exact = np.einsum('ijk,ijk->ij', chosen, chosen)
        order = np.lexsort((known[nearest], exact), axis=1)
        nearest = np.take_along_axis(nearest, order, 1)
        exact = np.take_along_axis(exact, order, 1)
        inside = exact <= radius + ROUNDING
        ids[:, :found] = np.where(inside, known[nearest], -1)
        distances[:, :found] = np.where(inside, exact, np.inf)
        return ids, distances


class KdTreeIndex(BruteForceIndex):
    """Exact kd-tree of SciPy over the bulk, matrix product over what was added since its build."""

    def __init__(self, rebuild_part: float = 0.25) -> None:
        super().__init__()
        self.rebuild_part = rebuild_part
        self.bulk = np.empty(0, np.int64)
        self._tree: object | None = None
        self.tail: dict[int, None] = {}

    def add(self, ids: Ids, descriptors: Descriptors) -> None:
        """See DescriptorIndex."""
        self.store(ids, descriptors)
        self.tail.update(dict.fromkeys(ids.tolist()))
        if len(self.tail) > self.rebuild_part * len(self.bulk) + 64:
            self._build()

    def remove(self, ids: Ids) -> None:
        """See DescriptorIndex."""
        super().remove(ids)
        if np.isin(ids, self.bulk).any():
            self._build()
        for item in ids.tolist():
            self.tail.pop(item, None)

    def _build(self) -> None:
        self.restore(np.flatnonzero(self.alive), np.empty(0, np.int64))

    def restore(self, bulk: Ids, tail: Ids) -> None:
        """Set which ids are in the tree and which are compared one by one."""
        from scipy.spatial import cKDTree

        self.bulk = bulk.copy()
        self.tail = dict.fromkeys(tail.tolist())
        self._tree = cKDTree(self.table[self.bulk]) if len(self.bulk) else None

    def query(
        self, descriptors: Descriptors, radius: float, count: int
    ) -> tuple[Ids, NDArray[np.float32]]:
        """See DescriptorIndex."""
        tail = BruteForceIndex()
        tail_ids = np.array(list(self.tail), np.int64)
        tail.store(np.arange(len(tail_ids)), self.table[tail_ids])
        places, far = tail.query(descriptors, radius, count)
        near_ids = np.where(places >= 0, tail_ids[places] if len(tail_ids) else -1, -1)
        if self._tree is None or not len(descriptors):
            return near_ids, far
        bound = np.sqrt(radius + ROUNDING)
        lengths, rows = self._tree.query(  # type: ignore[attr-defined]
            descriptors, k=np.arange(1, count + 1), distance_upper_bound=bound
        )
        inside = np.isfinite(lengths)
        bulk_ids = np.where(inside, self.bulk[np.where(inside, rows, 0)], -1)
        ids = np.concatenate([near_ids, bulk_ids], 1)
        distances = np.concatenate([far, (lengths**2).astype(np.float32)], 1)
        order = np.argsort(distances, axis=1, kind='stable')[:, :count]
        return np.take_along_axis(ids, order, 1), np.take_along_axis(distances, order, 1)
