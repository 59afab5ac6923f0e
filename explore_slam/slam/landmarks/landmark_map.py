"""The landmark map common to all vehicles: Gaussians per particle, one descriptor per landmark."""

from collections.abc import Sequence
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
from explore_slam.slam.particles.group import Group, Groups
from explore_slam.slam.particles.joint_samples import deferred
from explore_slam.slam.storage.ancestry import AncestryTree
from explore_slam.slam.storage.row_format import COVARIANCE, ROW_LENGTH, Places, exists, unpacked
from explore_slam.slam.storage.row_store import ParticleOf, RowStore

_MINIMUM_CAPACITY = 256  # landmarks by which the arrays grow at least
_TABLES = ('ids', 'counts', 'owners', 'evidence', 'reference', 'draw')


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

    def only(self, chosen: NDArray[np.bool_]) -> 'Landmarks':
        """Return some of the landmarks."""
        return Landmarks(
            self.ids[chosen],
            self.means[chosen],
            self.covariances[chosen],
            self.descriptors[chosen],
            self.counts[chosen],
            self.owners[chosen],
        )


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
    in Landmarks, evidence of existence, reference (n, 3): approximate position (m), draw: number
    of the joint samples from which the rows still have to be fused, or -1.
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
        self.draw = np.empty(0, np.int64)

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
        self.draw[entries] = -1
        self.rows.commit(entries, addresses, tree)
        self.index.add(entries, vectors)
        return entries

    def add_copies(self, entries: Places, owner: int, counts: Places, tree: AncestryTree) -> None:
        """Register landmarks that look like others but are elsewhere.

        They are in no particle yet: their rows are to be deferred to a draw from the joint graph.
        entries (n,) of the others; counts (n,) of the observations of each copy. The ids follow
        the newest one.
        """
        addresses = self.rows.allocate(len(entries))
        self.rows.workspace[addresses] = 0.0
        vectors, reference = self.index.vectors(entries).copy(), self.reference[entries]
        added = self.add(addresses, vectors, owner, reference, tree)
        self.counts[added] = counts

    def remove(self, entries: Places) -> None:
        """Remove landmarks."""
        self.rows.remove(entries)
        self.index.remove(entries)
        self.ids[entries] = -1
        self.free.extend(entries.tolist())

    def entries_with(self, ids: Places) -> Places:
        """Return the entries (n,) of landmarks by id; -1 for ids that do not exist."""
        entries = self.entries()
        if not len(entries):
            return np.full(len(ids), -1, np.int64)
        known = self.ids[entries]
        at = np.minimum(np.searchsorted(known, ids), len(known) - 1)
        found: Places = np.where(known[at] == ids, entries[at], -1)
        return found

    def entries_of(self, groups: Sequence[Group]) -> Places:
        """Return the entries whose rows belong to groups, or are deferred to draws of theirs."""
        entries = self.entries()
        draws = [samples.number for group in groups for samples in group.samples]
        mine = np.isin(self.draw[entries], draws)
        present = np.flatnonzero(self.draw[entries] < 0)
        trees = {tree for group in groups for tree in group.trees}
        mine[present] = self.rows.is_of(entries[present], trees)
        return entries[mine]

    def defer(self, entries: Places, number: int, reference: Array) -> None:
        """Drop the rows of landmarks: they are fused from a draw when they are next needed.

        number: of the draw, which must contain their observations; reference (n, 3) m.
        """
        self.rows.remove(entries)
        self.draw[entries] = number
        self.reference[entries] = reference

    def fuse(self, entries: Places, groups: Groups) -> dict[int, Places]:
        """Fuse the rows of those of the entries that a draw has deferred; return them by draw."""
        waiting = deferred(self.draw, entries)
        for number, some in waiting.items():
            group, samples = groups.with_samples(number)
            addresses = self.rows.allocate(len(some))
            self.rows.workspace[addresses] = samples.fused(self.ids[some])
            self.rows.commit(some, addresses, group.tree)
            self.draw[some] = -1
        return waiting

    def of_particle(self, particle_of: ParticleOf, groups: Groups) -> Landmarks:
        """Return the landmarks that exist in one particle (of each ancestry tree).

        Deferred ones are those of the most likely path.
        """
        entries = self.entries()
        rows = self._rows_of_particle(entries, particle_of, groups)
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

    def positions(self, ids: Places, particle_of: ParticleOf, groups: Groups) -> dict[int, Array]:
        """Return id -> (3,): x, y and their standard deviation (m), of ids that a particle has."""
        known = np.flatnonzero(np.isin(self.ids[: self.size], ids))
        rows = self._rows_of_particle(known, particle_of, groups)
        rows[:, 2] = np.sqrt(0.5 * (rows[:, 3] + rows[:, 6]))
        return {
            int(uid): row[:3]
            for uid, row, there in zip(self.ids[known], rows, exists(rows), strict=True)
            if there
        }

    def _rows_of_particle(self, entries: Places, particle_of: ParticleOf, groups: Groups) -> Array:
        rows = np.empty((len(entries), ROW_LENGTH))
        present = self.draw[entries] < 0
        rows[present] = self.rows.read_particle(entries[present], particle_of)
        for number, some in deferred(self.draw, entries).items():
            _, samples = groups.with_samples(number)
            rows[self.draw[entries] == number] = samples.fused_at_mean(self.ids[some])
        return rows

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
        extra = max(size - have, have // 2 + _MINIMUM_CAPACITY)
        self.ids = np.concatenate([self.ids, np.full(extra, -1, np.int64)])
        self.counts = np.concatenate([self.counts, np.zeros(extra, np.int64)])
        self.owners = np.concatenate([self.owners, np.zeros(extra, np.int64)])
        self.evidence = np.concatenate([self.evidence, np.zeros(extra)])
        self.reference = np.concatenate([self.reference, np.zeros((extra, 3))])
        self.draw = np.concatenate([self.draw, np.full(extra, -1, np.int64)])
