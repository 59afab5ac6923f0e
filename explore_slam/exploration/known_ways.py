"""Ways that are blocked, but would be free without what may go away again.

What may go away is an obstacle in cells through which vehicles could pass before, and one that
stands alone and is no larger than a person.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from explore_slam.exploration.clearance import CostMap, squared_distance
from explore_slam.exploration.records import Grid

Mask = NDArray[np.bool_]

# Chosen by hand; the tests of the planner show what they decide.
_PERSON = 0.9  # m; the side of the box around an obstacle that may be a person
_SHADOW = 1.5  # m behind such an obstacle, where unknown cells may be passable


class KnownWays:
    """The cells that were passable in any cycle; it follows the grid as that grows."""

    def __init__(self) -> None:
        self._passable = np.zeros((0, 0), np.bool_)
        self._first = (0, 0)  # row and column of cell [0, 0], from the origin of the map frame
        self._resolution = 0.0

    def update(self, grid: Grid, costs: CostMap) -> None:
        """Add the cells (H, W) of a grid that are passable now."""
        scale, (x, y) = grid.resolution, grid.origin
        first = round(y / scale), round(x / scale)
        if (first, grid.shape, scale) != (self._first, self._passable.shape, self._resolution):
            kept = scale == self._resolution
            self._passable = self._moved(self._passable, first, grid.shape, kept=kept)
            self._first, self._resolution = first, scale
        self._passable |= np.isfinite(costs.cost)

    def blocked(
        self, costs: CostMap, radius: float, forbidden: Mask | None = None, *, people: bool
    ) -> Mask:
        """Return the cells (H, W) that are blocked only by what may go away; after `update`.

        radius: that paths keep from obstacles (m). forbidden (H, W): cells that stay closed.
        people: whether that includes small obstacles that were never seen to come.
        """
        scale = self._resolution
        closed = ~costs.free & ~costs.unknown
        obstacles = closed if forbidden is None else closed & ~forbidden
        cells = math.ceil(radius / scale) + 1
        doubtful = obstacles & self._passable
        lost = self._passable & (squared_distance(doubtful, cells) <= cells * cells)
        if people:
            doubtful |= _small(obstacles, math.ceil(_PERSON / scale))
        kept = squared_distance(closed & ~doubtful, cells)
        reach = math.ceil(_SHADOW / scale)
        shadow = costs.unknown & (squared_distance(doubtful, reach) <= reach * reach)
        would_be_free = (kept > (radius / scale) ** 2) & (~costs.unknown | shadow)
        return (would_be_free | lost) & ~np.isfinite(costs.cost)

    def _moved(
        self, mask: Mask, first: tuple[int, int], shape: tuple[int, int], *, kept: bool
    ) -> Mask:
        """Return a mask laid over a grid of another size or place; empty unless it is kept."""
        moved = np.zeros(shape, np.bool_)
        if kept:
            row, col = (old - new for old, new in zip(self._first, first, strict=True))
            height, width = mask.shape
            part = moved[max(0, row) : max(0, row + height), max(0, col) : max(0, col + width)]
            old = mask[max(0, -row) :, max(0, -col) :][: part.shape[0], : part.shape[1]]
            part[: old.shape[0], : old.shape[1]] = old
        return moved


def _small(obstacles: Mask, largest: int) -> Mask:
    """Return the obstacles (H, W) whose box is at most `largest` cells high and wide."""
    labels, count = ndimage.label(obstacles, np.ones((3, 3)))
    small = np.zeros(count + 1, np.bool_)
    for index, box in enumerate(ndimage.find_objects(labels)):
        small[index + 1] = all(side.stop - side.start <= largest for side in box)
    found: Mask = small[labels]
    return found
