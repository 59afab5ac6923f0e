"""The ancestry of particles: indices that a resampling composes, and that coalesce.

A *generation* is a set of particles of the past that still have descendants. Its index (M,) maps
each particle of the present to its ancestor among those that are left. Every generation is a
finer partition of the particles than the one before it, and its members are numbered in the order
of their descendants; two generations with the same number of members are therefore the same
partition and become one. The number of generations is that of distinct coalescence steps: some
hundreds for 1000 particles, however long the filter runs (as in the ancestry trees of particle
filters: Jacob, Murray and Rubenthaler, "Path storage in the particle filter", 2015).
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.slam.checkpoint import State

Index = NDArray[np.int32]


@kernel
def _compose(
    index: Index, ancestors: Index, counts: Index, survivors: Index
) -> None:  # pragma: no cover - compiled
    """index[g] <- index[g][ancestors], renumbered; survivors[g, :counts[g]] are the old members.

    index, survivors (G, M), counts (G,), ancestors (M,).
    """
    generations, particles = index.shape
    old = np.empty(particles, np.int32)
    member_of = np.empty(particles, np.int32)
    for g in range(generations):
        old[:] = index[g]
        member_of[:] = -1
        count = 0
        for m in range(particles):
            value = old[ancestors[m]]
            if member_of[value] < 0:
                member_of[value] = count
                survivors[g, count] = value
                count += 1
            index[g, m] = member_of[value]
        counts[g] = count


class LayoutOwner(Protocol):
    """A store of rows, as the ancestry tree sees it."""

    def compact(self, layout: 'Layout') -> None:
        """Move the rows of a layout whose generation has shrunk to smaller memory, if any fits."""

    def adopt(self, layout: 'Layout') -> None:
        """Register a layout restored from a saved state."""


class Generation:
    """Particles of the past that still have descendants, and the layouts of their rows."""

    def __init__(self, count: int, index: Index) -> None:
        self.count = count
        self.index = index
        self.layouts: list[Layout] = []


class Layout:
    """How the rows that one store keeps for a generation lie in memory.

    columns (count,) are the memory columns of the members, None if member r has column r. number
    identifies the layout in its store; live counts its entries; entries lists all that were ever
    put into it.
    """

    def __init__(
        self, tree: 'AncestryTree', generation: Generation, owner: LayoutOwner, number: int
    ) -> None:
        self.tree = tree
        self.generation = generation
        self.owner = owner
        self.number = number
        self.size_class = 0
        self.columns: Index | None = None
        self.live = 0
        self.entries: list[NDArray[np.int64]] = []

    def column_of_particles(self) -> Index:
        """Return the memory column (M,) of each particle."""
        index = self.generation.index
        return index if self.columns is None else self.columns[index]

    def column_of(self, particle: int) -> int:
        """Return the memory column of one particle."""
        member = int(self.generation.index[particle])
        return member if self.columns is None else int(self.columns[member])


class AncestryTree:
    """All generations, oldest first; in the last, the present, every particle is a member."""

    def __init__(self, particles: int) -> None:
        self.particles = particles
        self.generations: list[Generation] = []
        self._identity = np.arange(particles, dtype=np.int32)
        self._begin_generation()

    @property
    def present(self) -> Generation:
        """The generation of the present particles."""
        return self.generations[-1]

    def _begin_generation(self) -> None:
        self.generations.append(Generation(self.particles, self._identity.copy()))

    def is_empty(self) -> bool:
        """Return whether no store keeps rows for any generation."""
        return not any(generation.layouts for generation in self.generations)

    def resample(self, ancestors: Index) -> list[Layout]:
        """Compose ancestors (M,), in any order, into all generations; return layouts that shrank.

        The cost is generations × particles, independent of the number of landmarks.
        """
        old = [generation for generation in self.generations if generation.layouts]
        index = np.array([generation.index for generation in old], np.int32)
        index = index.reshape(-1, self.particles)
        counts = np.zeros(len(old), np.int32)
        survivors = np.empty_like(index)
        _compose(index, ancestors, counts, survivors)
        shrunk: list[Layout] = []
        kept: list[Generation] = []
        for g, generation in enumerate(old):
            generation.index = index[g]
            count = int(counts[g])
            keep = survivors[g, :count].copy()
            if count != generation.count or not np.array_equal(keep, self._identity[:count]):
                for layout in generation.layouts:
                    layout.columns = keep if layout.columns is None else layout.columns[keep]
                    shrunk.append(layout)
                generation.count = count
            if kept and kept[-1].count == count:
                for layout in generation.layouts:
                    layout.generation = kept[-1]
                kept[-1].layouts.extend(generation.layouts)
            else:
                kept.append(generation)
        self.generations = kept
        if not kept or kept[-1].count < self.particles:
            self._begin_generation()
        return shrunk

    def state_dict(self, stores: Sequence[LayoutOwner]) -> State:
        """Return generations, and the layouts that the stores keep for them."""
        index = np.array([generation.index for generation in self.generations], np.int32)
        table, columns = [], []
        for g, generation in enumerate(self.generations):
            for layout in generation.layouts:
                length = -1 if layout.columns is None else len(layout.columns)
                owner = next(i for i, store in enumerate(stores) if store is layout.owner)
                table.append([g, owner, layout.number, layout.size_class, layout.live, length])
                if layout.columns is not None:
                    columns.append(layout.columns)
        return {
            'counts': np.array([g.count for g in self.generations], np.int64),
            'index': index.reshape(-1, self.particles),
            'layouts': np.array(table, np.int64).reshape(-1, 6),
            'columns': np.concatenate([np.empty(0, np.int32), *columns]),
        }

    def restore(self, state: State, stores: Sequence[LayoutOwner]) -> None:
        """Restore generations and layouts; the stores must have been restored before."""
        self.generations = [
            Generation(int(count), index.astype(np.int32))
            for count, index in zip(state['counts'], state['index'], strict=True)
        ]
        at = 0
        for g, owner, number, size_class, live, length in state['layouts'].tolist():
            layout = Layout(self, self.generations[g], stores[owner], number)
            layout.size_class, layout.live = size_class, live
            if length >= 0:
                layout.columns = state['columns'][at : at + length].astype(np.int32)
                at += length
            self.generations[g].layouts.append(layout)
            layout.owner.adopt(layout)
