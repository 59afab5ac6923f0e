"""The map in one planning cycle, as the vehicles that take part can use it."""

import math
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from explore_slam.exploration.clearance import CostMap, make_cost_map, tight_factor
from explore_slam.exploration.config import ExplorationConfig
from explore_slam.exploration.paths import search_path, shortcut
from explore_slam.exploration.records import Cell, Frontier, Grid, Point, VehicleSnapshot
from explore_slam.exploration.regions import (
    connected_region,
    nearest_passable,
    open_around,
    set_disc,
)
from explore_slam.exploration.routes import Field, RouteGrid, block_size
from explore_slam.exploration.strategies import STRATEGIES
from explore_slam.exploration.traffic import Traveler
from explore_slam.exploration.value_iteration import Costs, padded_costs, spread
from explore_slam.geometry import Array, Pose2
from explore_slam.polyline import arc_lengths, points_at, sample

# Design values
_KEEP_OUT_RADIUS = 0.25  # m around a place where a vehicle was blocked
_TRAIL_MARGIN = 0.15  # m beside a trail that is opened too, so that a path can keep to the middle
_BYPASS_FACTOR = 8.0  # by which cells beside a standing vehicle cost more
_STOPPING_ERROR = 0.2  # m by which a follower may stop short of the place it retreats to
_RETREAT_SPACING = 0.2  # m between the positions of other paths that a retreat keeps clear of


