"""Obstacles that depth cameras see: a layer of the map along the most likely path.

The layer has slices of height. A reading in a slice is evidence for an obstacle there, a ray
through it evidence against, as in the occupancy grid (explore_slam.mapping.ray_model). What passes
below a table, beams of a laser or rays of a camera, does not touch the slice of its top. A cell is
an obstacle if any of its slices is.
"""

import logging
import math
import zlib
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from explore_slam.compiled import kernel
from explore_slam.data import HOLE_BIT, OBSTACLE_CELL, ObstacleView
from explore_slam.errors import MappingError
from explore_slam.geometry import IDENTITY, Array, Pose2, to_world
from explore_slam.mapping.config import GridConfig
from explore_slam.mapping.occupancy_grid import BLOCK, FARTHEST, NO_BODIES, OccupancyGrid
from explore_slam.mapping.path_drawing import PathDrawing, VehicleDisc

logger = logging.getLogger(__name__)
SLICES = HOLE_BIT + 1
UNITS_PER_NAT = 10.0  # resolution of the evidence, which fits an int8 up to 12.7 nat
# Readings of a wall reach this far (m) behind its face, where no laser looks: three standard
# deviations of a Kinect's noise at 3 m (0.003 z²) and half a cell
_BEHIND_WALL = 0.1


class PlacedView(NamedTuple):
    """A view and the pose of the vehicle in the map; ignore (V, 3): bodies, as of PlacedScan."""

    pose: Pose2
    view: ObstacleView
    ignore: ArrayLike = NO_BODIES


class _Steps(NamedTuple):
    """Evidence of a reading and of a ray that passes, and the limits of a slice."""

    hit: int
    miss: int
    low: int
    high: int


class _Window(NamedTuple):
    """Bits of a view by row and column from the first ones on."""

    occupied: NDArray[np.uint16]
    free: NDArray[np.uint16]
    first_row: int
    first_column: int


