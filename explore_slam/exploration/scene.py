"""The map in one planning cycle, as the vehicles that take part can use it."""

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import BatteryLevel, VehicleBody
from explore_slam.exploration.clearance import (
    CostMap,
    paths_of,
    squared_distance,
    tight_factor,
)
from explore_slam.exploration.config import ExplorationConfig
from explore_slam.exploration.frontiers import FrontierCache
from explore_slam.exploration.paths import SearchMemory, search_path, shortcut
from explore_slam.exploration.planning_map import CostLayer, Disc, Overlay, PlanningMap
from explore_slam.exploration.records import Cell, Frontier, Grid, Point, VehicleSnapshot
from explore_slam.exploration.regions import (
    connected_region,
    nearest_passable,
    open_around,
    set_disc,
)
from explore_slam.exploration.routes import CostsFrom, RouteGrid, block_size
from explore_slam.exploration.sections import PathConfig
from explore_slam.exploration.strategies import STRATEGIES
from explore_slam.exploration.tiles import tiles_of
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
_RETREAT_WINDOW = 64  # cells around a vehicle in which a retreat is looked for first


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
        ground: PlanningMap | None = None,
    ) -> None:
        """Prepare a grid for planning.

        trails: where vehicles have driven (m), which is passable whatever the map shows.
        keep_out: places (m) where vehicles were blocked.
        forbidden: cells (H, W), occupied in the grid, that no vehicle may enter: unlike an
        obstacle on a trail, they are not looked at again.
        memory: of the searches for paths, kept from cycle to cycle.
        ground: what is derived from the grid, kept from cycle to cycle; a scene holds until the
        next one is made of it.
        """
        self._memory = memory or SearchMemory()
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
        narrowest = min(self._bodies.values(), key=_envelope, default=VehicleBody())
        kinds = {_envelope(self._bodies[name]): self._bodies[name] for name in self.vehicles}
        kinds[narrowest.envelope] = narrowest
        if ground is None:
            probable = self._probability_costs
            ground = PlanningMap(config.paths, probability_costs=probable)
        ground.update(grid, {envelope: self._paths(body) for envelope, body in kinds.items()})
        # by the envelope (m) of a body
        self._layers: dict[float, CostLayer] = {}
        self._maps: dict[float, CostMap] = {}
        for envelope, body in kinds.items():
            layer, costs = ground.layer(envelope, self._overlay(body))
            self._layers[envelope], self._maps[envelope] = layer, costs
        self._lowest = self._layers[narrowest.envelope].least
        self.costs: CostMap = self._map_for(narrowest)
        self.layer = self._layers[narrowest.envelope]
        # the same in all cycles, so that costs between blocks can be kept
        self._route_radius = self._paths(narrowest).planning_radius
        self.starts: dict[str, Cell] = {}
        self.reach: dict[str, NDArray[np.bool_]] = {}
        self.tight: set[str] = set()
        self._reach_before: dict[str, NDArray[np.bool_]] = {}  # without tight passages
        self._routes: dict[float, RouteGrid] = {}
        self._costs_from: dict[str, CostsFrom] = {}
        self._padded: dict[tuple[float, bool], Costs] = {}
        for name in sorted(self.vehicles):
            self._place(name)

    # -- what is passable ------------------------------------------------------------------------

    def _paths(self, body: VehicleBody) -> PathConfig:
        return paths_of(self.config.paths, body)

    def _overlay(self, body: VehicleBody) -> Overlay:
        """Return what a vehicle of this size must respect, or may use, beside the map."""
        scale, radius = self.grid.resolution, self._paths(body).planning_radius
        others = [
            self._disc(other.pose, self._paths(other.body).planning_radius + radius)
            for other in self._others.values()
        ]
        trails = [
            self._trail_cells(trail)
            for name, trail in self._trails.items()
            if self._bodies.get(name, body).envelope >= body.envelope  # else it may not fit there
        ]
        return Overlay(
            tuple(others),
            np.concatenate([np.empty((0, 2), np.int64), *trails]),
            math.floor(_TRAIL_MARGIN / scale),
            self._trail_prices(radius),
            tuple(self._disc(place, _KEEP_OUT_RADIUS) for place in self._keep_out),
        )

    def _disc(self, place: Point | Pose2, radius: float) -> Disc:
        """Return the cells of a disc around a place; both in m."""
        return *self.cell_of(place), radius / self.grid.resolution

    def _trail_cells(self, trail: list[Point]) -> NDArray[np.int64]:
        """Return the cells (N, 2) along a trail."""
        if not trail:
            return np.empty((0, 2), np.int64)
        return self.grid.to_cell(sample(np.array(trail), 0.5 * self.grid.resolution))

    def _trail_prices(self, planning_radius: float) -> NDArray[np.float32]:
        """Return what cells along a trail cost, by squared distance (cells) to an obstacle."""
        radius = planning_radius / self.grid.resolution
        distances = np.sqrt(np.arange(math.ceil(radius * radius) + 1))
        return tight_factor(np.minimum(distances, radius), radius)

    def _map_for(self, body: VehicleBody) -> CostMap:
        """Return the costs for a body, with all that a vehicle of this size must respect."""
        return self._maps[body.envelope]

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
        if name in self.tight:
            self.reach[name] = connected_region(self.cost_of(name), cell[0], cell[1])
        else:
            self.reach[name] = self._layers[self._bodies[name].envelope].region(cell)

    def _key(self, name: str) -> tuple[float, bool]:
        """Return what the costs of a vehicle depend on: its size, and whether it is trapped."""
        return self._bodies[name].envelope, name in self.tight

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
            radius = self._paths(self._bodies[name]).planning_radius
            allowed = ~made.unknown
            if self.forbidden is not None:
                allowed &= ~self.forbidden
            open_around(
                made.tight_cost,
                allowed,
                made.squared,
                self._trail_cells(self._trails.get(name, [])),
                math.floor(_TRAIL_MARGIN / self.grid.resolution),
                self._trail_prices(radius),
                np.ones(tiles_of(allowed.shape), np.bool_),
            )
            for place in self._keep_out:
                self._block_disc(made.tight_cost, place, _KEEP_OUT_RADIUS)
            mask = connected_region(made.tight_cost, *self.starts[name])
            if not self._leads_further(mask, name):
                return False
        self.tight.add(name)
        self._reach_before[name] = self.reach[name]
        self.reach[name] = mask
        self._routes.clear()
        self._costs_from.clear()
        return True

    def forbid_tight(self, name: str) -> None:
        """Undo allow_tight."""
        self.tight.remove(name)
        self.reach[name] = self._reach_before.pop(name)
        self._routes.clear()
        self._costs_from.clear()

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
        if name not in self.tight:
            return self._layers[self._bodies[name].envelope].padded
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

    def frontier_cache(self, viewpoints: NDArray[np.bool_]) -> FrontierCache | None:
        """Return what was found out in the last search with these viewpoints (H, W), if it was."""
        return self.layer.frontier_cache(viewpoints)

    def free_area(self) -> tuple[float, float]:
        """Return the known free area, and the part of it that vehicles can cover (m²).

        Vehicles cover what lies within the planning radius of cells that they can get to. Only
        the part counts in which a vehicle would fit. While most of the passable cells can be
        reached, those are counted instead, which is less work.
        """
        reach = self.reachable()
        inside = not self.tight and len(self._layers) == 1  # all that is reached is passable
        reached = np.count_nonzero(reach if inside else reach & np.isfinite(self.costs.cost))
        if 2 * reached >= self.layer.passable_cells:
            cell = self.grid.resolution**2
            return float(self.layer.passable_cells) * cell, float(reached) * cell
        passable = np.isfinite(self.costs.cost)
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
            reach = _union(self.reach[name] for name in names)
            larger = any(self._bodies[name].envelope > radius for name in names)
            if larger or self.tight.intersection(names):
                made = self._maps[radius]
                cost = made.tight_cost if self.tight.intersection(names) else made.cost
                self._routes[radius] = RouteGrid(cost, reach, first, block, scale)
            else:
                masks = [self.reach[name] for name in names]
                self._routes[radius] = self._layers[radius].routes(masks, reach, block, first)
        return self._routes[radius]

    def cost_to(self, name: str, cells: NDArray[np.int64]) -> Array:
        """Return the travel cost (N,) m of a vehicle to cells (N, 2); inf if unreachable."""
        if self._probability_costs:
            values = self._spread(self.padded_of(name), self.starts[name])
            costs = values[cells[:, 0], cells[:, 1]].astype(np.float64)
        else:
            routes = self._routes_from(self._bodies[name].envelope)
            if name not in self._costs_from:
                start = np.array([self.starts[name]])
                self._costs_from[name] = CostsFrom(routes, routes.blocks(start)[0])
            costs = self._costs_from[name].to(routes.blocks(cells))
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

    def path(self, name: str, goal: Cell, standing: Iterable[str] = ()) -> Array | None:
        """Return the smoothed path (W, 2) m of a vehicle to a cell, or None.

        standing: names of vehicles that stand still, beside which the path avoids to lead.
        """
        padded = self.padded_of(name)
        cells = [self._beside(name, other) for other in standing]
        if not cells:
            return self._path_over(padded, name, goal)
        beside = np.unique(np.concatenate(cells))
        dearer = padded.ravel()[beside] * np.float32(_BYPASS_FACTOR)
        with _changed(padded, beside, dearer):
            return self._path_over(padded, name, goal)

    def _path_over(self, padded: Costs, name: str, goal: Cell) -> Array | None:
        """Return the smoothed path (W, 2) m of a vehicle to a cell over padded costs, or None."""
        stride = padded.shape[1]
        row, col = self.starts[name]
        start, end = (row + 1) * stride + col + 1, (goal[0] + 1) * stride + goal[1] + 1
        flat, _ = search_path(padded, start, end, self._memory, self._lowest)
        if flat.size == 0:
            return None
        rows, cols = np.divmod(flat, stride)
        corners = shortcut(padded[1:-1, 1:-1], np.stack([rows - 1, cols - 1], axis=1))
        pose = self.vehicles[name].pose
        points = np.vstack([[(pose.x, pose.y)], self.grid.to_point(corners)])
        if self.cell_of(pose) == (row, col) and len(points) > 2:
            points = np.delete(points, 1, axis=0)
        return points

    def _beside(self, name: str, other: str) -> NDArray[np.int64]:
        """Return the cells beside a vehicle that others avoid, as flat indices of padded costs."""
        radius = separation(self.config.traffic, self._bodies[name], self._bodies[other])
        row, col = self.cell_of(self.vehicles[other].pose)
        return self._flat_disc(row, col, radius / self.grid.resolution)

    def _flat_disc(self, row: int, col: int, radius: float) -> NDArray[np.int64]:
        """Return the cells of a disc within the grid, as flat indices of padded costs."""
        height, width = self.grid.shape
        half = math.floor(radius)
        low_row, low_col = max(0, row - half), max(0, col - half)
        side = (
            max(0, min(height, row + half + 1) - low_row),
            max(0, min(width, col + half + 1) - low_col),
        )
        mask = np.zeros(side, np.bool_)
        set_disc(mask, row - low_row, col - low_col, radius)
        rows, cols = np.nonzero(mask)
        flat: NDArray[np.int64] = (rows + low_row + 1) * (width + 2) + cols + low_col + 1
        return flat

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
        scale = self.grid.resolution
        apart = [separation(self.config.traffic, one.body, other.body) for other in others]
        taken = [np.empty(0, np.int64)]
        for other, distance in zip(others, apart, strict=True):
            gap = math.dist(other.position, one.position)
            place = (float(other.position[0]), float(other.position[1]))
            radius = min(distance, gap - 1.5 * scale) / scale
            if radius >= 0.0:
                taken.append(self._flat_disc(*self.cell_of(place), radius))
        closed = np.unique(np.concatenate(taken))
        padded = self.padded_of(one.name)
        with _changed(padded, closed, np.full(closed.size, np.inf, np.float32)):
            if not math.isfinite(padded[start[0] + 1, start[1] + 1]):
                return None, math.inf
            swept = [
                (self.grid.to_cell(sample(other.points, _RETREAT_SPACING)),
                 (distance + _STOPPING_ERROR) / scale + 1.0)
                for other, distance in zip(others, apart, strict=True)
            ]  # fmt: skip
            best, cost = self._nearest_aside(padded, start, swept)
            if best is None:
                return None, math.inf
            return self._path_over(padded, one.name, best), cost

    def _nearest_aside(
        self, padded: Costs, start: Cell, swept: list[tuple[NDArray[np.int64], float]]
    ) -> tuple[Cell | None, float]:
        """Return the cell nearest to a start that is not swept, and the cost of travel to it (m).

        swept: cells (N, 2), and the radius (cells) around them. The search is limited to a window,
        which grows until no cell beyond it can be nearer.
        """
        height, width = self.grid.shape
        half = _RETREAT_WINDOW
        while True:
            low_row, low_col = max(0, start[0] - half), max(0, start[1] - half)
            high_row, high_col = min(height, start[0] + half + 1), min(width, start[1] + half + 1)
            window = np.full((high_row - low_row + 2, high_col - low_col + 2), np.inf, np.float32)
            window[1:-1, 1:-1] = padded[low_row + 1 : high_row + 1, low_col + 1 : high_col + 1]
            values = self._spread(window, (start[0] - low_row, start[1] - low_col))
            covered = np.zeros(values.shape, np.bool_)
            for cells, radius in swept:
                for row, col in cells.tolist():
                    set_disc(covered, row - low_row, col - low_col, radius)
            values[covered] = np.inf
            row, col = divmod(int(np.argmin(values)), values.shape[1])
            least = float(values[row, col])
            # a cell outside of the window is at least `half` steps away
            if least < half * self._lowest * self.grid.resolution:
                return (row + low_row, col + low_col), least
            if values.shape == (height, width):
                found = (row, col) if math.isfinite(least) else None
                return found, least
            half *= 2


@contextmanager
def _changed(
    padded: Costs, cells: NDArray[np.int64], values: NDArray[np.float32]
) -> Iterator[None]:
    """Let some cells, flat indices of padded costs, have other values for a while."""
    flat = padded.reshape(-1)
    before = flat[cells]
    flat[cells] = values
    try:
        yield
    finally:
        flat[cells] = before


def _union(masks: Iterable[NDArray[np.bool_]]) -> NDArray[np.bool_]:
    """Return where any of the masks (H, W) holds."""
    different = list({id(mask): mask for mask in masks}.values())
    return different[0] if len(different) == 1 else np.logical_or.reduce(different)


def _envelope(body: VehicleBody) -> float:
    return body.envelope