class Scene:
    """The map at one time: costs of travel, and what each vehicle can reach.

    vehicles: those that take part; the others are obstacles.
    costs: of all cells.
    starts: cell from which each vehicle starts; a vehicle without one cannot move.
    reach: cells (H, W) that each vehicle can get to.
    tight: vehicles that may use tight passages because they are trapped otherwise.
    """

    def __init__(
        self,
        grid: Grid,
        now: float,
        config: ExplorationConfig,
        vehicles: Mapping[str, VehicleSnapshot],
        trails: Mapping[str, list[Point]] | None = None,
        keep_out: Iterable[Point] = (),
    ) -> None:
        """Prepare a grid for planning.

        trails: where vehicles have driven (m), which is passable whatever the map shows.
        keep_out: places (m) where vehicles were blocked.
        """
        self.grid, self.now, self.config = grid, now, config
        self.vehicles = {n: v for n, v in vehicles.items() if v.active and v.pose.is_finite()}
        self._probability_costs = STRATEGIES[config.strategy].probability_costs
        self.costs: CostMap = make_cost_map(
            grid, config.paths, probability_costs=self._probability_costs
        )
        both = (self.costs.cost, self.costs.tight_cost)
        for name, vehicle in vehicles.items():
            if name not in self.vehicles and vehicle.pose.is_finite():
                for cost in both:
                    self._block_disc(cost, vehicle.pose, 2.0 * config.paths.planning_radius)
        self._trails = trails or {}
        self._keep_out = list(keep_out)
        for trail in self._trails.values():
            self._open_trail(trail, self.costs.free, both)
        self._block_keep_out_zones(both)
        self.starts: dict[str, Cell] = {}
        self.reach: dict[str, NDArray[np.bool_]] = {}
        self.tight: set[str] = set()
        self._routes: RouteGrid | None = None
        self._fields: dict[str, Field] = {}
        self._padded: dict[bool, Costs] = {}
        for name in sorted(self.vehicles):
            self._place(name)

    # -- what is passable ------------------------------------------------------------------------

    def _place(self, name: str) -> None:
        """Find the start cell of a vehicle, and all that it can reach from there."""
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
        self.reach[name] = connected_region(self.cost_of(name), cell[0], cell[1])

    def _open_trail(
        self, trail: list[Point], allowed: NDArray[np.bool_], costs: tuple[Costs, ...]
    ) -> None:
        """Make allowed cells (H, W) along a trail passable at a price: a way back."""
        if not trail:
            return
        scale = self.grid.resolution
        cells = self.grid.to_cell(sample(np.array(trail), 0.5 * scale))
        radius = self.config.paths.planning_radius / scale
        distances = np.sqrt(np.arange(math.ceil(radius * radius) + 1))
        prices = tight_factor(np.minimum(distances, radius), radius)
        half = math.floor(_TRAIL_MARGIN / scale)
        for cost in costs:
            open_around(cost, allowed, self.costs.squared, cells, half, prices)

    def _block_keep_out_zones(self, costs: tuple[Costs, ...]) -> None:
        for place in self._keep_out:
            for cost in costs:
                self._block_disc(cost, place, _KEEP_OUT_RADIUS)

    def _block_disc(self, cost: Costs, place: Point | Pose2, radius: float) -> None:
        """Make a disc (m) impassable in costs (H, W)."""
        mask = np.zeros(cost.shape, np.bool_)
        set_disc(mask, *self.cell_of(place), radius / self.grid.resolution)
        cost[mask] = np.inf

    def allow_tight(self, name: str) -> bool:
        """Let a trapped vehicle use tight passages; return whether it gets any further by that."""
        if name in self.tight:
            return False
        mask = connected_region(self.costs.tight_cost, *self.starts[name])
        if not self._leads_further(mask, name):
            # An obstacle on the trail by which the vehicle came may have gone: it drives there
            # and looks.
            tight = (self.costs.tight_cost,)
            self._open_trail(self._trails.get(name, []), ~self.costs.unknown, tight)
            self._block_keep_out_zones(tight)
            mask = connected_region(self.costs.tight_cost, *self.starts[name])
            if not self._leads_further(mask, name):
                return False
        self.tight.add(name)
        self.reach[name] = mask
        self._routes = None
        self._fields.clear()
        return True

    def _leads_further(self, mask: NDArray[np.bool_], name: str) -> bool:
        """Return whether cells (H, W) hold more passable ones than a vehicle reaches now."""
        more = np.count_nonzero(mask & np.isfinite(self.costs.cost))
        return bool(more > np.count_nonzero(self.reach[name]))

    def cost_of(self, name: str) -> Costs:
        """Return the costs (H, W) on which a vehicle plans."""
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

    def cell_of(self, place: Point | Pose2) -> Cell:
        """Return the cell of a point (m), which may lie outside of the grid."""
        row, col = self.grid.to_cell([(place[0], place[1])])[0].tolist()
        return int(row), int(col)

    def nearest_passable(self, place: Point | Pose2) -> Cell | None:
        """Return the passable cell nearest to a point (m) within escape_distance, or None."""
        return self._nearest(self.costs.cost, place)

    def _nearest(self, cost: Costs, place: Point | Pose2) -> Cell | None:
        radius = self.config.paths.escape_distance / self.grid.resolution
        return nearest_passable(cost, self.cell_of(place), radius)

    # -- travel costs ----------------------------------------------------------------------------

    def routes(self) -> RouteGrid:
        """Return the coarse grid over all reachable cells."""
        if self._routes is None:
            paths, scale, (x, y) = self.config.paths, self.grid.resolution, self.grid.origin
            first = round(y / scale), round(x / scale)
            block = block_size(paths.route_resolution, paths.planning_radius, scale)
            cost = self.costs.tight_cost if self.tight else self.costs.cost
            self._routes = RouteGrid(cost, self.reachable(), first, block, scale)
        return self._routes

    def cost_to(self, name: str, cells: NDArray[np.int64]) -> Array:
        """Return the travel cost (N,) m of a vehicle to cells (N, 2); inf if unreachable."""
        if self._probability_costs:
            values = self._spread(self.padded_of(name), self.starts[name])
            costs = values[cells[:, 0], cells[:, 1]].astype(np.float64)
        else:
            routes = self.routes()
            if name not in self._fields:
                start = np.array([self.starts[name]])
                self._fields[name] = routes.values_from(routes.blocks(start)[0])
            costs = self._fields[name].at(routes.blocks(cells))
        costs[~self.reach[name][cells[:, 0], cells[:, 1]]] = np.inf
        return costs

    def costs_to(self, names: tuple[str, ...], frontiers: list[Frontier]) -> Array:
        """Return the travel costs (V, F) m of vehicles to frontiers."""
        cells = np.array([f.target_cell for f in frontiers])
        return np.array([self.cost_to(name, cells) for name in names])

    def _spread(self, padded: Costs, cell: Cell) -> Costs:
        """Return the travel cost (H, W) m from a cell."""
        rows, cols = np.array([cell[0] + 1], np.int64), np.array([cell[1] + 1], np.int64)
        values = spread(padded, rows, cols)[1:-1, 1:-1]
        values *= np.float32(self.grid.resolution)
        return values

    # -- paths -----------------------------------------------------------------------------------

    def path(self, name: str, goal: Cell, padded: Costs | None = None) -> Array | None:
        """Return the smoothed path (W, 2) m of a vehicle to a cell, or None.

        padded: costs instead of those of padded_of.
        """
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

    def costs_around(self, name: str, standing: list[Pose2]) -> Costs | None:
        """Return padded costs by which paths avoid vehicles that stand still, None without any."""
        if not standing:
            return None
        mask = np.zeros(self.costs.cost.shape, np.bool_)
        radius = self.config.traffic.vehicle_separation / self.grid.resolution
        for pose in standing:
            set_disc(mask, *self.cell_of(pose), radius)
        padded = self.padded_of(name).copy()
        padded[1:-1, 1:-1][mask] *= np.float32(_BYPASS_FACTOR)
        return padded

    def is_passable(self, name: str, points: Array) -> bool:
        """Return whether a path (W, 2) m is still free; it may start in a blocked cell."""
        lengths = arc_lengths(points)
        at = np.append(np.arange(0.0, lengths[-1], self.grid.resolution), lengths[-1])
        cells = self.grid.to_cell(points_at(points, lengths, at))
        if not ((cells >= 0).all() and (cells < self.grid.shape).all()):
            return False
        free = np.isfinite(self.cost_of(name)[cells[:, 0], cells[:, 1]])
        first = int(np.argmax(free))
        escaped = at[first] <= self.config.paths.escape_distance
        return bool(free[first:].all()) and bool(escaped)

    def retreat(self, one: Traveler, others: list[Traveler]) -> tuple[Array | None, float]:
        """Return the path to the nearest place off the paths of others, and its cost (m)."""
        start = self.starts.get(one.name)
        if start is None:
            return None, math.inf
        cost = self.cost_of(one.name).copy()
        separation = self.config.traffic.vehicle_separation
        for other in others:
            gap = math.dist(other.position, one.position)
            place = (float(other.position[0]), float(other.position[1]))
            self._block_disc(cost, place, min(separation, gap - 1.5 * self.grid.resolution))
        padded = padded_costs(cost, math.inf)
        if not math.isfinite(cost[start]):
            return None, math.inf
        values = self._spread(padded, start)
        swept = np.zeros(values.shape, np.bool_)
        radius = (separation + _STOPPING_ERROR) / self.grid.resolution + 1.0
        for other in others:
            cells = self.grid.to_cell(sample(other.points, _RETREAT_SPACING))
            for row, col in cells.tolist():
                set_disc(swept, row, col, radius)
        values[swept] = np.inf
        best = divmod(int(np.argmin(values)), values.shape[1])
        if not math.isfinite(values[best]):
            return None, math.inf
        return self.path(one.name, best, padded), float(values[best])
