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
from explore_slam.exploration.tiles import TILE, moved, tiles_of

Mask = NDArray[np.bool_]

# Chosen by hand; the tests of the planner show what they decide.
_PERSON = 0.9  # m; the side of the box around an obstacle that may be a person
_SHADOW = 1.5  # m behind such an obstacle, where unknown cells may be passable


class KnownWays:
    """The cells that were passable in any cycle; it follows the grid as that grows.

    They are kept as bits, eight cells of a row to a byte.
    """

    def __init__(self) -> None:
        self._shape = (0, 0)
        self._bits = np.zeros((0, 0), np.uint8)
        self._first = (0, 0)  # row and column of cell [0, 0], from the origin of the map frame
        self._resolution = 0.0

    def update(self, grid: Grid, costs: CostMap, changed: Mask | None = None) -> None:
        """Add the cells (H, W) of a grid that are passable now.

        changed (R, C): tiles whose costs have changed since the last update; by default all.
        """
        scale, (x, y) = grid.resolution, grid.origin
        first = round(y / scale), round(x / scale)
        if (first, grid.shape, scale) != (self._first, self._shape, self._resolution):
            if scale != self._resolution:
                self._shape, self._bits = (0, 0), np.zeros((0, 0), np.uint8)
            shift = self._first[0] - first[0], self._first[1] - first[1]
            self._bits = np.packbits(moved(self._passable(), shift, grid.shape, False), axis=1)
            self._first, self._shape, self._resolution = first, grid.shape, scale
        if changed is None:
            changed = np.ones(tiles_of(grid.shape), np.bool_)
        for tile in np.argwhere(changed):
            low, high = tile * TILE, tile * TILE + TILE
            passable = np.isfinite(costs.cost[low[0] : high[0], low[1] : high[1]])
            bits = np.packbits(passable, axis=1)
            first_byte = low[1] // 8  # tiles begin with a byte
            part = slice(first_byte, first_byte + bits.shape[1])
            self._bits[low[0] : high[0], part] |= bits

    def _passable(self) -> Mask:
        """Return the cells (H, W) that were passable."""
        cells = np.unpackbits(self._bits, axis=1, count=self._shape[1])
        return cells.view(np.bool_)

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
        passable = self._passable()
        doubtful = obstacles & passable
        lost = passable & (squared_distance(doubtful, cells) <= cells * cells)
        if people:
            doubtful |= _small(obstacles, math.ceil(_PERSON / scale))
        kept = squared_distance(closed & ~doubtful, cells)
        reach = math.ceil(_SHADOW / scale)
        shadow = costs.unknown & (squared_distance(doubtful, reach) <= reach * reach)
        would_be_free = (kept > (radius / scale) ** 2) & (~costs.unknown | shadow)
        return (would_be_free | lost) & ~np.isfinite(costs.cost)


def _small(obstacles: Mask, largest: int) -> Mask:
    """Return the obstacles (H, W) whose box is at most `largest` cells high and wide."""
    labels, count = ndimage.label(obstacles, np.ones((3, 3)))
    small = np.zeros(count + 1, np.bool_)
    for index, box in enumerate(ndimage.find_objects(labels)):
        small[index + 1] = all(side.stop - side.start <= largest for side in box)
    found: Mask = small[labels]
    return found
