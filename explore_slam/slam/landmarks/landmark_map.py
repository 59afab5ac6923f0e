"""The common landmark map: Gaussians per particle, one descriptor, identity and evidence each."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array
from explore_slam.slam.config import AssociationConfig
from explore_slam.slam.descriptors.index import (
    BruteForceIndex,
    DescriptorIndex,
    Descriptors,
    KdTreeIndex,
)
from explore_slam.slam.descriptors.kd_forest import KdForestIndex
from explore_slam.slam.storage.ancestry import Genealogy
from explore_slam.slam.storage.row_store import Items, ParticleOf, RowStore

VALUES = 9
SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


@dataclass(frozen=True)
class Landmarks:
    """Landmarks of one particle.

    ids (N,) stay the same as long as a landmark lives; means (N, 3) m; covariances (N, 3, 3) m²;
    descriptors (N, 128) float32; counts (N,) updates that saw it; owners (N,) number of the
    vehicle that inserted it.
    """

    ids: NDArray[np.int64]
    means: Array
    covariances: Array
    descriptors: Descriptors
    counts: NDArray[np.int64]
    owners: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.ids)


def make_index(config: AssociationConfig) -> DescriptorIndex:
    """Make the descriptor index that the settings name."""
    if config.descriptor_index == 'kd_tree':
        return KdTreeIndex()
    if config.descriptor_index == 'brute_force':
        return BruteForceIndex()
    return KdForestIndex(config.forest_trees, config.forest_checks)


class LandmarkMap:
    """All landmarks. An *item* is a place in the arrays; it is used again after a removal."""

    def __init__(self, particles: int, index: DescriptorIndex) -> None:
        self.rows = RowStore(particles, VALUES)
        self.index = index
        self.next_id = 0
        self.size = 0
        self.free: list[int] = []
        self.ids = np.empty(0, np.int64)
        self.counts = np.empty(0, np.int64)
        self.owners = np.empty(0, np.int64)
        self.evidence = np.empty(0)
        self.reference = np.empty((0, 3))

    def __len__(self) -> int:
        """Return the number of landmarks that exist in at least one particle."""
        return self.size - len(self.free)

    def items(self) -> Items:
        """Return the items in use, by ascending id."""
        used = np.flatnonzero(self.ids[: self.size] >= 0)
        return used[np.argsort(self.ids[used], kind='stable')]

    def add(
        self,
        slots: Items,
        descriptors: Descriptors,
        owner: int,
        reference: Array,
        home: Genealogy,
    ) -> Items:
        """Register landmarks whose rows lie in slots (n,); reference (n, 3) is about where."""
        count = len(slots)
        reused = [self.free.pop() for _ in range(min(count, len(self.free)))]
        fresh = count - len(reused)
        self._grow(self.size + fresh)
        items = np.array(reused + list(range(self.size, self.size + fresh)), np.int64)
        self.size += fresh
        self.ids[items] = self.next_id + np.arange(count)
        self.next_id += count
        self.counts[items] = 1
        self.owners[items] = owner
        self.evidence[items] = 1.0
        self.reference[items] = reference
        self.rows.commit(items, slots, home)
        self.index.add(items, descriptors)
        return items

    def remove(self, items: Items) -> None:
        """Forget landmarks."""
        self.rows.remove(items)
        self.index.remove(items)
        self.ids[items] = -1
        self.free.extend(items.tolist())

    def of_particle(self, particle_of: ParticleOf) -> Landmarks:
        """Return the landmarks that exist in one particle."""
        items = self.items()
        rows = self.rows.read_particle(items, particle_of)
        exists = rows[:, 3] > 0.0
        items, rows = items[exists], rows[exists]
        return Landmarks(
            self.ids[items],
            rows[:, :3],
            rows[:, 3:][:, SYMMETRIC],
            self.index.descriptors(items).copy(),
            self.counts[items],
            self.owners[items],
        )

    def places(self, ids: Items, particle_of: ParticleOf) -> dict[int, Array]:
        """Return id -> (3,): x, y and their standard deviation (m), of ids that a particle has."""
        known = np.flatnonzero(np.isin(self.ids[: self.size], ids))
        rows = self.rows.read_particle(known, particle_of)
        rows[:, 2] = np.sqrt(0.5 * (rows[:, 3] + rows[:, 6]))
        return {
            int(uid): row[:3]
            for uid, row in zip(self.ids[known], rows, strict=True)
            if row[3] > 0.0
        }

    def _grow(self, size: int) -> None:
        have = len(self.ids)
        if size <= have:
            return
        extra = max(size - have, have // 2 + 256)
        self.ids = np.concatenate([self.ids, np.full(extra, -1, np.int64)])
        self.counts = np.concatenate([self.counts, np.zeros(extra, np.int64)])
        self.owners = np.concatenate([self.owners, np.zeros(extra, np.int64)])
        self.evidence = np.concatenate([self.evidence, np.zeros(extra)])
        self.reference = np.concatenate([self.reference, np.zeros((extra, 3))])
