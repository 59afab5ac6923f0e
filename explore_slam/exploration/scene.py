"""One planning cycle's view: the map, what it costs, and the vehicles that take part."""

import math
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.exploration.clearance import CostMap, make_cost_map, tight_factor
from explore_slam.exploration.config import ExplorationConfig
from explore_slam.exploration.paths import search_path, shortcut
from explore_slam.exploration.records import Cell, Frontier, Grid, Point, VehicleSnapshot
from explore_slam.exploration.routes import Field, RouteGrid, block_size
from explore_slam.exploration.traffic import Traveler, stamp_disc
from explore_slam.exploration.value_iteration import Costs, padded_costs, spread
from explore_slam.geometry import Array, Pose2
from explore_slam.polyline import arc_lengths, points_at

BAR_RADIUS = 0.25  # m of what is barred around a place that could not be passed
TRAIL_WIDTH = 0.15  # m beside a trail that are open too, so that a path can keep to the middle
BYPASS = 8.0  # a cell beside a standing vehicle costs so many times more


STOPPED_SHORT = 0.2  # m by which a follower may stand before the place it retreats to


class Scene:
    """The map at one time, where each vehicle can get, and what that costs."""

    def __init__(
        self,
        grid: Grid,
        now: float,
        config: ExplorationConfig,
        vehicles: Mapping[str, VehicleSnapshot],
        trails: Mapping[str, list[Point]] | None = None,
        bars: Iterable[Point] = (),
    ) -> None:
        """Look at a grid; trails lead where vehicles drove, bars are where they could not."""
        self.grid, self.now, self.config = grid, now, config
        self.vehicles = {n: v for n, v in vehicles.items() if v.active and v.pose.is_finite()}
        paper = config.assignment.strategy == 'paper'
        self.costs: CostMap = make_cost_map(grid, config.paths, paper_costs=paper)
        for name, vehicle in vehicles.items():
            if name not in self.vehicles and vehicle.pose.is_finite():
                for cost in (self.costs.cost, self.costs.tight_cost):
                    self.bar(cost, vehicle.pose, 2.0 * config.paths.vehicle_radius)
        self._trails = trails or {}
        self._bars = list(bars)
        for trail in self._trails.values():
            self._open_trail(trail, self.costs.free, (self.costs.cost, self.costs.tight_cost))
        for place in self._bars:
            for cost in (self.costs.cost, self.costs.tight_cost):
                self.bar(cost, place, BAR_RADIUS)
        self.starts: dict[str, Cell] = {}
        self.reach: dict[str, NDArray[np.bool_]] = {}
        self.tight: set[str] = set()
        self._routes: RouteGrid | None = None
        self._fields: dict[str, Field] = {}
        self._padded: dict[bool, Costs] = {}
        for name in sorted(self.vehicles):
            self._place(name)

    def _place(self, name: str) -> None:
        """Find the cell where a vehicle starts, and all that it can reach from there."""
        pose = self.vehicles[name].pose
        cell = self.nearest_passable(pose)
        if cell is None:
            cell = self._nearest(self.costs.tight_cost, pose)
            if cell is None:
                return
            self.tight.add(name)
        self.starts[name] = cell
        for other, mask in self.reach.items():
            if mask[cell] and (other in self.tight) == (name in self.tight):
                self.reach[name] = mask
                return
        self.reach[name] = flood(self.cost_of(name), cell[0], cell[1])

    def _open_trail(
        self, trail: list[Point], free: NDArray[np.bool_], costs: tuple[Costs, ...]
    ) -> None:
        """Make free cells where a vehicle drove, and beside, passable at a price: a way out."""
        if not trail:
            return
        points, scale = np.array(trail), self.grid.resolution
        lengths = arc_lengths(points)
        at = np.append(np.arange(0.0, lengths[-1], 0.5 * scale), lengths[-1])
        cells = self.grid.to_cell(points_at(points, lengths, at))
        radius = self.config.paths.vehicle_radius / scale
        distances = np.sqrt(np.arange(math.ceil(radius * radius) + 1))
        prices = tight_factor(np.minimum(distances, radius), radius)
        half = math.floor(TRAIL_WIDTH / scale)
        for cost in costs:
            open_around(cost, free, self.costs.squared, cells, half, prices)

    def widen(self, name: str) -> bool:
        """Let a vehicle through tight places too; tell whether that takes it any further."""
        if name in self.tight:
            return False
        mask = flood(self.costs.tight_cost, *self.starts[name])
        if not self._leads_on(mask, name):
            # What closes the way by which it came is perhaps not there: it goes and looks.
            anywhere = ~self.costs.unknown
            self._open_trail(self._trails.get(name, []), anywhere, (self.costs.tight_cost,))
            for place in self._bars:
                self.bar(self.costs.tight_cost, place, BAR_RADIUS)
            mask = flood(self.costs.tight_cost, *self.starts[name])
            if not self._leads_on(mask, name):
                return False
        self.tight.add(name)
        self.reach[name] = mask
        self._routes = None
        self._fields.clear()
        return True

    def _leads_on(self, mask: NDArray[np.bool_], name: str) -> bool:
        """Tell whether cells (H, W) hold more places with room than a vehicle reaches now."""
        more = np.count_nonzero(mask & np.isfinite(self.costs.cost))
        return bool(more > np.count_nonzero(self.reach[name]))

    def cost_of(self, name: str) -> Costs:
        """Return the costs (H, W) that a vehicle plans on."""
        return self.costs.tight_cost if name in self.tight else self.costs.cost

    def padded_of(self, name: str) -> Costs:
        """Return the costs of cost_of, padded for searches."""
        tight = name in self.tight
        if tight not in self._padded:
            self._padded[tight] = padded_costs(self.cost_of(name), math.inf)
        return self._padded[tight]

    def reachable(self) -> NDArray[np.bool_]:
        """Return the cells (H, W) that some vehicle can get to."""
        masks = list({id(mask): mask for mask in self.reach.values()}.values())
        return masks[0] if len(masks) == 1 else np.logical_or.reduce(masks)

    def routes(self) -> RouteGrid:
        """Return the coarse grid over all reachable cells."""
        if self._routes is None:
            config, x, y = self.config, *self.grid.origin
            first = round(y / self.grid.resolution), round(x / self.grid.resolution)
            paths = config.paths
            block = block_size(paths.route_resolution, paths.vehicle_radius, self.grid.resolution)
            cost = self.costs.tight_cost if self.tight else self.costs.cost
            self._routes = RouteGrid(cost, self.reachable(), first, block, self.grid.resolution)
        return self._routes

    def cost_to(self, name: str, cells: NDArray[np.int64]) -> Array:
        """Return the cost of travel (N,) m of a vehicle to cells (N, 2); inf if unreachable."""
        start = np.array([self.starts[name]])
        if self.config.assignment.strategy == 'paper':
            values = self._spread(self.padded_of(name), self.starts[name])
            costs = values[cells[:, 0], cells[:, 1]].astype(np.float64)
        else:
            routes = self.routes()
            if name not in self._fields:
                self._fields[name] = routes.values_from(routes.blocks(start)[0])
            costs = self._fields[name].at(routes.blocks(cells))
        costs[~self.reach[name][cells[:, 0], cells[:, 1]]] = np.inf
        return costs

    def costs_to(self, names: tuple[str, ...], frontiers: list[Frontier]) -> Array:
        """Return the costs of travel (V, F) m of vehicles to frontiers."""
        cells = np.array([f.target_cell for f in frontiers])
        return np.array([self.cost_to(name, cells) for name in names])

    def _spread(self, padded: Costs, cell: Cell) -> Costs:
        rows, cols = np.array([cell[0] + 1], np.int64), np.array([cell[1] + 1], np.int64)
        values = spread(padded, rows, cols)[1:-1, 1:-1]
        values *= np.float32(self.grid.resolution)
        return values

    def cell_of(self, place: Point | Pose2) -> Cell:
        """Return the cell of a point (m), which may lie outside of the grid."""
        row, col = self.grid.to_cell([(place[0], place[1])])[0].tolist()
        return int(row), int(col)

    def bar(self, cost: Costs, place: Point | Pose2, radius: float) -> None:
        """Make a disc (m) impassable in costs (H, W)."""
        mask = np.zeros(cost.shape, np.bool_)
        stamp_disc(mask, *self.cell_of(place), radius / self.grid.resolution)
        cost[mask] = np.inf

    def nearest_passable(self, place: Point | Pose2) -> Cell | None:
        """Return the passable cell nearest to a point within escape_distance, or None."""
        return self._nearest(self.costs.cost, place)

    def _nearest(self, cost: Costs, place: Point | Pose2) -> Cell | None:
        reach = self.config.paths.escape_distance / self.grid.resolution
        return nearest_passable(cost, self.cell_of(place), reach)

    def path(self, name: str, goal: Cell, padded: Costs | None = None) -> Array | None:
        """Return the smoothed path (W, 2) m of a vehicle to a cell, or None."""
        over = self.padded_of(name) if padded is None else padded
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

    def around_standing(self, name: str, standing: list[Pose2]) -> Costs | None:
        """Return costs (padded) that make a path rather lead around vehicles that stand."""
        if not standing:
            return None
        mask = np.zeros(self.costs.cost.shape, np.bool_)
        reach = self.config.traffic.vehicle_separation / self.grid.resolution
        for pose in standing:
            stamp_disc(mask, *self.cell_of(pose), reach)
        padded = self.padded_of(name).copy()
        padded[1:-1, 1:-1][mask] *= np.float32(BYPASS)
        return padded

    def is_passable(self, name: str, points: Array) -> bool:
        """Tell whether a path (W, 2) m is still free; its start may lie in a blocked cell."""
        lengths = arc_lengths(points)
        at = np.append(np.arange(0.0, lengths[-1], self.grid.resolution), lengths[-1])
        cells = self.grid.to_cell(points_at(points, lengths, at))
        if not ((cells >= 0).all() and (cells < self.grid.shape).all()):
            return False
        free = np.isfinite(self.cost_of(name)[cells[:, 0], cells[:, 1]])
        first = int(np.argmax(free))
        escaped = at[first] <= self.config.paths.escape_distance
        return bool(free[first:].all()) and bool(escaped)

    def retreat(self, one: Traveler, winners: list[Traveler]) -> tuple[Array | None, float]:
        """Return the path to the nearest place off the paths of others, and its cost (m)."""
        start = self.starts.get(one.name)
        if start is None:
            return None, math.inf
        cost = self.cost_of(one.name).copy()
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
        reach = (separation + STOPPED_SHORT) / self.grid.resolution + 1.0
        for winner in winners:
            at = np.append(np.arange(0.0, winner.lengths[-1], 0.2), winner.lengths[-1])
            cells = self.grid.to_cell(points_at(winner.points, winner.lengths, at))
            for row, col in cells.tolist():
                stamp_disc(barred, row, col, reach)
        values[barred] = np.inf
        best = divmod(int(np.argmin(values)), values.shape[1])
        if not math.isfinite(values[best]):
            return None, math.inf
        return self.path(one.name, best, padded), float(values[best])


