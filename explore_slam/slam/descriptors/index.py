"""Indices over landmark descriptors: the landmarks within E0 of each observed descriptor.

Descriptors belong to landmarks, not to particles, so that one index serves all particles.
Distances are squared Euclidean distances of unit vectors (E of the paper, step 2.2.1).
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from explore_slam.slam.checkpoint import State
from explore_slam.slam.descriptors.kinds import Vectors

Ids = NDArray[np.int64]
Distances = NDArray[np.float32]

#: Squared distance of two equal unit vectors is zero up to rounding of float32.
ROUNDING = 1e-5


class DescriptorIndex(Protocol):
    """What the filter needs of an index; ids are small integers chosen by the caller."""

    def add(self, ids: Ids, vectors: Vectors) -> None:
        """Add vectors (n, D) under ids (n,) that are not in use."""

    def remove(self, ids: Ids) -> None:
        """Remove ids (n,)."""

    def query(self, vectors: Vectors, radius: float, count: int) -> tuple[Ids, Distances]:
        """Return ids (K, count) and squared distances of the nearest within radius, nearest first.

        radius is a squared distance, inclusive up to rounding; places without a match have id -1
        and distance inf.
        """

    def vectors(self, ids: Ids) -> Vectors:
        """Return the vectors (n, D) of ids (n,)."""

    def state_dict(self) -> State:
        """Return the state of the index as named arrays."""

    def restore(self, state: State) -> None:
        """Restore the state of an index of the same class."""


class DescriptorTable:
    """Vectors by id, in one growing array."""

    def __init__(self, dimensions: int) -> None:
        self.table = np.zeros((0, dimensions), np.float32)
        self.alive = np.zeros(0, bool)

    def store(self, ids: Ids, vectors: Vectors) -> None:
        """Write vectors (n, D) to the places of ids (n,)."""
        if not len(ids):
            return
        need = int(ids.max()) + 1
        if need > len(self.table):
            capacity = max(need, int(1.5 * len(self.table)) + 256)
            table = np.zeros((capacity, self.table.shape[1]), np.float32)
            table[: len(self.table)] = self.table
            alive = np.zeros(capacity, bool)
            alive[: len(self.alive)] = self.alive
            self.table, self.alive = table, alive
        self.table[ids] = vectors
        self.alive[ids] = True

    def vectors(self, ids: Ids) -> Vectors:
        """Return the vectors (n, D) of ids (n,)."""
        return self.table[ids]

    def state_dict(self) -> State:
        """See DescriptorIndex."""
        return {'table': self.table, 'alive': self.alive}

    def restore(self, state: State) -> None:
        """See DescriptorIndex."""
        self.table, self.alive = state['table'].copy(), state['alive'].copy()


class BruteForceIndex(DescriptorTable):
    """All distances by one matrix product: exact, and linear in the number of landmarks."""

    def add(self, ids: Ids, vectors: Vectors) -> None:
        """See DescriptorIndex."""
        self.store(ids, vectors)

    def remove(self, ids: Ids) -> None:
        """See DescriptorIndex."""
        self.alive[ids] = False

    def query(self, vectors: Vectors, radius: float, count: int) -> tuple[Ids, Distances]:
        """See DescriptorIndex."""
        ids = np.full((len(vectors), count), -1, np.int64)
        distances = np.full((len(vectors), count), np.inf, np.float32)
        known = np.flatnonzero(self.alive)
        if not len(known) or not len(vectors):
            return ids, distances
        table = self.table[known]
        squares = np.einsum('ij,ij->i', table, table)
        own = np.einsum('ij,ij->i', vectors, vectors)
        all_distances = own[:, None] + squares[None, :] - 2.0 * (vectors @ table.T)
        found = min(count, len(known))
        nearest = np.argpartition(all_distances, found - 1, axis=1)[:, :found]
        chosen = table[nearest] - vectors[:, None, :]
        exact = np.einsum('ijk,ijk->ij', chosen, chosen)
        order = np.lexsort((known[nearest], exact), axis=1)
        nearest = np.take_along_axis(nearest, order, 1)
        exact = np.take_along_axis(exact, order, 1)
        inside = exact <= radius + ROUNDING
        ids[:, :found] = np.where(inside, known[nearest], -1)
        distances[:, :found] = np.where(inside, exact, np.inf)
        return ids, distances
