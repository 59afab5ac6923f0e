"""Likelihood of a return by its place: a Gaussian around every known point (maximum rule).

Levels of the pyramid bound the likelihood over squares of cells, so that a search by branch and
bound finds the exact best pose without looking at every one (Olson, "Real-time correlative scan
matching", ICRA 2009; Hess et al., "Real-time loop closure in 2D LIDAR SLAM", ICRA 2016).
"""

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.geometry import Array

# Chosen on the Intel, ACES and Belgioioso logs; `benchmarks/laser_graph_slam.py` shows what a
# change does.
RESOLUTION = 0.05  # m, side of a cell
_DEVIATION = 0.07  # m, of a return from its surface, grid and drift in the map included
_HALF_KERNEL = 3  # cells; the Gaussian is 0.1 there
FULL = 255  # likelihood 1

Levels = NDArray[np.uint8]


def _gaussian() -> Levels:
    steps = np.arange(-_HALF_KERNEL, _HALF_KERNEL + 1) * RESOLUTION
    square = steps[:, None] ** 2 + steps[None, :] ** 2
    return np.round(FULL * np.exp(-0.5 * square / _DEVIATION**2)).astype(np.uint8)


_KERNEL = _gaussian()


class LikelihoodGrid:
    """Likelihood in 0..255 over the surroundings of points (n, 2).

    Cells are counted from the origin of the frame; `origin` is the first one's column and row.
    Cell (row, column) of level l holds the largest likelihood in the 2^l x 2^l cells from there
    upwards, so that all levels share one indexing. Everything outside has likelihood 0.
    """

    def __init__(self, points: Array) -> None:
        self._points = points
        self._built = 0
        self._levels: Levels = np.zeros((0, 0, 0), np.uint8)
        self.origin = (0, 0)

    def levels(self, count: int) -> Levels:
        """Return at least the given number of levels (L, rows, columns), level 0 the finest."""
        if count > self._built:
            self._build(count)
        return self._levels

    def _build(self, count: int) -> None:
        """Draw the points and take maxima; the margin keeps every square that holds a point."""
        margin = _HALF_KERNEL + 2**count
        cells = np.floor(self._points / RESOLUTION).astype(np.int64)
        first = cells.min(axis=0) - margin
        columns, rows = (cells.max(axis=0) - first + _HALF_KERNEL + 1).tolist()
        levels = np.zeros((count, rows, columns), np.uint8)
        _draw(levels[0], cells - first, _KERNEL)
        for level in range(1, count):
            half = 2 ** (level - 1)
            below, above = levels[level - 1], levels[level]
            above[:] = below
            np.maximum(above[:, :-half], below[:, half:], out=above[:, :-half])
            wide = above.copy()
            np.maximum(above[:-half], wide[half:], out=above[:-half])
        column, row = first.tolist()
        self.origin = (column, row)
        self._levels, self._built = levels, count


@kernel
def _draw(grid: Levels, cells: NDArray[np.int64], gaussian: Levels) -> None:
    """Raise the likelihood around each cell (column, row) to the Gaussian; once per cell."""
    width = len(gaussian)
    half = width // 2
    for n in range(len(cells)):
        column, row = cells[n, 0], cells[n, 1]
        if grid[row, column] == FULL:
            continue
        for r in range(width):
            for c in range(width):
                at_row, at_column = row + r - half, column + c - half
                grid[at_row, at_column] = max(grid[at_row, at_column], gaussian[r, c])
