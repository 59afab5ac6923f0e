"""Frontiers: clusters of free cells beside unknown ones, with viewpoints.

B. Yamauchi, "A frontier-based approach for autonomous exploration", CIRA 1997. A frontier cell is
a known free cell with an unknown neighbour (4-neighbourhood); isolated unknown cells, as between
far beams, do not count. Connected frontier cells (8-neighbourhood) are one cluster. Long clusters
are split along their main direction; short ones, and those with little unknown area behind them,
are dropped. The target of a frontier is a viewpoint: a cell in or near it where a vehicle fits.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.exploration.clearance import CostMap, make_cost_map
from explore_slam.exploration.config import ExplorationConfig
from explore_slam.exploration.frontier_kernels import (
    SQUARE,
    Viewpoints,
    find_viewpoint,
    frontier_cells,
    frontier_clusters,
    pocket_size,
    visible_unknown,
)
from explore_slam.exploration.records import Cell, Frontier, Grid
from explore_slam.exploration.regions import along_main_direction, cut_across
from explore_slam.exploration.sections import FrontierConfig
from explore_slam.exploration.sparse_memory import SparseArray

# Chosen by hand; `explore_slam benchmark exploration` measures what another value does
_RAYS = 40  # by which the unknown area in sight of a viewpoint is estimated
_NEAR_RANGE = 3.0  # m from a viewpoint within which the unknown area in sight decides on a visit
_NEAR_RAYS = 120  # for that area, of which specks are a part
_WIDE = 1.5  # m; a frontier as long as this shows all that is in sight behind it
_DOORWAY = 0.9  # m; a frontier that a vehicle can pass, with a room behind, counts as this long
_NARROW_FACTOR = 0.6  # on the gain of a frontier through which no vehicle fits
_POCKET_AREA = 6.0  # m²; smaller unknown areas are measured instead of estimated
_LARGEST_MARK = 3 * 5000  # of 5000 pieces of clusters; then the scratch memory is given back
_LOOKS_AROUND = 3  # cells from a cell to those that decide whether a frontier begins there


def expected_area(unknown: float, reach: float) -> float:
    """Return the free area (m²) that is expected to be seen, given the unknown area (m²) in sight.

    reach: range of the sensor (m).
    Walls and what lies behind them are unknown too: the smaller the unknown part of the view, the
    smaller the fraction of it that proves free. The coefficients come from a fit to 4320 frontiers
    of an office building (mean of the new reachable area seen from their targets). The fit is not
    part of the repository; `explore_slam benchmark exploration` measures what others do.
    """
    view = math.pi * reach * reach
    fraction = unknown / view
    return view * min(0.44 * fraction * fraction, 0.15 * fraction)


def expected_showing(unknown: float, size: float) -> float:
    """Return the area (m²) that a visit to a frontier is expected to show at least.

    unknown: unknown area (m²) in sight within a few metres. size: length of the frontier (m).
    What remains at the end of a run are gaps between beams and the inside of furniture: the
    shorter a frontier, the smaller the share of the unknown area that proves free. Of 1500
    frontiers late in runs on three maps, those shorter than 0.65 m showed 0.05 m² on average,
    those between 0.85 and 1.2 m 0.5 m²; the square fits both.
    """
    return unknown * min(1.0, size / _WIDE) ** 2


def find_frontiers(
    grid: Grid,
    config: ExplorationConfig | None = None,
    cost_map: CostMap | None = None,
    reachable: NDArray[np.bool_] | None = None,
    cache: 'FrontierCache | None' = None,
) -> list[Frontier]:
    """Return the frontiers of a grid that have a viewpoint, in the order of their cells.

    cost_map: by default that of make_cost_map.
    reachable (H, W): cells that some vehicle can get to; by default all cells where one fits.
    cache: of the last search with the same settings, so that only what has changed is evaluated.
    """
    settings = config or ExplorationConfig()
    if 0 in grid.shape:
        return []
    costs = cost_map or make_cost_map(grid, settings.paths)
    viewpoints = np.isfinite(costs.cost) if reachable is None else reachable
    return _frontiers_of(grid, settings.frontiers, costs, viewpoints, cache)


class _Candidate(NamedTuple):
    """A piece of a cluster: cells (N, 2), viewpoint, centre of what is behind it.

    gain, showing: see Frontier (m²).
    """

    cells: NDArray[np.int64]
    viewpoint: Cell
    behind: tuple[float, float]
    gain: float
    showing: float


class FrontierCache:
    """What was found out about clusters of frontier cells in the last search.

    todo (R, C): squares of 64 x 64 cells in which something has changed since. region: which cells
    were possible viewpoints, as a number.
    """

    def __init__(self, region: int, tiles: tuple[int, ...]) -> None:
        self.region = region
        self.todo = np.zeros(tiles, np.bool_)
        self._marks, self._mark = SparseArray(0, np.int32), 0
        self._config: tuple[FrontierConfig, float] | None = None
        # by the cells of a cluster: what was found, and the squares on which that depends
        self._known: dict[bytes, tuple[list[_Candidate], tuple[slice, slice]]] = {}
        self._seen: dict[bytes, tuple[list[_Candidate], tuple[slice, slice]]] = {}

    def begin(self, config: FrontierConfig, scale: float) -> None:
        """Begin a search with some settings and cells of a size (m)."""
        if self._config != (config, scale):
            self._known.clear()
        self._config, self._seen = (config, scale), {}

    def get(self, cells: NDArray[np.int64]) -> list[_Candidate] | None:
        """Return the candidates of a cluster (N, 2) if nothing has changed around it."""
        key = cells.tobytes()
        known = self._known.get(key)
        if known is None or self.todo[known[1]].any():
            return None
        self._seen[key] = known
        return known[0]

    def set(self, cells: NDArray[np.int64], found: list[_Candidate], box: '_Box') -> None:
        """Store the candidates of a cluster (N, 2), which depend on the cells of a box."""
        self._seen[cells.tobytes()] = found, box.squares()

    def marks(self, shape: tuple[int, int]) -> tuple[NDArray[np.int32], int]:
        """Return scratch memory (H, W) for the searches, and the largest value in it."""
        size = shape[0] * shape[1]
        if self._marks.values.size != size:
            self._marks, self._mark = SparseArray(size, np.int32), 0
        elif self._mark > _LARGEST_MARK:
            self._marks.clear()
            self._mark = 0
        return self._marks.values.reshape(shape), self._mark

    def end(self, mark: int) -> None:
        """End a search: clusters that were not part of it are forgotten.

        mark: largest value in the scratch memory.
        """
        self._mark = mark
        self._known, self._seen = self._seen, {}
        self.todo[:] = False


class _Box(NamedTuple):
    """Cells on which something depends: first and last row, first and last column."""

    low_row: int
    high_row: int
    low_col: int
    high_col: int

    @classmethod
    def around(cls, cells: NDArray[np.int64]) -> '_Box':
        """Return the box around cells (N, 2)."""
        (low_row, low_col), (high_row, high_col) = (
            cells.min(axis=0).tolist(),
            cells.max(axis=0).tolist(),
        )
        return cls(low_row, high_row, low_col, high_col)

    def extended(self, margin: int) -> '_Box':
        """Return the box with a margin (cells)."""
        return _Box(
            self.low_row - margin,
            self.high_row + margin,
            self.low_col - margin,
            self.high_col + margin,
        )

    def squares(self) -> tuple[slice, slice]:
        """Return the squares of cells that share cells with the box."""
        return (
            slice(max(0, self.low_row) // SQUARE, self.high_row // SQUARE + 1),
            slice(max(0, self.low_col) // SQUARE, self.high_col // SQUARE + 1),
        )

    def joined(self, other: '_Box') -> '_Box':
        """Return the box around both."""
        return _Box(
            min(self.low_row, other.low_row),
            max(self.high_row, other.high_row),
            min(self.low_col, other.low_col),
            max(self.high_col, other.high_col),
        )


def _frontiers_of(
    grid: Grid,
    config: FrontierConfig,
    costs: CostMap,
    viewpoints: NDArray[np.bool_],
    cache: FrontierCache | None,
) -> list[Frontier]:
    cells, lengths = frontier_clusters(
        costs.frontiers or frontier_cells(costs.free, costs.unknown)
    )
    scale = grid.resolution
    smallest = max(1, round(config.min_frontier_size / scale))
    largest = max(1, round(config.max_frontier_size / scale))
    candidates: list[_Candidate] = []
    end = 0
    if cache is None:
        marks, mark = np.zeros(grid.shape, np.int32), 0
    else:
        cache.begin(config, scale)
        marks, mark = cache.marks(grid.shape)
    for length in lengths.tolist():
        start, end = end, end + length
        if length < smallest:
            continue
        cluster = cells[start:end]
        known = None if cache is None else cache.get(cluster)
        if known is None:
            known, box = [], None
            for part in _split(cluster, largest):
                mark += 3  # one for each of the three searches
                candidate, needed = _candidate(part, scale, config, costs, viewpoints, marks, mark)
                box = needed if box is None else box.joined(needed)
                if candidate is not None:
                    known.append(candidate)
            if cache is not None and box is not None:
                cache.set(cluster, known, box)
        candidates += known
    if cache is not None:
        cache.end(mark)
    return _records(grid, candidates)


def _candidate(
    part: NDArray[np.int64],
    scale: float,
    config: FrontierConfig,
    costs: CostMap,
    possible: NDArray[np.bool_],
    marks: NDArray[np.int32],
    mark: int,
) -> tuple[_Candidate | None, _Box]:
    """Return viewpoint and gain of a piece of a cluster (N, 2), None if it is not worth a visit.

    scale: side of a cell (m). possible: cells (H, W) that will do as viewpoints; those with room
    for errors are preferred. marks (H, W): scratch, without the values from mark to mark + 2.
    The box holds all cells that the result depends on.
    """
    area = scale * scale
    reach = round(config.viewpoint_distance / scale)
    box = _Box.around(part).extended(reach + _LOOKS_AROUND)
    viewpoints = Viewpoints(possible, costs.squared)
    row, col = find_viewpoint(costs.free, viewpoints, costs.roomy, marks, mark, part, reach)
    if row < 0:
        row, col = find_viewpoint(costs.free, viewpoints, 0, marks, mark + 1, part, reach)
    if row < 0:
        return None, box
    limit = round(_POCKET_AREA / area)
    pocket, *behind, around = pocket_size(costs.unknown, marks, mark + 2, part, limit)
    box = box.joined(_Box(*around.tolist()).extended(_LOOKS_AROUND))
    gain = area * pocket
    close = int(min(_NEAR_RANGE, config.sensor_range) / scale)
    near = area * visible_unknown(costs.free, costs.unknown, row, col, close, _NEAR_RAYS)
    viewpoint = _Box(row, row, col, col)
    box = box.joined(viewpoint.extended(close + 1))
    size, leads_on = len(part) * scale, bool(possible[part[:, 0], part[:, 1]].any())
    if leads_on and pocket >= limit:
        size = max(size, _DOORWAY)
    showing = expected_showing(min(gain, near), size)
    if showing < config.min_frontier_gain:
        return None, box
    if pocket >= limit:
        # The area in sight of the viewpoint is a rough estimate: it ranks frontiers, and drops
        # only narrow ones, through which no vehicle fits.
        sensor = int(config.sensor_range / scale)
        box = box.joined(viewpoint.extended(sensor + 1))
        seen = visible_unknown(costs.free, costs.unknown, row, col, sensor, _RAYS)
        gain = expected_area(area * seen, config.sensor_range)
        if not leads_on:
            gain *= _NARROW_FACTOR
            if gain < config.min_frontier_gain:
                return None, box
        gain = max(gain, config.min_frontier_gain)
    return _Candidate(part, (row, col), (behind[0], behind[1]), gain, showing), box


def _records(grid: Grid, candidates: list[_Candidate]) -> list[Frontier]:
    """Return the frontiers with their places in metres."""
    if not candidates:
        return []
    points = grid.to_point(np.array([item.viewpoint for item in candidates])).tolist()
    scale, (x, y) = grid.resolution, grid.origin
    lengths = np.array([len(item.cells) for item in candidates])
    starts = np.concatenate([[0], np.cumsum(lengths)[:-1]])
    sums = np.add.reduceat(np.concatenate([item.cells for item in candidates]), starts)
    frontiers = []
    for item, (row, col), (px, py) in zip(
        candidates, (sums / lengths[:, None]).tolist(), points, strict=True
    ):
        centroid = (x + (col + 0.5) * scale, y + (row + 0.5) * scale)
        behind_row, behind_col = item.behind
        look_at = (x + (behind_col + 0.5) * scale, y + (behind_row + 0.5) * scale)
        viewpoint = (int(item.viewpoint[0]), int(item.viewpoint[1]))
        size = len(item.cells) * scale
        frontiers.append(
            Frontier(
                item.cells, centroid, (px, py), viewpoint, size, item.gain, look_at, item.showing
            )
        )
    return frontiers


def _split(cells: NDArray[np.int64], largest: int) -> list[NDArray[np.int64]]:
    """Cut a cluster (N, 2) across its main direction into pieces of about equal size."""
    pieces = math.ceil(len(cells) / largest)
    if pieces == 1:
        return [cells]
    return cut_across(cells, along_main_direction(cells), pieces)
