"""Areas that the operator has drawn: one to explore, and keep-out areas.

The planner gets a view of the grid in which cells out of bounds are occupied, so that frontiers,
travel costs and paths respect them at once.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from explore_slam.errors import AgentError
from explore_slam.exploration import Grid
from explore_slam.geometry import Array

_OUT_OF_BOUNDS = 32767  # the highest level, which is occupied in every grid


def checked_polygon(points: ArrayLike) -> Array:
    """Return the corners (N, 2) m of a polygon; AgentError unless it encloses an area."""
    corners = np.asarray(points, np.float64).reshape(-1, 2)
    if len(corners) < 3:
        raise AgentError(f'polygon has {len(corners)} corners, expected at least 3, or 0 to clear')
    if not np.isfinite(corners).all():
        raise AgentError('polygon holds corners that are not finite')
    x, y = (corners - corners[0]).T
    if abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) < 1e-6:
        raise AgentError('polygon encloses no area')
    return corners


def inside(points: Array, corners: Array) -> NDArray[np.bool_]:
    """Return whether points (N, 2) lie in a polygon (K, 2), by the even-odd rule."""
    x, y = points.T
    result = np.zeros(len(points), np.bool_)
    for (x1, y1), (x2, y2) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if y1 == y2:
            continue
        crosses = (y1 > y) != (y2 > y)
        result ^= crosses & (x < x1 + (y - y1) * (x2 - x1) / (y2 - y1))
    return result


@dataclass
class OperatorAreas:
    """The area to explore, and what is to be kept out of; nothing drawn: everything is allowed.

    area: corners (K, 2) m, None for everywhere. keep_out: corners of each area.
    """

    area: Array | None = None
    keep_out: list[Array] = field(default_factory=list)
    _known: tuple[object, NDArray[np.bool_]] | None = None

    def set_area(self, points: ArrayLike) -> None:
        """Replace the area to explore; no corners: everywhere."""
        corners = np.asarray(points, np.float64).reshape(-1, 2)
        self.area = checked_polygon(corners) if len(corners) else None
        self._known = None

    def add_keep_out(self, points: ArrayLike) -> None:
        """Add a keep-out area, once; no corners: there is none any more."""
        corners = np.asarray(points, np.float64).reshape(-1, 2)
        if not len(corners):
            self.keep_out = []
        else:
            checked = checked_polygon(corners)
            if not any(np.array_equal(checked, known) for known in self.keep_out):
                self.keep_out = [*self.keep_out, checked]
        self._known = None

    def out_of_bounds(self, grid: Grid) -> NDArray[np.bool_] | None:
        """Return which cells (H, W) must not be entered; None: all may be."""
        if self.area is None and not self.keep_out:
            return None
        key = (grid.shape, grid.origin, grid.resolution)
        if self._known is None or self._known[0] != key:
            self._known = (key, self._mask(grid))
        return self._known[1]

    def exclude(self, points: Array) -> NDArray[np.bool_]:
        """Return which points (N, 2) m no vehicle should enter."""
        mask = np.zeros(len(points), np.bool_)
        if self.area is not None:
            mask |= ~inside(points, self.area)
        for corners in self.keep_out:
            mask |= inside(points, corners)
        return mask

    def _mask(self, grid: Grid) -> NDArray[np.bool_]:
        points = grid.to_point(np.indices(grid.shape).reshape(2, -1).T)
        return self.exclude(points).reshape(grid.shape)

    def view(self, grid: Grid) -> Grid:
        """Return the grid with everything out of bounds occupied."""
        mask = self.out_of_bounds(grid)
        return grid if mask is None or not mask.any() else BoundedGrid(grid, mask)

    def area_left_out(self, grid: Grid) -> float:
        """Return the area (m²) of the grid's cells that must not be entered and are not walls."""
        mask = self.out_of_bounds(grid)
        if mask is None:
            return 0.0
        open_cells = mask & ~(grid.known() & (grid.probability() > 0.5))
        return float(np.count_nonzero(open_cells)) * math.pow(grid.resolution, 2)


class BoundedGrid:
    """View of a grid in which the cells of a mask (H, W) are known to be occupied."""

    def __init__(self, grid: Grid, mask: NDArray[np.bool_]) -> None:
        self._grid = grid
        self._mask = mask

    @property
    def resolution(self) -> float:
        """Side of a cell (m)."""
        return self._grid.resolution

    @property
    def origin(self) -> tuple[float, float]:
        """Lower left corner (m) of cell [0, 0]."""
        return self._grid.origin

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self._grid.shape

    def probability(self) -> NDArray[np.float32]:
        """Return the probability (H, W) that a cell is occupied; 1 out of bounds."""
        return np.where(self._mask, np.float32(1.0), self._grid.probability())

    def known(self) -> NDArray[np.bool_]:
        """Return whether each cell (H, W) is known; out of bounds there is nothing to find out."""
        return self._grid.known() | self._mask

    def levels(self) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
        """Return the level (H, W) of each cell, the highest one out of bounds; see Grid."""
        levels, table = self._grid.levels()
        bounded = table.copy()
        bounded[_OUT_OF_BOUNDS] = 1.0
        return np.where(self._mask, np.int16(_OUT_OF_BOUNDS), levels), bounded

    def to_cell(self, points: ArrayLike) -> NDArray[np.int64]:
        """Return the cells (N, 2) of points (N, 2) m."""
        return self._grid.to_cell(points)

    def to_point(self, cells: ArrayLike) -> Array:
        """Return the centres (N, 2) m of cells (N, 2)."""
        return self._grid.to_point(cells)
