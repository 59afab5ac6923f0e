"""Who descends from whom: ancestor indices that a resampling composes, and that coalesce.

A *level* is a set of particles of the past that still have descendants. It is known by its
index (M,): particle -> row of its ancestor among the rows that are left. Each level is a finer
partition of the particles than the one before, and its rows are numbered in the order of the
particles; two levels with as many rows left are therefore the same partition and become one.
About as many levels are left as there are distinct steps of coalescence: some hundred for 1000
particles, however long the filter runs.
"""

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel

Index = NDArray[np.int32]


@kernel
def _compose(
    index: Index, ancestors: Index, counts: Index, survivors: Index
) -> None:  # pragma: no cover - compiled
    """index[g] <- index[g][ancestors], renumbered; survivors[g, :counts[g]] are the old rows."""
    levels, particles = index.shape
    old = np.empty(particles, np.int32)
    row_of = np.empty(particles, np.int32)
    for g in range(levels):
        old[:] = index[g]
        row_of[:] = -1
        count = 0
        for m in range(particles):
            value = old[ancestors[m]]
            if row_of[value] < 0:
                row_of[value] = count
                survivors[g, count] = value
                count += 1
            index[g, m] = row_of[value]
        counts[g] = count


class Level:
    """Rows of the past that still have descendants; layouts of row stores hang on it."""

    def __init__(self, count: int, index: Index) -> None:
        self.count = count
        self.index = index
        self.layouts: list[Layout] = []


class Layout:
    """How one store's rows of a level lie in memory.

    slots (count,) are the physical rows, or None where row r lies at place r. number and owner
    identify the layout in its store; live counts its items; items lists all ever put into it.
    """

    def __init__(self, genealogy: 'Genealogy', level: Level, owner: object, number: int) -> None:
        self.genealogy = genealogy
        self.level = level
        self.owner = owner
        self.number = number
        self.size_class = 0
        self.slots: Index | None = None
        self.live = 0
        self.items: list[NDArray[np.int64]] = []

    def physical_rows(self) -> Index:
        """Return particle (M,) -> physical row."""
        index = self.level.index
        return index if self.slots is None else self.slots[index]

    def physical_row(self, particle: int) -> int:
        """Return the physical row of one particle."""
        row = int(self.level.index[particle])
        return row if self.slots is None else int(self.slots[row])


class Genealogy:
    """All levels, oldest first; the last one is the present, where every particle has a row."""

    def __init__(self, particles: int) -> None:
        self.particles = particles
        self.levels: list[Level] = []
        self._identity = np.arange(particles, dtype=np.int32)
        self._begin_level()

    @property
    def present(self) -> Level:
        """The level of the present particles."""
        return self.levels[-1]

    def _begin_level(self) -> None:
        self.levels.append(Level(self.particles, self._identity.copy()))

    def is_empty(self) -> bool:
        """Tell whether nothing hangs on any level."""
        return not any(level.layouts for level in self.levels)

    def resample(self, ancestors: Index) -> list[Layout]:
        """Compose ancestors (M,), in any order, into all levels; return layouts that have shrunk.

        The cost is levels × particles: no landmark is touched.
        """
        old = [level for level in self.levels if level.layouts]
        index = np.array([level.index for level in old], np.int32).reshape(-1, self.particles)
        counts = np.zeros(len(old), np.int32)
        survivors = np.empty_like(index)
        _compose(index, ancestors, counts, survivors)
        shrunk: list[Layout] = []
        kept: list[Level] = []
        for g, level in enumerate(old):
            level.index = index[g]
            count = int(counts[g])
            keep = survivors[g, :count].copy()
            if count != level.count or not np.array_equal(keep, self._identity[:count]):
                for layout in level.layouts:
                    layout.slots = keep if layout.slots is None else layout.slots[keep]
                    shrunk.append(layout)
                level.count = count
            if kept and kept[-1].count == count:
                for layout in level.layouts:
                    layout.level = kept[-1]
                kept[-1].layouts.extend(level.layouts)
            else:
                kept.append(level)
        self.levels = kept
        if not kept or kept[-1].count < self.particles:
            self._begin_level()
        return shrunk
