"""Likelihood of a return by its place: a Gaussian around every known point (maximum rule).

Levels of the pyramid bound the likelihood over squares of cells, so that a search by branch and
bound finds the exact best pose without looking at every one (Olson, "Real-time correlative scan
matching", ICRA 2009; Hess et al., "Real-time loop closure in 2D LIDAR SLAM", ICRA 2016).
"""

import math

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.geometry import Array

RESOLUTION = 0.05  # m, side of a cell (design study on Intel, ACES and Belgioioso)
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

    Cell (row, column) of level l holds the largest likelihood in the 2^l x 2^l cells from there
    upwards, so that all levels share one indexing. Everything outside has likelihood 0.
    """

    def __init__(self, points: Array) -> None:
        self._points = points
        self._built = 0
        self._levels: Levels = np.zeros((0, 0, 0), np.uint8)
        self.x = 0.0
        self.y = 0.0

    def levels(self, count: int) -> Levels:
        """Return at least the given number of levels (L, rows, columns), level 0 the finest."""
        if count > self._built:
            self._build(count)
        return self._levels

    def _build(self, count: int) -> None:
        """Draw the points and take maxima; the margin keeps every square that holds a point."""
        margin = _HALF_KERNEL + 2**count
        low = self._points.min(axis=0) - margin * RESOLUTION
        size = (self._points.max(axis=0) - low) / RESOLUTION
        columns, rows = (size.astype(np.int64) + _HALF_KERNEL + 2).tolist()
        levels = np.zeros((count, rows, columns), np.uint8)
        _draw(levels[0], self._points, low[0], low[1], _KERNEL)
        for level in range(1, count):
            half = 2 ** (level - 1)
            below, above = levels[level - 1], levels[level]
            above[:] = below
            np.maximum(above[:, :-half], below[:, half:], out=above[:, :-half])
            wide = above.copy()
            np.maximum(above[:-half], wide[half:], out=above[:-half])
        self.x, self.y = low.tolist()
        self._levels, self._built = levels, count


@kernel
def _draw(grid: Levels, points: Array, x: float, y: float, gaussian: Levels) -> None:
    """Raise the likelihood around each point to the Gaussian; one point per cell is enough."""
    width = len(gaussian)
    half = width // 2
    for n in range(len(points)):
        column = math.floor((points[n, 0] - x) / RESOLUTION)
        row = math.floor((points[n, 1] - y) / RESOLUTION)
        if grid[row, column] == FULL:
            continue
        for r in range(width):
            for c in range(width):
                at_row, at_column = row + r - half, column + c - half
                grid[at_row, at_column] = max(grid[at_row, at_column], gaussian[r, c])
