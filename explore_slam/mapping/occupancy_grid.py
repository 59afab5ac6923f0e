"""Occupancy grid: clamped log-odds per cell; grows in any direction.

Rows are indexed by y, columns by x; `origin` is the lower left corner of cell [0, 0]. Cell edges
lie on multiples of the resolution, in whatever direction the grid has grown, so that the same
scans give the same bits.
"""

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from explore_slam.data import LaserScan
from explore_slam.errors import MappingError
from explore_slam.geometry import Array, Pose2
from explore_slam.mapping.config import GridConfig
from explore_slam.mapping.ray_model import (
    NOTHING,
    UNITS_PER_NAT,
    UNKNOWN,
    Beams,
    BeamSteps,
    Canvas,
    classify_beams,
    draw_beams,
    drop_bodies,
)

BLOCK = 64  # cells; the grid grows by whole blocks, so that it rarely has to
FARTHEST = 1e9  # m; beyond it cell numbers would overflow
NO_BODIES = np.empty((0, 3))


def _log_odds(probability: float) -> int:
    """Return the evidence of a probability."""
    return round(UNITS_PER_NAT * math.log(probability / (1.0 - probability)))


def _probability_table() -> NDArray[np.float32]:
    """Return the probability (65536,) by the bits of the evidence as uint16; 0.5 if unknown."""
    values = np.arange(65536, dtype=np.uint16).view(np.int16).astype(np.float64)
    table = 1.0 / (1.0 + np.exp(-np.clip(values / UNITS_PER_NAT, -30.0, 30.0)))
    table[UNKNOWN.view(np.uint16)] = 0.5
    return table.astype(np.float32)


_PROBABILITY = _probability_table()
_LEVELS = np.where(
    np.arange(65536) == UNKNOWN.view(np.uint16), np.float32(np.nan), _PROBABILITY
).astype(np.float32)


class PlacedScan(NamedTuple):
    """A scan and the pose of the laser in the map.

    ignore (V, 3): x, y and radius (m) of vehicles, whose bodies must not become walls.
    no_return_is_free: whether beams without return free cells, up to no_return_range.
    """

    pose: Pose2
    scan: LaserScan
    ignore: ArrayLike = NO_BODIES
    no_return_is_free: bool = True


class _Area(NamedTuple):
    """Cells of the map, without the last column (right) and row (above)."""

    left: int
    below: int
    right: int
    above: int

    @property
    def shape(self) -> tuple[int, int]:
        return self.above - self.below, self.right - self.left

    def including(self, other: '_Area') -> '_Area':
        """Return the smallest area that holds both."""
        return _Area(
            min(self.left, other.left),
            min(self.below, other.below),
            max(self.right, other.right),
            max(self.above, other.above),
        )


