"""The stateful planner: frontiers, costs, assignment and paths of a team, cycle by cycle."""

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import Plan
from explore_slam.exploration.assignment import (
    assign_jointly,
    assign_nearest,
    assign_random,
    assign_targets,
)
from explore_slam.exploration.blacklist import Blacklist
from explore_slam.exploration.clearance import CostMap, make_cost_map
from explore_slam.exploration.config import ExplorationConfig
from explore_slam.exploration.frontiers import find_frontiers, visible_unknown
from explore_slam.exploration.paths import search_path, shortcut
from explore_slam.exploration.records import (
    Cell,
    ExplorationStatus,
    Frontier,
    Grid,
    PlanningMode,
    PlanningResult,
    Point,
    VehicleSnapshot,
)
from explore_slam.exploration.value_iteration import padded_costs, spread
from explore_slam.geometry import Array, Pose2

LOGGER = logging.getLogger(__name__)
RAYS = 48


@dataclass
class Task:
    """What one vehicle is at: where it goes, on which plan, and how it gets on."""

    target: Point
    plan: Plan
    nearest: float = math.inf
    since: float = 0.0
    arrivals: int = 0


@dataclass
class Scene:
    """All that one planning cycle knows of the map and the vehicles that take part."""

    grid: Grid
    now: float
    costs: CostMap
    padded: NDArray[np.float32]
    vehicles: dict[str, VehicleSnapshot]
    starts: dict[str, Cell]
    values: dict[str, Array] = field(default_factory=dict)