@kernel
def open_around(
    cost: Costs,
    free: NDArray[np.bool_],
    squared: NDArray[np.int32],
    cells: NDArray[np.int64],
    half: int,
    prices: NDArray[np.float32],
) -> None:
    """Give free cells up to `half` cells beside some cells (N, 2) a price where they have none.

    prices: by squared distance to the next obstacle, the last one beyond.
    """
    last_row, last_col = -1, -1
    for i in range(cells.shape[0]):
        row, col = cells[i, 0], cells[i, 1]
        if row == last_row and col == last_col:
            continue
        last_row, last_col = row, col
        for r in range(max(0, row - half), min(cost.shape[0], row + half + 1)):
            for c in range(max(0, col - half), min(cost.shape[1], col + half + 1)):
                if free[r, c] and cost[r, c] == np.inf:
                    cost[r, c] = prices[min(squared[r, c], prices.size - 1)]


@kernel
def flood(cost: Costs, row: int, col: int) -> NDArray[np.bool_]:
    """Return the cells (H, W) of finite cost that hang together with a cell (8-neighborhood)."""
    height, width = cost.shape
    mask = np.zeros((height, width), np.bool_)
    stack = np.empty(height * width, np.int32)
    stack[0] = row * width + col
    mask[row, col] = True
    size = 1
    while size > 0:
        size -= 1
        r, c = stack[size] // width, stack[size] % width
        for nr in range(max(0, r - 1), min(height, r + 2)):
            for nc in range(max(0, c - 1), min(width, c + 2)):
                if not mask[nr, nc] and cost[nr, nc] < np.inf:
                    mask[nr, nc] = True
                    stack[size] = nr * width + nc
                    size += 1
    return mask


def nearest_passable(cost: Costs, cell: Cell, reach: float) -> Cell | None:
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
