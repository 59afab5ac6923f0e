"""The landmark map common to all vehicles: Gaussians per particle, one descriptor per landmark."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array
from explore_slam.slam.checkpoint import State, part, under
from explore_slam.slam.config import AssociationConfig
from explore_slam.slam.descriptors.index import BruteForceIndex, DescriptorIndex
from explore_slam.slam.descriptors.kd_forest import KdForestIndex
from explore_slam.slam.descriptors.kd_tree import KdTreeIndex
from explore_slam.slam.descriptors.kinds import DescriptorKind, Vectors, kind_named
from explore_slam.slam.storage.ancestry import AncestryTree
from explore_slam.slam.storage.row_format import COVARIANCE, ROW_LENGTH, Places, exists, unpacked
from explore_slam.slam.storage.row_store import ParticleOf, RowStore

_LEAST_CAPACITY = 256  # landmarks by which the arrays grow at least
_TABLES = ('ids', 'counts', 'owners', 'evidence', 'reference')


@dataclass(frozen=True)
class Landmarks:
    """The landmarks of one particle.

    ids (N,) stay the same as long as a landmark exists; means (N, 3) m; covariances (N, 3, 3) m²;
    descriptors (N, length) of the kind in use; counts (N,) updates that observed it; owners (N,)
    number of the vehicle that inserted it.
    """

    ids: NDArray[np.int64]
    means: Array
    covariances: Array
    descriptors: NDArray[Any]
    counts: NDArray[np.int64]
    owners: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.ids)


def make_index(config: AssociationConfig) -> DescriptorIndex:
    """Return the descriptor index that the settings name."""
    dimensions = kind_named(config.descriptor_kind).dimensions
    if config.descriptor_index == 'kd_tree':
        return KdTreeIndex(dimensions)
    if config.descriptor_index == 'brute_force':
        return BruteForceIndex(dimensions)
    return KdForestIndex(dimensions, config.forest_checks)


class LandmarkMap:
    """All landmarks.

    An *entry* is the place of a landmark in the arrays. It is used again after the landmark has
    been removed; the id of a landmark is not. Arrays by entry: ids (-1 if free), counts, owners as
    in Landmarks, evidence of existence, reference (n, 3): approximate position (m).
    """

    def __init__(self, particles: int, kind: DescriptorKind, index: DescriptorIndex) -> None:
        self.kind = kind
        self.index = index
        self.rows = RowStore(particles, ROW_LENGTH)
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

    def entries(self) -> Places:
        """Return the entries in use, by ascending id."""
        used = np.flatnonzero(self.ids[: self.size] >= 0)
        return used[np.argsort(self.ids[used], kind='stable')]

    def add(
        self,
        addresses: Places,
        vectors: Vectors,
        owner: int,
        reference: Array,
        tree: AncestryTree,
    ) -> Places:
        """Register landmarks whose rows lie at addresses (n,) of the workspace.

        vectors (n, D) of their descriptors; reference (n, 3) m. Returns their entries (n,).
        """
        count = len(addresses)
        reused = [self.free.pop() for _ in range(min(count, len(self.free)))]
        fresh = count - len(reused)
        self._grow(self.size + fresh)
        entries = np.array(reused + list(range(self.size, self.size + fresh)), np.int64)
        self.size += fresh
        self.ids[entries] = self.next_id + np.arange(count)
        self.next_id += count
        self.counts[entries] = 1
        self.owners[entries] = owner
        self.evidence[entries] = 1.0
        self.reference[entries] = reference
        self.rows.commit(entries, addresses, tree)
        self.index.add(entries, vectors)
        return entries

    def remove(self, entries: Places) -> None:
        """Remove landmarks."""
        self.rows.remove(entries)
        self.index.remove(entries)
        self.ids[entries] = -1
        self.free.extend(entries.tolist())

    def of_particle(self, particle_of: ParticleOf) -> Landmarks:
        """Return the landmarks that exist in one particle (of each ancestry tree)."""
        entries = self.entries()
        rows = self.rows.read_particle(entries, particle_of)
        there = exists(rows)
        entries, rows = entries[there], rows[there]
        return Landmarks(
            self.ids[entries],
            rows[:, :COVARIANCE],
            unpacked(rows[:, COVARIANCE:]),
            self.kind.descriptors(self.index.vectors(entries).copy()),
            self.counts[entries],
            self.owners[entries],
        )

    def positions(self, ids: Places, particle_of: ParticleOf) -> dict[int, Array]:
        """Return id -> (3,): x, y and their standard deviation (m), of ids that a particle has."""
        known = np.flatnonzero(np.isin(self.ids[: self.size], ids))
        rows = self.rows.read_particle(known, particle_of)
        rows[:, 2] = np.sqrt(0.5 * (rows[:, 3] + rows[:, 6]))
        return {
            int(uid): row[:3]
            for uid, row, there in zip(self.ids[known], rows, exists(rows), strict=True)
            if there
        }

    def state_dict(self) -> State:
        """Return all landmarks and the descriptor index; ancestry trees save themselves."""
        state: State = {name: getattr(self, name) for name in _TABLES}
        state['free'] = np.array(self.free, np.int64)
        state['size'] = np.array([self.size, self.next_id], np.int64)
        return (
            state | under('index', self.index.state_dict()) | under('rows', self.rows.state_dict())
        )

    def restore(self, state: State) -> None:
        """Restore a map of the same number of particles, kind and index."""
        for name in _TABLES:
            setattr(self, name, state[name].copy())
        self.free = state['free'].tolist()
        self.size, self.next_id = state['size'].tolist()
        self.index.restore(part('index', state))
        self.rows.restore(part('rows', state))

    def _grow(self, size: int) -> None:
        have = len(self.ids)
        if size <= have:
            return
        extra = max(size - have, have // 2 + _LEAST_CAPACITY)
        self.ids = np.concatenate([self.ids, np.full(extra, -1, np.int64)])
        self.counts = np.concatenate([self.counts, np.zeros(extra, np.int64)])
        self.owners = np.concatenate([self.owners, np.zeros(extra, np.int64)])
        self.evidence = np.concatenate([self.evidence, np.zeros(extra)])
        self.reference = np.concatenate([self.reference, np.zeros((extra, 3))])
