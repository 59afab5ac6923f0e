"""One planning cycle's view: the map, what it costs, and the vehicles that take part."""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from explore_slam.exploration.clearance import CostMap, make_cost_map
from explore_slam.exploration.config import ExplorationConfig
from explore_slam.exploration.paths import search_path, shortcut
from explore_slam.exploration.records import Cell, Grid, Point, VehicleSnapshot
from explore_slam.exploration.traffic import Traveler, along, stamp_disc
from explore_slam.exploration.value_iteration import padded_costs, spread
from explore_slam.geometry import Array, Pose2

BYPASS = 8.0  # a cell beside a standing vehicle costs so many times more


class Scene:
    """The map at one time with the costs of travel of every vehicle; see `look`."""

    def __init__(
        self,
        grid: Grid,
        now: float,
        config: ExplorationConfig,
        vehicles: Mapping[str, VehicleSnapshot],
    ) -> None:
        self.grid, self.now, self.config = grid, now, config
        self.vehicles = {n: v for n, v in vehicles.items() if v.active and v.pose.is_finite()}
        paper = config.assignment.strategy == 'paper'
        self.costs: CostMap = make_cost_map(grid, config.paths, paper_costs=paper)
        parked = [
            v.pose for n, v in vehicles.items() if n not in self.vehicles and v.pose.is_finite()
        ]
        for pose in parked:
            self.bar(self.costs.cost, pose, 2.0 * config.paths.vehicle_radius)
        self.padded = padded_costs(self.costs.cost, math.inf)
        self.starts: dict[str, Cell] = {}
        self.values: dict[str, NDArray[np.float32]] = {}
        for name in sorted(self.vehicles):
            cell = self.nearest_passable(self.vehicles[name].pose)
            if cell is not None:
                self.starts[name] = cell

    def compute_values(self) -> None:
        """Compute the cost of travel (m) from every vehicle to every cell."""
        for name, cell in self.starts.items():
            self.values[name] = self._spread(self.padded, cell)

    def _spread(self, padded: NDArray[np.float32], cell: Cell) -> NDArray[np.float32]:
        rows, cols = np.array([cell[0] + 1], np.int64), np.array([cell[1] + 1], np.int64)
        values = spread(padded, rows, cols)[1:-1, 1:-1]
        values *= np.float32(self.grid.resolution)
        return values

    def cell_of(self, place: Point | Pose2) -> Cell:
        """Return the cell of a point (m), which may lie outside of the grid."""
        row, col = self.grid.to_cell([(place[0], place[1])])[0].tolist()
        return int(row), int(col)

    def bar(self, cost: NDArray[np.float32], place: Point | Pose2, radius: float) -> None:
        """Make a disc (m) impassable in costs (H, W)."""
        mask = np.zeros(cost.shape, np.bool_)
        stamp_disc(mask, *self.cell_of(place), radius / self.grid.resolution)
        cost[mask] = np.inf

    def nearest_passable(self, place: Point | Pose2) -> Cell | None:
        """Return the passable cell nearest to a point within escape_distance, or None."""
        reach = self.config.paths.escape_distance / self.grid.resolution
        return nearest_passable(self.costs.cost, self.cell_of(place), reach)

    def path(
        self, name: str, goal: Cell, padded: NDArray[np.float32] | None = None
    ) -> Array | None:
        """Return the smoothed path (W, 2) m of a vehicle to a cell, or None."""
        over = self.padded if padded is None else padded
        stride = over.shape[1]
        row, col = self.starts[name]
        start, end = (row + 1) * stride + col + 1, (goal[0] + 1) * stride + goal[1] + 1
        flat, _ = search_path(over, start, end)
        if flat.size == 0:
            return None
        rows, cols = np.divmod(flat, stride)
        corners = shortcut(over[1:-1, 1:-1], np.stack([rows - 1, cols - 1], axis=1))
        pose = self.vehicles[name].pose
        points = np.vstack([[(pose.x, pose.y)], self.grid.to_point(corners)])
        if self.cell_of(pose) == (row, col) and len(points) > 2:
            points = np.delete(points, 1, axis=0)
        return points

    def around_standing(self, standing: list[Pose2]) -> NDArray[np.float32] | None:
        """Return costs (padded) that make a path rather lead around vehicles that stand."""
        if not standing:
            return None
        mask = np.zeros(self.costs.cost.shape, np.bool_)
        reach = self.config.traffic.vehicle_separation / self.grid.resolution
        for pose in standing:
            stamp_disc(mask, *self.cell_of(pose), reach)
        padded = self.padded.copy()
        padded[1:-1, 1:-1][mask] *= np.float32(BYPASS)
        return padded

    def is_passable(self, points: Array) -> bool:
        """Tell whether a path (W, 2) m is still free, start excepted."""
        lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
        if lengths[-1] == 0.0:
            return True
        step = self.grid.resolution
        # The start may lie in a blocked cell, from which the vehicle is just escaping.
        first = min(self.config.paths.escape_distance, float(lengths[-1]))
        at = np.append(np.arange(first, lengths[-1], step), lengths[-1])
        cells = self.grid.to_cell(along(points, lengths, at))
        if not ((cells >= 0).all() and (cells < self.grid.shape).all()):
            return False
        return bool(np.isfinite(self.costs.cost[cells[:, 0], cells[:, 1]]).all())

    def retreat(self, one: Traveler, winners: list[Traveler]) -> tuple[Array | None, float]:
        """Return the path to the nearest place off the paths of others, and its cost (m)."""
        start = self.starts.get(one.name)
        if start is None:
            return None, math.inf
        cost = self.costs.cost.copy()
        separation = self.config.traffic.vehicle_separation
        for winner in winners:
            gap = math.dist(winner.place, one.place)
            place = (float(winner.place[0]), float(winner.place[1]))
            self.bar(cost, place, min(separation, gap - 1.5 * self.grid.resolution))
        padded = padded_costs(cost, math.inf)
        if not math.isfinite(cost[start]):
            return None, math.inf
        values = self._spread(padded, start)
        barred = np.zeros(values.shape, np.bool_)
        reach = separation / self.grid.resolution + 1.0
        for winner in winners:
            at = np.append(np.arange(0.0, winner.lengths[-1], 0.2), winner.lengths[-1])
            cells = self.grid.to_cell(along(winner.points, winner.lengths, at))
            for row, col in cells.tolist():
                stamp_disc(barred, row, col, reach)
        values[barred] = np.inf
        best = divmod(int(np.argmin(values)), values.shape[1])
        if not math.isfinite(values[best]):
            return None, math.inf
        return self.path(one.name, best, padded), float(values[best])


def nearest_passable(cost: NDArray[np.float32], cell: Cell, reach: float) -> Cell | None:
    """Return the passable cell nearest to a cell (which may lie outside), within `reach` cells."""
    row, col = cell
    height, width = cost.shape
    if 0 <= row < height and 0 <= col < width and math.isfinite(cost[row, col]):
        return row, col
    half = math.floor(reach)
    low_r, low_c = max(0, row - half), max(0, col - half)
    window = cost[low_r : max(0, row + half + 1), low_c : max(0, col + half + 1)]
    free = np.argwhere(np.isfinite(window))
    if not len(free):
        return None
    cells = free + (low_r, low_c)
    squared = ((cells - (row, col)) ** 2).sum(axis=1)
    best = int(np.argmin(squared))
    if squared[best] > reach * reach:
        return None
    return int(cells[best, 0]), int(cells[best, 1])