class OccupancyGrid:
    """Occupancy of square cells in the map frame (see explore_slam.mapping.ray_model)."""

    def __init__(self, config: GridConfig | None = None) -> None:
        self.config = config or GridConfig()
        self._first_col = self._first_row = 0
        self._evidence = np.empty((0, 0), np.int16)
        self._touched = np.empty((0, 0), np.int32)
        self._scan_number = 0
        self._steps = BeamSteps(
            _log_odds(self.config.hit_probability),
            _log_odds(self.config.miss_probability),
            _log_odds(self.config.clamp_low),
            _log_odds(self.config.clamp_high),
        )

    @classmethod
    def from_probability(
        cls,
        probability: ArrayLike,
        known: ArrayLike,
        origin: tuple[float, float] = (0.0, 0.0),
        config: GridConfig | None = None,
    ) -> 'OccupancyGrid':
        """Create a grid from probabilities (H, W) and known cells (H, W).

        The origin (m) must be a multiple of the resolution to a hundredth of a cell, because a
        grid grows by whole cells. MappingError otherwise, and for NaN in known cells.
        """
        grid = cls(config)
        p, seen = np.asarray(probability, np.float64), np.asarray(known, np.bool_)
        if p.ndim != 2 or p.shape != seen.shape:
            raise MappingError(
                f'probability has shape {p.shape} and known {seen.shape}, expected both (H, W)'
            )
        values = p[seen]
        if not (np.isfinite(values).all() and (values >= 0.0).all() and (values <= 1.0).all()):
            raise MappingError('probability holds NaN or values outside 0..1 in known cells')
        first = [grid._whole_cells(name, value) for name, value in zip('xy', origin, strict=True)]
        grid._first_col, grid._first_row = first
        low, high = grid.config.clamp_low, grid.config.clamp_high
        clipped = np.clip(np.where(seen, p, 0.5), low, high)
        evidence = np.rint(UNITS_PER_NAT * np.log(clipped / (1.0 - clipped))).astype(np.int16)
        grid._evidence = np.where(seen, evidence, UNKNOWN)
        grid._touched = np.zeros(p.shape, np.int32)
        return grid

    @classmethod
    def from_levels(
        cls,
        levels: NDArray[Any],
        probability: ArrayLike,
        origin: tuple[float, float] = (0.0, 0.0),
        config: GridConfig | None = None,
    ) -> 'OccupancyGrid':
        """Create a grid from levels (H, W), whole numbers, and the probability (K,) of each level.

        A level whose probability is NaN is unknown. As `from_probability`, in a fraction of the
        memory; MappingError for levels without a probability.
        """
        table = np.asarray(probability, np.float64)
        if levels.ndim != 2 or int(levels.max(initial=0)) >= len(table):
            raise MappingError(
                f'levels have shape {levels.shape} up to {levels.max(initial=0)}, expected (H, W) '
                f'below {len(table)}'
            )
        known = ~np.isnan(table)
        grid = cls.from_probability(table[None], known[None], origin, config)
        evidence = grid._evidence[0]
        grid._evidence = np.empty(levels.shape, np.int16)
        for first in range(0, levels.shape[0], BLOCK):
            rows = slice(first, first + BLOCK)
            grid._evidence[rows] = evidence[levels[rows]]
        grid._touched = np.zeros(levels.shape, np.int32)
        return grid

    def _whole_cells(self, name: str, value: float) -> int:
        """Return a coordinate (m) of the origin in cells."""
        cells = value / self.resolution if math.isfinite(value) else math.nan
        if not abs(cells - np.rint(cells)) < 0.01:
            raise MappingError(
                f'origin {name} is {value}, expected a multiple of resolution {self.resolution}'
            )
        return int(np.rint(cells))

    @property
    def resolution(self) -> float:
        """Side of a cell (m)."""
        return self.config.resolution

    @property
    def origin(self) -> tuple[float, float]:
        """Lower left corner (x, y) m of cell [0, 0]."""
        return self._first_col * self.resolution, self._first_row * self.resolution

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self._evidence.shape[0], self._evidence.shape[1]

    def evidence(self) -> NDArray[np.int16]:
        """Return the log-odds (H, W) in thousandths of a nat, or UNKNOWN; read-only."""
        view = self._evidence.view()
        view.flags.writeable = False
        return view

    def probability(self) -> NDArray[np.float32]:
        """Return the probability (H, W) that a cell is occupied; 0.5 where unknown."""
        return np.take(_PROBABILITY, self._evidence.view(np.uint16))

    def known(self) -> NDArray[np.bool_]:
        """Return whether a beam has touched each cell (H, W)."""
        seen: NDArray[np.bool_] = self._evidence != UNKNOWN
        return seen

    def levels(self) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
        """Return the evidence (H, W), and the probability (65536,) by its bits as uint16.

        NaN stands for unknown. Equal evidence means the same, so that changes are easily found.
        """
        return self.evidence(), _LEVELS

    def to_cell(self, points: ArrayLike) -> NDArray[np.int64]:
        """Return the cells (N, 2) (row, col) of points (N, 2) m; they may lie outside the grid."""
        scaled = np.asarray(points, np.float64).reshape(-1, 2) / self.resolution
        cells = np.floor(scaled).astype(np.int64)
        return np.stack([cells[:, 1] - self._first_row, cells[:, 0] - self._first_col], axis=1)

    def to_point(self, cells: ArrayLike) -> Array:
        """Return the centres (N, 2) m of cells (N, 2) (row, col)."""
        index = np.asarray(cells, np.int64).reshape(-1, 2)
        first = np.array([self._first_col, self._first_row])
        points: Array = (index[:, ::-1] + first + 0.5) * self.resolution
        return points

    def contains(self, cells: ArrayLike) -> NDArray[np.bool_]:
        """Return for cells (N, 2) whether they lie inside the grid."""
        index = np.asarray(cells, np.int64).reshape(-1, 2)
        return ((index >= 0) & (index < np.array(self.shape))).all(axis=1)

    def insert_scan(self, pose: Pose2, scan: LaserScan, ignore: ArrayLike = NO_BODIES) -> None:
        """Add one scan.

        pose: of the laser in the map.
        ignore (V, 3): x, y and radius (m) of vehicles, whose bodies must not become walls.
        MappingError, and the grid unchanged, if the scan does not fit into maximum_map_side.
        """
        for error in self.insert_scans([PlacedScan(pose, scan, ignore)]):
            raise error

    def insert_scans(self, scans: Iterable[PlacedScan]) -> list[MappingError]:
        """Add scans in their order; the grid grows once for all of them.

        Returns an error for each scan that is left out because it does not fit into
        maximum_map_side.
        """
        errors, prepared = list[MappingError](), list[Beams]()
        area = self._area()
        for placed in scans:
            try:
                beams = self._beams(placed)
                if beams is None:
                    continue
                area = self._area_with(area, beams)
            except MappingError as error:
                errors.append(error)
                continue
            prepared.append(beams)
        if area is not None and area != self._area():
            self._grow(area)
        for beams in prepared:
            self._draw(beams)
        return errors

    def _beams(self, placed: PlacedScan) -> Beams | None:
        """Return the beams of a scan that change the grid, in m; None if none of them do."""
        pose, scan, config = placed.pose, placed.scan, self.config
        bodies = np.asarray(placed.ignore, np.float64).reshape(-1, 3)
        if not pose.is_finite() or not np.isfinite(bodies).all():
            raise MappingError(f'pose {tuple(pose)} or bodies {bodies.tolist()} are not finite')
        lengths, kinds = classify_beams(
            scan.ranges,
            scan.range_min,
            scan.range_max,
            config.max_laser_range,
            config.no_return_range if placed.no_return_is_free else 0.0,
        )
        beams = Beams(pose.x, pose.y, scan.angles + pose.theta, lengths, kinds)
        if len(bodies):
            drop_bodies(beams, bodies)
        return beams if (kinds != NOTHING).any() else None

    def _draw(self, beams: Beams) -> None:
        self._scan_number += 1
        scale = self.resolution
        draw_beams(
            Canvas(
                self._evidence,
                self._touched,
                self._first_row,
                self._first_col,
                self._scan_number,
                self._steps,
            ),
            beams._replace(x=beams.x / scale, y=beams.y / scale, lengths=beams.lengths / scale),
        )

    def _area(self) -> _Area | None:
        """Return the cells that the grid covers; None if it is empty."""
        rows, cols = self.shape
        if not rows:
            return None
        col, row = self._first_col, self._first_row
        return _Area(col, row, col + cols, row + rows)

    def _area_with(self, area: _Area | None, beams: Beams) -> _Area:
        """Return an area that holds the laser and the ends of all beams, with a margin of a cell.

        area: to extend. MappingError if the result is too large for a grid.
        """
        ends_x = beams.x + np.append(beams.lengths * np.cos(beams.headings), 0.0)
        ends_y = beams.y + np.append(beams.lengths * np.sin(beams.headings), 0.0)
        corners = np.array([[ends_x.min(), ends_y.min()], [ends_x.max(), ends_y.max()]])
        if np.abs(corners).max() > FARTHEST:
            raise MappingError(f'a laser at ({beams.x}, {beams.y}) lies too far out for a grid')
        cells = np.floor(corners / self.resolution).astype(np.int64) + np.array([[-1], [2]])
        (left, below), (right, above) = cells.tolist()
        needed = _Area(left, below, right, above)
        if area is not None and area.including(needed) == area:
            return area
        grown = _Area(
            left // BLOCK * BLOCK,
            below // BLOCK * BLOCK,
            -(-right // BLOCK) * BLOCK,
            -(-above // BLOCK) * BLOCK,
        )
        if area is not None:
            grown = area.including(grown)
        side = max(grown.right - grown.left, grown.above - grown.below) * self.resolution
        if side > self.config.maximum_map_side:
            raise MappingError(
                f'a scan at ({beams.x}, {beams.y}) needs a grid of {side:.0f} m, '
                f'expected at most maximum_map_side = {self.config.maximum_map_side:.0f} m'
            )
        return grown

    def _grow(self, area: _Area) -> None:
        """Extend the arrays to an area that holds the present one."""
        evidence = np.full(area.shape, UNKNOWN, np.int16)
        rows, cols = self.shape
        if rows:
            row, col = self._first_row - area.below, self._first_col - area.left
            evidence[row : row + rows, col : col + cols] = self._evidence
        self._evidence = evidence
        # what an earlier scan has touched does not matter to the next one
        self._touched = np.zeros(area.shape, np.int32)
        self._first_col, self._first_row = area.left, area.below

    def extended(self, row: int, column: int, rows: int, columns: int) -> 'OccupancyGrid':
        """Return a copy that holds further cells; row, column: counted from the map's origin."""
        other = self.copy()
        needed = _Area(column, row, column + columns, row + rows)
        area = other._area()
        needed = needed if area is None else area.including(needed)
        if needed != area:
            other._grow(needed)
        return other

    def offset_of(self, row: int, column: int) -> tuple[int, int]:
        """Return the indices of a cell whose row and column are counted from the map's origin."""
        return row - self._first_row, column - self._first_col

    def occupy(self, cells: NDArray[np.bool_]) -> None:
        """Make cells (H, W) certain obstacles."""
        self._evidence[cells] = self._steps.high

    @property
    def nbytes(self) -> int:
        """Memory of the evidence."""
        return self._evidence.nbytes

    def to_percent(self) -> NDArray[np.int8]:
        """Return the probability (H, W) that a cell is occupied in percent; -1 where unknown."""
        percent = np.rint(self.probability() * 100.0).astype(np.int8)
        percent[~self.known()] = -1
        return percent

    def to_trinary(self) -> NDArray[np.int8]:
        """Return the values (H, W) that map_server publishes: 0 free, 100 occupied, -1 unknown.

        Known cells between map_free_threshold and map_occupied_threshold are unknown, as in map
        files. Consumers compare with these very values: AMCL takes 0 and 100 alone, the
        StaticLayer of nav2 takes every value below lethal_cost_threshold (100) as free.
        """
        probability, known = self.probability(), self.known()
        cells = np.full(self.shape, -1, np.int8)
        cells[known & (probability <= self.config.map_free_threshold)] = 0
        cells[known & (probability >= self.config.map_occupied_threshold)] = 100
        return cells

    def copy(self) -> 'OccupancyGrid':
        """Return an independent copy."""
        other = OccupancyGrid(self.config)
        other._first_col, other._first_row = self._first_col, self._first_row
        other._evidence = self._evidence.copy()
        other._touched = np.zeros(self.shape, np.int32)
        return other
