"""The map in one planning cycle, as the vehicles that take part can use it."""

import math
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import BatteryLevel, VehicleBody
from explore_slam.exploration.clearance import (
    CostMap,
    make_cost_map,
    paths_of,
    squared_distance,
    tight_factor,
)
from explore_slam.exploration.config import ExplorationConfig
from explore_slam.exploration.paths import SearchMemory, lowest_cost, search_path, shortcut
from explore_slam.exploration.records import Cell, Frontier, Grid, Point, VehicleSnapshot
from explore_slam.exploration.regions import (
    connected_region,
    nearest_passable,
    open_around,
    set_disc,
)
from explore_slam.exploration.routes import Field, RouteGrid, block_size
from explore_slam.exploration.sections import PathConfig
from explore_slam.exploration.strategies import STRATEGIES
from explore_slam.exploration.traffic import Traveler, separation
from explore_slam.exploration.value_iteration import Costs, padded_costs, spread
from explore_slam.geometry import Array, Pose2
from explore_slam.polyline import arc_lengths, points_at, sample

# Chosen by hand; `explore_slam benchmark exploration` measures what another value does
_KEEP_OUT_RADIUS = 0.25  # m, that of a vehicle; around a place where one was blocked
_TRAIL_MARGIN = 0.15  # m beside a trail that is opened too, so that a path can keep to the middle
_BYPASS_FACTOR = 8.0  # by which cells beside a standing vehicle cost more
_STOPPING_ERROR = 0.2  # m by which a follower may stop short of the place it retreats to
_RETREAT_SPACING = 0.2  # m between the positions of other paths that a retreat keeps clear of