class ObstacleGrid:
    """Evidence for obstacles by cell of the map and slice of height; cells as of OccupancyGrid."""

    def __init__(self, config: GridConfig | None = None) -> None:
        self.config = config or GridConfig()
        self._first_col = self._first_row = 0
        self._evidence = np.zeros((0, 0, SLICES), np.int8)
        self._count = np.zeros((0, 0), np.uint8)  # slices of a cell that are obstacles
        hit, miss, high = (
            round(UNITS_PER_NAT * math.log(p / (1.0 - p)))
            for p in (
                self.config.hit_probability,
                self.config.miss_probability,
                self.config.clamp_high,
            )
        )
        # two views are enough for an obstacle, however often the camera had looked through before
        self._steps = _Steps(min(hit, 127), max(miss, -127), max(-hit, -127), min(high, 127))

    @property
    def nbytes(self) -> int:
        """Memory of the evidence."""
        return self._evidence.nbytes + self._count.nbytes

    @property
    def first_cell(self) -> tuple[int, int]:
        """Row and column of cell [0, 0], counted from that at the origin of the map."""
        return self._first_row, self._first_col

    def obstacles(self) -> NDArray[np.bool_]:
        """Return which cells (H, W) are obstacles."""
        found: NDArray[np.bool_] = self._count > 0
        return found

    def looked_at(self) -> NDArray[np.bool_]:
        """Return through which cells (H, W), above the floor, a camera has looked."""
        found: NDArray[np.bool_] = self._evidence.any(axis=2)
        return found

    def insert(self, placed: PlacedView) -> None:
        """Add a view; MappingError, and no change, if it does not fit into maximum_map_side."""
        view, pose = placed.view, placed.pose
        bodies = np.asarray(placed.ignore, np.float64).reshape(-1, 3)
        if not pose.is_finite() or not np.isfinite(bodies).all():
            raise MappingError(f'pose {tuple(pose)} or bodies {bodies.tolist()} are not finite')
        if not len(view):
            return
        window = _window(view)
        scale = self.config.resolution
        rows, columns = window.occupied.shape
        ends = [
            (window.first_column + column, window.first_row + row)
            for row in (0, rows)
            for column in (0, columns)
        ]
        corners = to_world(pose, np.array(ends) * OBSTACLE_CELL)
        if np.abs(corners).max() > FARTHEST:
            raise MappingError(f'a camera at ({pose.x}, {pose.y}) lies too far out for a grid')
        left, below = np.floor(corners.min(axis=0) / scale).astype(int).tolist()
        right, above = np.ceil(corners.max(axis=0) / scale).astype(int).tolist()
        self._grow(left, below, right, above)
        _draw(
            self._evidence,
            self._count,
            (self._first_row, self._first_col),
            (below, left, above, right),
            window,
            (pose.x, pose.y, pose.theta),
            scale,
            max(1, math.ceil(scale / OBSTACLE_CELL - 1e-9)),
            bodies,
            self._steps,
        )

    def _grow(self, left: int, below: int, right: int, above: int) -> None:
        """Extend the arrays by whole blocks to hold these columns and rows."""
        rows, columns = self._count.shape
        if rows:
            left, below = min(left, self._first_col), min(below, self._first_row)
            right = max(right, self._first_col + columns)
            above = max(above, self._first_row + rows)
        left, below = left // BLOCK * BLOCK, below // BLOCK * BLOCK
        right, above = -(-right // BLOCK) * BLOCK, -(-above // BLOCK) * BLOCK
        if (left, below, right, above) == (
            self._first_col,
            self._first_row,
            self._first_col + columns,
            self._first_row + rows,
        ):
            return
        side = max(right - left, above - below) * self.config.resolution
        if side > self.config.maximum_map_side:
            raise MappingError(
                f'a view needs a grid of {side:.0f} m, expected at most maximum_map_side = '
                f'{self.config.maximum_map_side:.0f} m'
            )
        evidence = np.zeros((above - below, right - left, SLICES), np.int8)
        count = np.zeros((above - below, right - left), np.uint8)
        if rows:
            place = np.s_[
                self._first_row - below : self._first_row - below + rows,
                self._first_col - left : self._first_col - left + columns,
            ]
            evidence[place], count[place] = self._evidence, self._count
        self._evidence, self._count = evidence, count
        self._first_col, self._first_row = left, below

    def copy(self) -> 'ObstacleGrid':
        """Return an independent copy."""
        other = ObstacleGrid(self.config)
        other._first_col, other._first_row = self._first_col, self._first_row
        other._evidence, other._count = self._evidence.copy(), self._count.copy()
        return other


def _window(view: ObstacleView) -> _Window:
    """Return the cells of a view as arrays."""
    low = view.cells.min(axis=0).astype(int)
    high = view.cells.max(axis=0).astype(int)
    shape = (int(high[1] - low[1]) + 1, int(high[0] - low[0]) + 1)
    occupied, free = np.zeros(shape, np.uint16), np.zeros(shape, np.uint16)
    rows, columns = view.cells[:, 1] - low[1], view.cells[:, 0] - low[0]
    occupied[rows, columns], free[rows, columns] = view.occupied, view.free
    return _Window(occupied, free, int(low[1]), int(low[0]))


@kernel
def _look_up(
    window: _Window, x: float, y: float, pose: tuple[float, float, float], side: float, parts: int
) -> tuple[np.uint16, np.uint16]:
    """Return what a view shows at parts x parts points of the cell with a centre x, y (m)."""
    occupied, free = np.uint16(0), np.uint16(0)
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    rows, columns = window.occupied.shape
    for part in range(parts * parts):
        dx = x + ((part % parts + 0.5) / parts - 0.5) * side - pose[0]
        dy = y + ((part // parts + 0.5) / parts - 0.5) * side - pose[1]
        u = math.floor((cos * dx + sin * dy) / OBSTACLE_CELL) - window.first_column
        v = math.floor((cos * dy - sin * dx) / OBSTACLE_CELL) - window.first_row
        if 0 <= u < columns and 0 <= v < rows:
            occupied |= window.occupied[v, u]
            free |= window.free[v, u]
    return occupied, free & ~occupied


@kernel
def _is_hidden(bodies: Array, x: float, y: float) -> bool:
    """Return whether a point (m) lies in a disc."""
    for body in range(bodies.shape[0]):
        dx, dy = x - bodies[body, 0], y - bodies[body, 1]
        if dx * dx + dy * dy <= bodies[body, 2] * bodies[body, 2]:
            return True
    return False


@kernel
def _draw(
    evidence: NDArray[np.int8],
    count: NDArray[np.uint8],
    first: tuple[int, int],
    area: tuple[int, int, int, int],
    window: _Window,
    pose: tuple[float, float, float],
    scale: float,
    parts: int,
    bodies: Array,
    steps: _Steps,
) -> None:
    """Add a view to the cells of an area (rows and columns of the map).

    Every cell looks up what the view shows there, so that the rotation of the cells of the view
    leaves no gaps.
    """
    for row in range(area[0], area[2]):
        for column in range(area[1], area[3]):
            x, y = (column + 0.5) * scale, (row + 0.5) * scale
            occupied, free = _look_up(window, x, y, pose, scale, parts)
            if occupied | free == 0 or _is_hidden(bodies, x, y):
                continue
            r, c = row - first[0], column - first[1]
            for piece in range(SLICES):
                bit = np.uint16(1 << piece)
                if (occupied | free) & bit == 0:
                    continue
                before = int(evidence[r, c, piece])
                step = steps.hit if occupied & bit != 0 else steps.miss
                after = min(max(before + step, steps.low), steps.high)
                evidence[r, c, piece] = after
                count[r, c] += np.uint8(after > 0) - np.uint8(before > 0)


class _Sensed(Protocol):
    @property
    def sensor(self) -> str:
        """Which camera of the vehicle it is from."""


class KeyframeView[View: _Sensed](NamedTuple):
    """A view with its keyframe, the pose of the vehicle relative to it, and other vehicles."""

    keyframe: int
    vehicle: str
    view: View
    vehicle_in_keyframe: Pose2
    bodies: tuple[VehicleDisc, ...]

    @property
    def sensor(self) -> str:
        """Which camera of the vehicle it is from."""
        return self.view.sensor


class _PackedView:
    """A view as it is stored, for a map keeps many: a twelfth of the size in the office."""

    def __init__(self, view: ObstacleView) -> None:
        self._stamp, self._count, self.sensor = view.stamp, len(view), view.sensor
        # the cells follow one another row by row: most steps between them are alike
        steps = np.diff(view.cells, axis=0, prepend=np.zeros((1, 2), np.int16))
        parts = (steps[:, 0], steps[:, 1], view.occupied, view.free)
        self._data = zlib.compress(b''.join(part.tobytes() for part in parts), level=1)

    def unpack(self) -> ObstacleView:
        """Return the view."""
        words = np.frombuffer(zlib.decompress(self._data), np.uint16).reshape(4, self._count)
        cells = np.cumsum(words[:2].view(np.int16).T, axis=0, dtype=np.int16)
        return ObstacleView(self._stamp, cells, words[2], words[3], self.sensor)


class ObstacleMap(PathDrawing[KeyframeView[_PackedView], ObstacleGrid]):
    """Views of depth cameras with their keyframes, and the layer along the path."""

    def __init__(self, config: GridConfig | None = None) -> None:
        self.config = config or GridConfig()
        super().__init__(self.config.snapshot_memory)

    def _empty(self) -> ObstacleGrid:
        return ObstacleGrid(self.config)

    @property
    def layer(self) -> ObstacleGrid:
        """The layer as it was drawn last."""
        return self._canvas

    @property
    def views(self) -> Sequence[KeyframeView[ObstacleView]]:
        """The views that are kept, in the order in which they were added."""
        return tuple(
            KeyframeView(
                item.keyframe,
                item.vehicle,
                item.view.unpack(),
                item.vehicle_in_keyframe,
                item.bodies,
            )
            for item in self._held()
        )

    def add(
        self,
        keyframe: int,
        vehicle: str,
        view: ObstacleView,
        vehicle_in_keyframe: Pose2 = IDENTITY,
        bodies: Sequence[VehicleDisc] = (),
    ) -> None:
        """Store a view; it enters the layer at the next redraw whose path holds its keyframes."""
        packed = _PackedView(view)
        self._append(KeyframeView(keyframe, vehicle, packed, vehicle_in_keyframe, tuple(bodies)))

    def _pose(self, item: KeyframeView[_PackedView]) -> Pose2:
        return Pose2(*self._path[item.keyframe].tolist()).compose(item.vehicle_in_keyframe)

    def _draw_items(self, items: Sequence[KeyframeView[_PackedView]]) -> int:
        refused = 0
        for item in items:
            try:
                placed = PlacedView(self._pose(item), item.view.unpack(), self._discs(item))
                self.layer.insert(placed)
            except MappingError as error:
                logger.warning('%s', error)
                refused += 1
        return refused


def with_obstacles(grid: OccupancyGrid, layer: ObstacleGrid) -> OccupancyGrid:
    """Return a grid in which the obstacles of the layer are occupied; grid itself without any.

    What a laser has not seen to be free within _BEHIND_WALL of what it has seen to be occupied is
    the noise of a wall, not an obstacle behind it.
    """
    found = layer.obstacles()
    if not found.any():
        return grid
    merged = grid.extended(*layer.first_cell, *found.shape)
    (row, column), (rows, columns) = merged.offset_of(*layer.first_cell), found.shape
    probability = merged.probability()
    occupied = merged.known() & (probability > merged.config.map_occupied_threshold)
    reach = math.ceil(_BEHIND_WALL / merged.resolution - 1e-9)
    around = cv2.dilate(occupied.astype(np.uint8), np.ones((2 * reach + 1, 2 * reach + 1)))
    seen_free = merged.known() & (probability <= merged.config.map_free_threshold)
    place = np.s_[row : row + rows, column : column + columns]
    mask = np.zeros(merged.shape, np.bool_)
    mask[place] = found
    merged.occupy(mask & (seen_free | (around == 0)))
    return merged


def cells_looked_at(grid: OccupancyGrid, layer: ObstacleGrid) -> NDArray[np.bool_]:
    """Return through which cells (H, W) of a grid, above the floor, a camera has looked."""
    seen, found = np.zeros(grid.shape, np.bool_), layer.looked_at()
    row, column = grid.offset_of(*layer.first_cell)
    low, high = max(row, 0), min(row + found.shape[0], grid.shape[0])
    left, right = max(column, 0), min(column + found.shape[1], grid.shape[1])
    if low < high and left < right:
        seen[low:high, left:right] = found[low - row : high - row, left - column : right - column]
    return seen