class Planner:
    """Decides where each vehicle goes next; keeps goals, plans and failures between cycles."""

    def __init__(self, config: ExplorationConfig | None = None) -> None:
        self.config = config or ExplorationConfig()
        self._tasks: dict[str, Task] = {}
        self._homes: dict[str, Pose2] = {}
        self._blacklist = Blacklist(self.config.blacklist)
        self._random = np.random.default_rng(self.config.assignment.exploration_seed)
        self._blocked: list[tuple[str, Point, float]] = []
        self._empty = 0
        self._cycles = 0
        self._complete = False

    def report_blocked(self, vehicle: str, goal: Pose2 | Point, now: float) -> None:
        """Take note that a vehicle cannot get to its goal; another target is chosen for it."""
        self._blocked.append((vehicle, (float(goal[0]), float(goal[1])), now))
        self._tasks.pop(vehicle, None)

    def plan(
        self,
        grid: Grid,
        now: float,
        vehicles: Mapping[str, VehicleSnapshot],
        mode: PlanningMode | str = PlanningMode.EXPLORE,
    ) -> PlanningResult:
        """Run one planning cycle at time `now` (s); see PlanningResult."""
        wanted = PlanningMode(mode)
        for name, snapshot in vehicles.items():
            if snapshot.pose.is_finite():
                self._homes.setdefault(name, snapshot.home or snapshot.pose)
        if wanted is PlanningMode.PAUSED:
            return PlanningResult(ExplorationStatus.PAUSED, 'paused', searched=False)
        scene, reason = self._look(grid, now, vehicles)
        if scene is None:
            return self._cannot_search(reason)
        self._cycles += 1
        self._take_failures(scene)
        if wanted is PlanningMode.RETURN_HOME:
            return self._go_home(scene, ExplorationStatus.RETURNED, ())
        return self._explore(scene)

    def _cannot_search(self, reason: str) -> PlanningResult:
        status = ExplorationStatus.IN_PROGRESS if self._cycles else ExplorationStatus.STARTED
        plans = {name: task.plan for name, task in self._tasks.items()}
        return PlanningResult(status, f'cannot search now: {reason}', plans, searched=False)

    def _look(
        self, grid: Grid, now: float, vehicles: Mapping[str, VehicleSnapshot]
    ) -> tuple[Scene | None, str]:
        if 0 in grid.shape:
            return None, 'the map is empty'
        active = {n: v for n, v in vehicles.items() if v.active and v.pose.is_finite()}
        if not active:
            return None, 'no vehicle with a valid pose'
        paper = self.config.assignment.strategy == 'paper'
        costs = make_cost_map(grid, self.config.paths, paper_costs=paper)
        idle = [v.pose for n, v in vehicles.items() if n not in active and v.pose.is_finite()]
        self._block_bodies(grid, costs.cost, idle)
        padded = padded_costs(costs.cost, np.inf)
        starts = {}
        for name in sorted(active):
            cell = self._start_cell(grid, costs.cost, active[name].pose)
            if cell is not None:
                starts[name] = cell
        if not starts:
            return None, 'no vehicle stands on or near a free cell of the map'
        scene = Scene(grid, now, costs, padded, active, starts)
        for name, (row, col) in starts.items():
            source = np.array([row + 1], np.int64), np.array([col + 1], np.int64)
            scene.values[name] = spread(padded, *source)[1:-1, 1:-1] * grid.resolution
        return scene, ''

    def _block_bodies(self, grid: Grid, cost: NDArray[np.float32], poses: list[Pose2]) -> None:
        """Vehicles that nobody can send away are obstacles, as wide as two vehicles."""
        reach = 2.0 * self.config.paths.vehicle_radius / grid.resolution
        half = math.ceil(reach)
        for pose in poses:
            row, col = grid.to_cell([(pose.x, pose.y)])[0].tolist()
            low_r, low_c = max(0, row - half), max(0, col - half)
            window = cost[low_r : max(0, row + half + 1), low_c : max(0, col + half + 1)]
            r, c = np.ogrid[low_r : low_r + window.shape[0], low_c : low_c + window.shape[1]]
            window[(r - row) ** 2 + (c - col) ** 2 <= reach * reach] = np.inf

    def _start_cell(self, grid: Grid, cost: NDArray[np.float32], pose: Pose2) -> Cell | None:
        """Return the cell of the vehicle, or the nearest passable one if it stands in none."""
        row, col = grid.to_cell([(pose.x, pose.y)])[0].tolist()
        return nearest_passable(
            cost, (row, col), self.config.paths.escape_distance / grid.resolution
        )

    def _take_failures(self, scene: Scene) -> None:
        known = ~scene.costs.unknown
        self._blacklist.refresh(scene.grid, known)
        for _, place, _ in self._blocked:
            self._blacklist.add(place, scene.now, scene.grid, known)
        self._blocked.clear()

    def _explore(self, scene: Scene) -> PlanningResult:
        reachable = np.any([np.isfinite(v) for v in scene.values.values()], axis=0)
        found = find_frontiers(scene.grid, self.config, scene.costs, reachable)
        open_now = [f for f in found if not self._blacklist.blocks(f.target, scene.now)]
        if not open_now:
            open_now = [f for f in found if not self._blacklist.gave_up(f.target)]
        self._empty = 0 if open_now else self._empty + 1
        if not open_now:
            self._tasks.clear()
            if self._empty < self.config.empty_searches:
                return PlanningResult(
                    ExplorationStatus.IN_PROGRESS,
                    f'no target in search {self._empty} of {self.config.empty_searches}',
                    frontiers=tuple(found),
                    unreachable=len(found),
                )
            self._complete = True
            if self.config.return_to_init:
                return self._go_home(scene, ExplorationStatus.RETURNED, tuple(found))
            reason = f'no target left, {len(found)} given up'
            return PlanningResult(
                ExplorationStatus.COMPLETE, reason, frontiers=tuple(found), unreachable=len(found)
            )
        self._complete = False
        return self._assign(scene, open_now)

    def _assign(self, scene: Scene, frontiers: list[Frontier]) -> PlanningResult:
        names = tuple(scene.starts)
        rows = np.array([f.target_cell for f in frontiers])
        costs = np.array([scene.values[n][rows[:, 0], rows[:, 1]] for n in names])
        chosen = self._choose(scene, names, frontiers, costs)
        plans: dict[str, Plan] = {}
        waiting: dict[str, str] = {}
        tasks: dict[str, Task] = {}
        for name, index in zip(names, chosen, strict=True):
            if index < 0:
                waiting[name] = 'no target left for this vehicle'
                continue
            task = self._task_for(scene, name, frontiers[index])
            if task is None:
                waiting[name] = 'no path to its target'
                continue
            tasks[name] = task
            plans[name] = task.plan
        self._tasks = tasks
        status = ExplorationStatus.STARTED if self._cycles == 1 else ExplorationStatus.IN_PROGRESS
        return PlanningResult(
            status, f'{len(frontiers)} frontiers', plans, waiting, tuple(frontiers), names, costs
        )

    def _choose(
        self, scene: Scene, names: tuple[str, ...], frontiers: list[Frontier], costs: Array
    ) -> list[int]:
        config = self.config
        sensor = config.frontiers.sensor_range
        targets = np.array([f.target for f in frontiers])
        kept = self._kept_targets(names, targets)
        strategy = config.assignment.strategy
        if strategy == 'random':
            drawn = assign_random(costs, self._random)
            return [k if k >= 0 else d for k, d in zip(kept, drawn, strict=True)]
        biased = costs.copy()
        for i, target in enumerate(kept):
            if target >= 0:
                biased[i, target] -= config.assignment.hysteresis
        if strategy == 'nearest':
            return assign_nearest(biased)
        if strategy == 'paper':
            return assign_targets(biased, targets, sensor, config.assignment.travel_weight)
        gains = self._gains(scene, frontiers)
        biased -= config.assignment.gain_weight * gains[None]
        return assign_jointly(biased, targets, sensor, config.assignment.overlap_weight)

    def _gains(self, scene: Scene, frontiers: list[Frontier]) -> Array:
        """Return for each frontier the unknown area in sight of its target, as a share of a disc."""
        reach = int(self.config.frontiers.sensor_range / scene.grid.resolution)
        occupied = ~(scene.costs.free | scene.costs.unknown)
        area = math.pi * reach * reach
        return np.array(
            [
                visible_unknown(occupied, scene.costs.unknown, *f.target_cell, reach, RAYS) / area
                for f in frontiers
            ]
        )

    def _kept_targets(self, names: tuple[str, ...], targets: Array) -> list[int]:
        """Return for each vehicle the target that continues its present one, or -1."""
        kept = []
        for name in names:
            task = self._tasks.get(name)
            index = -1
            if task is not None:
                distances = np.linalg.norm(targets - np.array(task.target), axis=1)
                nearest = int(np.argmin(distances))
                if distances[nearest] <= 1.0:
                    index = nearest
            kept.append(index)
        return kept

    def _task_for(self, scene: Scene, name: str, frontier: Frontier) -> Task | None:
        """Return the present task if it still leads there, a new one otherwise."""
        old = self._tasks.get(name)
        pose = scene.vehicles[name].pose
        if old is not None and math.dist(old.target, frontier.target) <= 0.5:
            remaining = math.dist((pose.x, pose.y), old.target)
            arrived = remaining <= self.config.paths.goal_tolerance
            if remaining < old.nearest - 0.1:
                old.nearest, old.since = remaining, scene.now
            stuck = scene.now - old.since > self.config.blacklist.progress_timeout
            old.arrivals += arrived
            if old.arrivals >= self.config.empty_searches or stuck:
                self._blocked.append((name, frontier.target, scene.now))
            elif not arrived and self._is_passable(scene, pose, old.plan):
                return old
        plan = self._path(scene, name, frontier.target_cell, frontier.centroid)
        if plan is None:
            return None
        task = Task(frontier.target, plan, math.inf, scene.now)
        if old is not None and math.dist(old.target, frontier.target) <= 0.5:
            task.nearest, task.since, task.arrivals = old.nearest, old.since, old.arrivals
        return task

    def _is_passable(self, scene: Scene, pose: Pose2, plan: Plan) -> bool:
        """Tell whether the part of a plan that lies ahead is still free."""
        points = plan.waypoints
        ahead = int(np.argmin(np.linalg.norm(points - (pose.x, pose.y), axis=1)))
        steps = np.diff(points[ahead:], axis=0)
        count = np.maximum(1, np.ceil(np.hypot(*steps.T) / scene.grid.resolution)).astype(int)
        samples = [
            points[ahead + i] + steps[i] * (np.arange(n)[:, None] + 1) / n
            for i, n in enumerate(count)
        ]
        if not samples:
            return True
        cells = scene.grid.to_cell(np.concatenate(samples))
        inside = (cells >= 0).all(axis=1) & (cells < scene.grid.shape).all(axis=1)
        return bool(inside.all()) and bool(
            np.isfinite(scene.costs.cost[cells[:, 0], cells[:, 1]]).all()
        )

    def _path(
        self, scene: Scene, name: str, goal: Cell, look_at: Point | None = None
    ) -> Plan | None:
        stride = scene.padded.shape[1]
        row, col = scene.starts[name]
        start = (row + 1) * stride + col + 1
        flat, _ = search_path(scene.padded, start, (goal[0] + 1) * stride + goal[1] + 1)
        if flat.size == 0:
            return None
        rows, cols = np.divmod(flat, stride)
        corners = shortcut(scene.costs.cost, np.stack([rows - 1, cols - 1], axis=1))
        pose = scene.vehicles[name].pose
        points = np.vstack([[(pose.x, pose.y)], scene.grid.to_point(corners)])
        if np.array_equal(scene.grid.to_cell(points[:1])[0], corners[0]) and len(points) > 2:
            points = np.delete(points, 1, axis=0)
        end = points[-1]
        towards = look_at if look_at and math.dist(look_at, end) > 1e-6 else None
        dx, dy = (np.array(towards) - end if towards else end - points[-2]).tolist()
        heading = math.atan2(dy, dx) if dx or dy else pose.theta
        return Plan(scene.now, name, Pose2(float(end[0]), float(end[1]), heading), points)

    def _go_home(
        self, scene: Scene, done: ExplorationStatus, frontiers: tuple[Frontier, ...]
    ) -> PlanningResult:
        plans: dict[str, Plan] = {}
        waiting: dict[str, str] = {}
        tasks: dict[str, Task] = {}
        for name in scene.starts:
            home, pose = self._homes[name], scene.vehicles[name].pose
            if math.dist(home[:2], pose[:2]) <= self.config.paths.goal_tolerance:
                waiting[name] = 'home'
                continue
            goal = self._start_cell(scene.grid, scene.costs.cost, home)
            if goal is None or not math.isfinite(scene.values[name][goal]):
                waiting[name] = 'its home cannot be reached'
                continue
            old = self._tasks.get(name)
            if (
                old is not None
                and math.dist(old.target, home[:2]) < 1e-9
                and self._is_passable(scene, pose, old.plan)
            ):
                tasks[name] = old
            else:
                plan = self._path(scene, name, goal)
                if plan is None:
                    waiting[name] = 'its home cannot be reached'
                    continue
                tasks[name] = Task((home.x, home.y), plan, math.inf, scene.now)
            plans[name] = tasks[name].plan
        self._tasks = tasks
        status = ExplorationStatus.RETURNING if plans else done
        reason = 'on the way home' if plans else 'home'
        return PlanningResult(
            status, reason, plans, waiting, frontiers, unreachable=len(frontiers)
        )


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