class Scene:
    """The map at one time: costs of travel, and what each vehicle can reach.

    vehicles: those that take part; the others are obstacles.
    costs: of all cells, for the narrowest vehicle. What a cell costs others: cost_of.
    starts: cell from which each vehicle starts; a vehicle without one cannot move.
    reach: cells (H, W) that each vehicle can get to.
    tight: vehicles that may use tight passages because they are trapped otherwise.
    forbidden: cells (H, W) that no vehicle may enter, or None.
    """

    def __init__(
        self,
        grid: Grid,
        now: float,
        config: ExplorationConfig,
        vehicles: Mapping[str, VehicleSnapshot],
        trails: Mapping[str, list[Point]] | None = None,
        keep_out: Iterable[Point] = (),
        forbidden: NDArray[np.bool_] | None = None,
        memory: SearchMemory | None = None,
    ) -> None:
        """Prepare a grid for planning.

        trails: where vehicles have driven (m), which is passable whatever the map shows.
        keep_out: places (m) where vehicles were blocked.
        forbidden: cells (H, W), occupied in the grid, that no vehicle may enter: unlike an
        obstacle on a trail, they are not looked at again.
        memory: of the searches for paths, kept from cycle to cycle.
        """
        self._memory = memory or SearchMemory()
        self._lowest: float | None = None
        self.grid, self.now, self.config = grid, now, config
        self.vehicles = {n: v for n, v in vehicles.items() if v.active and v.pose.is_finite()}
        self._probability_costs = STRATEGIES[config.strategy].probability_costs
        self._trails = trails or {}
        self._keep_out = list(keep_out)
        self.forbidden = forbidden
        self._bodies = {name: vehicle.body for name, vehicle in vehicles.items()}
        self._others = {
            name: vehicle
            for name, vehicle in vehicles.items()
            if name not in self.vehicles and vehicle.pose.is_finite()
        }
        self._maps: dict[float, CostMap] = {}  # by the envelope (m) of a body
        narrowest = min(self._bodies.values(), key=_envelope, default=VehicleBody())
        self.costs: CostMap = self._map_for(narrowest)
        # the same in all cycles, so that costs between blocks can be kept
        self._route_radius = self._paths(narrowest).planning_radius
        self.starts: dict[str, Cell] = {}
        self.reach: dict[str, NDArray[np.bool_]] = {}
        self.tight: set[str] = set()
        self._reach_before: dict[str, NDArray[np.bool_]] = {}  # without tight passages
        self._routes: dict[float, RouteGrid] = {}
        self._fields: dict[str, Field] = {}
        self._padded: dict[tuple[float, bool], Costs] = {}
        for name in sorted(self.vehicles):
            self._place(name)

    # -- what is passable ------------------------------------------------------------------------

    def _paths(self, body: VehicleBody) -> PathConfig:
        return paths_of(self.config.paths, body)

    def _map_for(self, body: VehicleBody) -> CostMap:
        """Return the costs for a body, with all that a vehicle of this size must respect."""
        found = self._maps.get(body.envelope)
        if found is not None:
            return found
        paths = self._paths(body)
        made = make_cost_map(self.grid, paths, probability_costs=self._probability_costs)
        both = (made.cost, made.tight_cost)
        for other in self._others.values():
            theirs = self._paths(other.body).planning_radius
            for cost in both:
                self._block_disc(cost, other.pose, theirs + paths.planning_radius)
        for name, trail in self._trails.items():
            if self._bodies.get(name, body).envelope >= body.envelope:  # else it may not fit there
                self._open_trail(trail, made, made.free, both, paths.planning_radius)
        self._block_keep_out_zones(both)
        self._maps[body.envelope] = made
        return made

    def _map_of(self, name: str) -> CostMap:
        return self._map_for(self._bodies[name])

    def _place(self, name: str) -> None:
        """Find the start cell of a vehicle, and all that it can reach from there."""
        pose = self.vehicles[name].pose
        cell = self.nearest_passable(name, pose)
        if cell is None:
            cell = self._nearest(self._map_of(name).tight_cost, pose)
            if cell is None:
                return
            self.tight.add(name)
        self.starts[name] = cell
        for other, mask in self.reach.items():
            if mask[cell] and self._key(other) == self._key(name):
                self.reach[name] = mask
                return
        self.reach[name] = connected_region(self.cost_of(name), cell[0], cell[1])

    def _key(self, name: str) -> tuple[float, bool]:
        """Return what the costs of a vehicle depend on: its size, and whether it is trapped."""
        return self._bodies[name].envelope, name in self.tight

    def _open_trail(
        self,
        trail: list[Point],
        made: CostMap,
        allowed: NDArray[np.bool_],
        costs: tuple[Costs, ...],
        planning_radius: float,
    ) -> None:
        """Make allowed cells (H, W) along a trail passable at a price, for the way back."""
        if not trail:
            return
        scale = self.grid.resolution
        cells = self.grid.to_cell(sample(np.array(trail), 0.5 * scale))
        radius = planning_radius / scale
        distances = np.sqrt(np.arange(math.ceil(radius * radius) + 1))
        prices = tight_factor(np.minimum(distances, radius), radius)
        half = math.floor(_TRAIL_MARGIN / scale)
        for cost in costs:
            open_around(cost, allowed, made.squared, cells, half, prices)

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
        made = self._map_of(name)
        mask = connected_region(made.tight_cost, *self.starts[name])
        if not self._leads_further(mask, name):
            # An obstacle on the trail by which the vehicle came may have gone: it drives there
            # and looks.
            tight = (made.tight_cost,)
            radius = self._paths(self._bodies[name]).planning_radius
            allowed = ~made.unknown
            if self.forbidden is not None:
                allowed &= ~self.forbidden
            self._open_trail(self._trails.get(name, []), made, allowed, tight, radius)
            self._block_keep_out_zones(tight)
            mask = connected_region(made.tight_cost, *self.starts[name])
            if not self._leads_further(mask, name):
                return False
        self.tight.add(name)
        self._reach_before[name] = self.reach[name]
        self.reach[name] = mask
        self._routes.clear()
        self._fields.clear()
        return True

    def forbid_tight(self, name: str) -> None:
        """Undo allow_tight."""
        self.tight.remove(name)
        self.reach[name] = self._reach_before.pop(name)
        self._routes.clear()
        self._fields.clear()

    def _leads_further(self, mask: NDArray[np.bool_], name: str) -> bool:
        """Return whether cells (H, W) hold more passable ones than a vehicle reaches now."""
        more = np.count_nonzero(mask & np.isfinite(self._map_of(name).cost))
        return bool(more > np.count_nonzero(self.reach[name]))

    def cost_of(self, name: str) -> Costs:
        """Return the costs (H, W) on which a vehicle plans."""
        made = self._map_of(name)
        return made.tight_cost if name in self.tight else made.cost

    def padded_of(self, name: str) -> Costs:
        """Return the costs of cost_of, padded for searches."""
        key = self._key(name)
        if key not in self._padded:
            self._padded[key] = padded_costs(self.cost_of(name), math.inf)
        return self._padded[key]

    @property
    def explorers(self) -> tuple[str, ...]:
        """Names of the vehicles that can move and explore; the others only drive home."""
        return tuple(n for n in self.starts if self.vehicles[n].battery is BatteryLevel.OK)

    def reachable(self) -> NDArray[np.bool_]:
        """Return the cells (H, W) that some vehicle can get to that explores, if any does."""
        return _union(self.reach[name] for name in self.explorers or self.reach)

    def reachable_costs(self) -> Costs:
        """Return the costs (H, W) of all cells, at which those of `reachable` can be entered."""
        return self.costs.tight_cost if self.tight else self.costs.cost

    def viewpoints(self) -> NDArray[np.bool_]:
        """Return the cells (H, W) from which a vehicle may look: it gets there, and has room."""
        reach = self.reachable()
        return reach & np.isfinite(self.costs.cost) if self.tight else reach

    def free_area(self) -> tuple[float, float]:
        """Return the known free area, and the part of it that vehicles can cover (m²).

        Vehicles cover what lies within the planning radius of cells that they can get to. Only
        the part counts in which a vehicle would fit. While most of the passable cells can be
        reached, those are counted instead, which is less work.
        """
        passable, reach = np.isfinite(self.costs.cost), self.reachable()
        centres = np.count_nonzero(passable), np.count_nonzero(reach & passable)
        if 2 * centres[1] >= centres[0]:
            cell = self.grid.resolution**2
            return float(centres[0]) * cell, float(centres[1]) * cell
        radius = math.floor(self._route_radius / self.grid.resolution)
        covered = [squared_distance(mask, radius) <= radius * radius for mask in (passable, reach)]
        cell = self.grid.resolution**2
        whole, part = (float(np.count_nonzero(mask & self.costs.free)) for mask in covered)
        return whole * cell, part * cell

    def reached_area(self, name: str) -> float:
        """Return the area (m²) of the cells that a vehicle can get to."""
        return float(np.count_nonzero(self.reach[name])) * self.grid.resolution**2

    def is_shut_in(self, name: str) -> bool:
        """Return whether a vehicle gets to less than half of the cells that are passable."""
        own = self._map_of(name).cost
        passable = np.count_nonzero(np.isfinite(own))
        return bool(2 * np.count_nonzero(self.reach[name] & np.isfinite(own)) < passable)

    def cell_of(self, place: Point | Pose2) -> Cell:
        """Return the cell of a point (m), which may lie outside of the grid."""
        row, col = self.grid.to_cell([(place[0], place[1])])[0].tolist()
        return int(row), int(col)

    def nearest_passable(self, name: str, place: Point | Pose2) -> Cell | None:
        """Return the cell nearest to a point (m) that a vehicle may enter, or None.

        It lies within escape_distance.
        """
        return self._nearest(self._map_of(name).cost, place)

    def _nearest(self, cost: Costs, place: Point | Pose2) -> Cell | None:
        radius = self.config.paths.escape_distance / self.grid.resolution
        return nearest_passable(cost, self.cell_of(place), radius)

    # -- travel costs ----------------------------------------------------------------------------

    def routes(self, vehicle: str) -> RouteGrid:
        """Return the coarse grid over all cells that vehicles as large as one can get to."""
        return self._routes_from(self._bodies[vehicle].envelope)

    def _routes_from(self, radius: float) -> RouteGrid:
        """Return the coarse grid of the vehicles whose envelope (m) is this one or larger."""
        if radius not in self._routes:
            paths, scale, (x, y) = self.config.paths, self.grid.resolution, self.grid.origin
            first = round(y / scale), round(x / scale)
            block = block_size(paths.route_resolution, self._route_radius, scale)
            names = [name for name in self.reach if self._bodies[name].envelope >= radius]
            made = self._maps[radius]
            cost = made.tight_cost if self.tight.intersection(names) else made.cost
            reach = _union(self.reach[name] for name in names)
            self._routes[radius] = RouteGrid(cost, reach, first, block, scale)
        return self._routes[radius]

    def cost_to(self, name: str, cells: NDArray[np.int64]) -> Array:
        """Return the travel cost (N,) m of a vehicle to cells (N, 2); inf if unreachable."""
        if self._probability_costs:
            values = self._spread(self.padded_of(name), self.starts[name])
            costs = values[cells[:, 0], cells[:, 1]].astype(np.float64)
        else:
            routes = self._routes_from(self._bodies[name].envelope)
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
        if self._lowest is None:
            # that of the narrowest vehicle in tight passages: others pay as much or more
            lowest = lowest_cost(self.costs.tight_cost)
            self._lowest = lowest if math.isfinite(lowest) else 0.0
        flat, _ = search_path(over, start, end, self._memory, self._lowest)
        if flat.size == 0:
            return None
        rows, cols = np.divmod(flat, stride)
        corners = shortcut(over[1:-1, 1:-1], np.stack([rows - 1, cols - 1], axis=1))
        pose = self.vehicles[name].pose
        points = np.vstack([[(pose.x, pose.y)], self.grid.to_point(corners)])
        if self.cell_of(pose) == (row, col) and len(points) > 2:
            points = np.delete(points, 1, axis=0)
        return points

    def costs_around(self, name: str, standing: list[str]) -> Costs | None:
        """Return padded costs by which paths avoid vehicles that stand still, None without any."""
        if not standing:
            return None
        mask = np.zeros(self.costs.cost.shape, np.bool_)
        for other in standing:
            radius = separation(self.config.traffic, self._bodies[name], self._bodies[other])
            cell = self.cell_of(self.vehicles[other].pose)
            set_disc(mask, *cell, radius / self.grid.resolution)
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
        apart = [separation(self.config.traffic, one.body, other.body) for other in others]
        for other, distance in zip(others, apart, strict=True):
            gap = math.dist(other.position, one.position)
            place = (float(other.position[0]), float(other.position[1]))
            self._block_disc(cost, place, min(distance, gap - 1.5 * self.grid.resolution))
        padded = padded_costs(cost, math.inf)
        if not math.isfinite(cost[start]):
            return None, math.inf
        values = self._spread(padded, start)
        swept = np.zeros(values.shape, np.bool_)
        for other, distance in zip(others, apart, strict=True):
            radius = (distance + _STOPPING_ERROR) / self.grid.resolution + 1.0
            cells = self.grid.to_cell(sample(other.points, _RETREAT_SPACING))
            for row, col in cells.tolist():
                set_disc(swept, row, col, radius)
        values[swept] = np.inf
        best = divmod(int(np.argmin(values)), values.shape[1])
        if not math.isfinite(values[best]):
            return None, math.inf
        return self.path(one.name, best, padded), float(values[best])


def _union(masks: Iterable[NDArray[np.bool_]]) -> NDArray[np.bool_]:
    """Return where any of the masks (H, W) holds."""
    different = list({id(mask): mask for mask in masks}.values())
    return different[0] if len(different) == 1 else np.logical_or.reduce(different)


def _envelope(body: VehicleBody) -> float:
    return body.envelope
