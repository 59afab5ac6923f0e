"""The stateful planner: frontiers, costs, assignment, paths and right of way, cycle by cycle."""

import itertools
import logging
import math
from collections.abc import Iterable, Mapping

import numpy as np

from explore_slam.data import Plan
from explore_slam.exploration.blacklist import Blacklist
from explore_slam.exploration.choice import Chooser
from explore_slam.exploration.config import ExplorationConfig
from explore_slam.exploration.frontiers import find_frontiers
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
from explore_slam.exploration.scene import Scene
from explore_slam.exploration.tasks import SAME_PLACE, Task, plan_by
from explore_slam.exploration.traffic import (
    Right,
    Traffic,
    Traveler,
    remaining_path,
)
from explore_slam.geometry import Array, Pose2
from explore_slam.polyline import arc_lengths, points_at

LOGGER = logging.getLogger(__name__)
FOLLOWS = 2.0  # m: a frontier whose target moved by no more is the same frontier, receding
ARRIVALS = 3  # plannings at a target after which it has nothing new to show
NEAR = 2.0  # m: a vehicle that is blocked this near to its target has failed to reach it
BLOCKINGS = 3  # so many times blocked on the way mean the same
BAR_AHEAD, BAR_TIME = 0.5, 60.0  # m, s: what is barred when blocked on the way, how long
SHUT_IN, UNBARRINGS = 2.0, 5  # m: bars this near to one who is shut in are dropped so often
ELSEWHERE = 8.0  # m: so far from there it is counted anew
WALL, WALL_STEP = 1.0, 0.3  # m: places barred for good so near to each other are one wall
BAR_TRAFFIC = 1.5  # m: with another vehicle this near it was that vehicle that was in the way
TRAIL = 300  # places where a vehicle has been that are remembered
JUMP = 3.0  # m between two plannings: the pose was corrected, the trail means nothing any more


class Planner:
    """Decides where each vehicle goes next; keeps goals, plans and failures between cycles."""

    def __init__(self, config: ExplorationConfig | None = None) -> None:
        self.config = config or ExplorationConfig()
        self._tasks: dict[str, Task] = {}
        self._homes: dict[str, Pose2] = {}
        self._blacklist = Blacklist(self.config.blacklist)
        self._traffic = Traffic(self.config.traffic)
        self._retreats: dict[str, Plan] = {}
        self._chooser = Chooser(self.config)
        self._failed: list[tuple[Point, bool]] = []
        self._trails: dict[str, list[Point]] = {}
        self._bars: list[tuple[Point, float]] = []
        self._dropped: list[tuple[Point, float]] = []
        self._blockings: dict[str, int] = {}
        self._unbarred: dict[str, tuple[int, Point]] = {}
        self._poses: dict[str, Pose2] = {}
        self._empty = 0
        self._cycles = 0

    def report_blocked(self, vehicle: str, goal: Pose2 | Point, now: float) -> None:
        """Take note that a vehicle cannot get on towards its goal.

        Near the goal, or after several times on the way, the target has failed. Farther away it is
        the place just ahead that is barred for a while, so that another way is tried.
        """
        LOGGER.info('%s is blocked on its way to (%.2f, %.2f) at %.1f s', vehicle, *goal[:2], now)
        task, pose = self._tasks.pop(vehicle, None), self._poses.get(vehicle)
        target = task.target if task else (float(goal[0]), float(goal[1]))
        count = self._blockings[vehicle] = self._blockings.get(vehicle, 0) + 1
        far = pose is not None and math.dist(pose[:2], target) > NEAR
        if task is None or pose is None or not far or count >= BLOCKINGS:
            self._failed.append((target, False))
            self._blockings[vehicle] = 0
        if task is not None and pose is not None:
            ahead = remaining_path(np.array(pose[:2]), task.path)
            x, y = points_at(ahead, arc_lengths(ahead), np.array([BAR_AHEAD]))[0].tolist()
            self._bar(vehicle, (x, y), now)

    def _bar(self, vehicle: str, place: Point, now: float) -> None:
        """Bar a place for a while, and for good when it is the second time; not for a vehicle."""
        others = (pose for name, pose in self._poses.items() if name != vehicle)
        if any(math.dist(pose[:2], place) < BAR_TRAFFIC for pose in others):
            return
        again = any(math.dist(bar, place) < SAME_PLACE for bar, _ in self._bars + self._dropped)
        self._bars.append((place, math.inf if again else now + BAR_TIME))

    def _barred(self) -> list[Point]:
        """Return all barred places; between two that stay barred there is a wall, say glass."""
        places = [place for place, _ in self._bars]
        walls = [place for place, until in self._bars if math.isinf(until)]
        for first, second in itertools.combinations(walls, 2):
            length = math.dist(first, second)
            if length <= WALL:
                shares = np.arange(WALL_STEP, length, WALL_STEP) / length
                between = np.array(first) + shares[:, None] * (np.array(second) - first)
                places += [(x, y) for x, y in between.tolist()]
        return places

    def plan(
        self,
        grid: Grid,
        now: float,
        vehicles: Mapping[str, VehicleSnapshot],
        mode: PlanningMode | str = PlanningMode.EXPLORE,
    ) -> PlanningResult:
        """Run one planning cycle at time `now` (s); see PlanningResult."""
        wanted = PlanningMode(mode)
        self._follow(vehicles)
        self._dropped += [bar for bar in self._bars if now >= bar[1]]
        self._bars = [bar for bar in self._bars if now < bar[1]]
        if wanted is PlanningMode.PAUSED:
            return PlanningResult(ExplorationStatus.PAUSED, 'paused', searched=False)
        if 0 in grid.shape:
            return self._cannot_search('the map is empty')
        scene = Scene(grid, now, self.config, vehicles, self._trails, self._barred())
        if not scene.vehicles:
            return self._cannot_search('no vehicle with a valid pose')
        if not scene.starts:
            return self._cannot_search('no vehicle stands on or near a free cell of the map')
        self._cycles += 1
        self._blacklist.refresh(grid, scene.costs.free)
        for place, final in self._failed:
            self._blacklist.add(place, now, grid, scene.costs.free, final=final)
        self._failed.clear()
        if wanted is PlanningMode.RETURN_HOME:
            return self._go_home(scene, ())
        return self._explore(scene)

    def _follow(self, vehicles: Mapping[str, VehicleSnapshot]) -> None:
        """Remember where vehicles are, have been and are at home."""
        for name, snapshot in vehicles.items():
            pose = snapshot.pose
            if not pose.is_finite():
                continue
            self._homes.setdefault(name, snapshot.home or pose)
            self._poses[name] = pose
            trail = self._trails.setdefault(name, [])
            if trail and math.dist(trail[-1], pose[:2]) > JUMP:
                trail.clear()
            if not trail or math.dist(trail[-1], pose[:2]) > 0.05:
                trail.append((pose.x, pose.y))
            del trail[:-TRAIL]

    def _cannot_search(self, reason: str) -> PlanningResult:
        """Keep all plans as they are; this is neither an empty search nor the end."""
        plans = {name: task.sent for name, task in self._tasks.items() if task.sent}
        text = f'cannot search now: {reason}'
        return PlanningResult(ExplorationStatus.PAUSED, text, plans, searched=False)

    def _explore(self, scene: Scene) -> PlanningResult:
        found = find_frontiers(scene.grid, self.config, scene.costs, scene.reachable())
        if self._widen_shut_in(scene, found):
            found = find_frontiers(scene.grid, self.config, scene.costs, scene.reachable())
        open_now = [f for f in found if not self._blacklist.blocks(f.target, scene.now)]
        if not open_now:
            open_now = [f for f in found if not self._blacklist.gave_up(f.target)]
        if open_now:
            self._empty = 0
            return self._assign(scene, open_now)
        passing = [bar for bar in self._bars if math.isfinite(bar[1])]
        if passing:
            # What is barred may be the only way on: that is no reason to call it done.
            self._bars = [bar for bar in self._bars if bar not in passing]
            self._dropped += passing
            reason = 'no target beside barred places, which are tried again'
            return self._finish(scene, ExplorationStatus.IN_PROGRESS, reason, {}, {}, tuple(found))
        if not found and self._unbar(scene.starts):
            reason = 'no target beside barred places, which are tried once more'
            return self._finish(scene, ExplorationStatus.IN_PROGRESS, reason, {}, {}, tuple(found))
        self._empty += 1
        if self._empty < self.config.empty_searches:
            reason = f'no target in search {self._empty} of {self.config.empty_searches}'
            return self._finish(scene, ExplorationStatus.IN_PROGRESS, reason, {}, {}, tuple(found))
        if self.config.return_to_init:
            return self._go_home(scene, tuple(found))
        reason = f'nothing left to explore, {len(found)} frontiers given up'
        return self._finish(scene, ExplorationStatus.COMPLETE, reason, {}, {}, tuple(found))

    def _widen_shut_in(self, scene: Scene, frontiers: list[Frontier]) -> bool:
        """Let vehicles that reach no frontier through tight places; tell whether that helps."""
        cells = [f.target_cell for f in frontiers if not self._blacklist.gave_up(f.target)]
        shut_in = [n for n, mask in scene.reach.items() if not any(mask[cell] for cell in cells)]
        widened = [scene.widen(name) for name in shut_in]
        return any(widened)

    def _assign(self, scene: Scene, frontiers: list[Frontier]) -> PlanningResult:
        names = tuple(scene.starts)
        costs = scene.costs_to(names, frontiers)
        kept = self._kept_targets(names, np.array([f.target for f in frontiers]))
        self._forgive(scene, names, kept)
        self._unbar(n for n, row in zip(names, costs, strict=True) if not np.isfinite(row).any())
        changes = [
            self._tasks[n].changes if k >= 0 else 0 for n, k in zip(names, kept, strict=True)
        ]
        chosen = self._chooser.choose(scene, frontiers, costs, kept, changes)
        tasks: dict[str, Task] = {}
        waiting: dict[str, str] = {}
        standing = [n for n, index in zip(names, chosen, strict=True) if index < 0]
        for name, index, before, change in zip(names, chosen, kept, changes, strict=True):
            if index < 0:
                waiting[name] = 'no target left for this vehicle'
                continue
            frontier = frontiers[index]
            look_at = frontier.look_at or frontier.centroid
            task = self._task_for(
                scene, name, frontier.target, frontier.target_cell, look_at, standing
            )
            if task is None:
                waiting[name] = 'no path to its target'
                continue
            tasks[name] = task
            if before >= 0 and before != index:
                task.changes = change + 1
        status = ExplorationStatus.STARTED if self._cycles == 1 else ExplorationStatus.IN_PROGRESS
        reason = f'{len(frontiers)} frontiers'
        return self._finish(scene, status, reason, tasks, waiting, tuple(frontiers), costs)

    def _unbar(self, names: Iterable[str]) -> bool:
        """Drop what is barred around vehicles that reach nothing: it may be their only way out."""
        dropped = False
        for name in names:
            place = (self._poses[name].x, self._poses[name].y)
            near = [bar for bar in self._bars if math.dist(bar[0], place) <= SHUT_IN]
            count, there = self._unbarred.get(name, (0, place))
            if math.dist(place, there) > ELSEWHERE:
                count = 0
            if near and count < UNBARRINGS:
                self._unbarred[name] = count + 1, place
                self._bars = [bar for bar in self._bars if bar not in near]
                dropped = True
        return dropped

    def _forgive(self, scene: Scene, names: tuple[str, ...], kept: list[int]) -> None:
        """Clear the blacklist where a vehicle got to its target and left nothing to be seen."""
        for name, index in zip(names, kept, strict=True):
            task = self._tasks.get(name)
            if task is not None and index < 0:
                self._blockings[name] = 0
                near = math.dist(scene.vehicles[name].pose[:2], task.target) <= NEAR
                if near and not self._blacklist.blocks(task.target, scene.now):
                    self._blacklist.clear(task.target)

    def _kept_targets(self, names: tuple[str, ...], targets: Array) -> list[int]:
        """Return for each vehicle the target that continues its present one, or -1."""
        kept = []
        for name in names:
            task = self._tasks.get(name)
            index = -1
            if task is not None:
                distances = np.linalg.norm(targets - np.array(task.target), axis=1)
                nearest = int(np.argmin(distances))
                if distances[nearest] <= FOLLOWS:
                    index = nearest
            kept.append(index)
        return kept

    def _task_for(
        self,
        scene: Scene,
        name: str,
        target: Point,
        cell: Cell,
        look_at: Point | None,
        standing: list[str],
    ) -> Task | None:
        """Return the present task of a vehicle if it leads there, a new one, or None: no path."""
        old = self._tasks.get(name)
        pose = scene.vehicles[name].pose
        same = old is not None and math.dist(old.target, target) <= SAME_PLACE
        if old is not None and same:
            ahead = remaining_path(np.array([pose.x, pose.y]), old.path)
            remaining = float(arc_lengths(ahead)[-1])
            arrived = math.dist(pose[:2], old.target) <= self.config.paths.goal_tolerance
            if remaining < old.nearest - 0.1 or old.right is not Right.GO:
                old.nearest, old.since = min(remaining, old.nearest), scene.now
            old.arrivals += arrived
            late = scene.now - old.since > self.config.blacklist.progress_timeout
            if old.arrivals >= ARRIVALS or late:
                # Whoever stood there and saw nothing new need not come again.
                self._failed.append((target, old.arrivals >= ARRIVALS))
            elif old.right is Right.GO and not arrived and scene.is_passable(name, ahead):
                return old
        parked = [scene.vehicles[n].pose for n in standing if n != name]
        path = scene.path(name, cell, scene.around_standing(name, parked))
        if path is None:
            return None
        task = Task(target, path, look_at, None, Right.GO, math.inf, scene.now)
        if old is not None and same:
            # Another way may be longer: progress is counted anew, but the time runs on.
            task.since, task.arrivals, task.changes = old.since, old.arrivals, old.changes
            task.sent, task.right = old.sent, old.right
            if old.right is Right.GO:
                task.sent = None
        return task

    def _finish(
        self,
        scene: Scene,
        status: ExplorationStatus,
        reason: str,
        tasks: dict[str, Task],
        waiting: dict[str, str],
        frontiers: tuple[Frontier, ...],
        costs: Array | None = None,
    ) -> PlanningResult:
        """Give rights of way and turn tasks into plans."""
        travelers = {}
        for name in scene.starts:
            pose = scene.vehicles[name].pose
            place = np.array([pose.x, pose.y])
            task = tasks.get(name)
            path = None if task is None else remaining_path(place, task.path)
            travelers[name] = Traveler(name, place, path)
        grants = self._traffic.grant(travelers, scene)
        plans: dict[str, Plan] = {}
        retreats: dict[str, Plan] = {}
        for name, grant in grants.items():
            plan = plan_by(
                scene, tasks.get(name), grant, travelers[name], self._retreats.get(name)
            )
            if grant.right is Right.RETREAT and plan is not None:
                retreats[name] = plan
            if plan is not None:
                plans[name] = plan
            elif grant.right is not Right.GO:
                waiting[name] = f'gives way to {grant.winner}'
        self._tasks, self._retreats = tasks, retreats
        names = tuple(scene.starts)
        matrix = np.empty((len(names), 0)) if costs is None else costs
        unreachable = 0 if costs is not None else len(frontiers)
        return PlanningResult(
            status, reason, plans, waiting, frontiers, names, matrix, True, unreachable
        )

    def _go_home(self, scene: Scene, frontiers: tuple[Frontier, ...]) -> PlanningResult:
        tasks: dict[str, Task] = {}
        waiting: dict[str, str] = {}
        arrived = []
        for name in scene.starts:
            home, pose = self._homes[name], scene.vehicles[name].pose
            if math.dist(home[:2], pose[:2]) <= self.config.paths.goal_tolerance:
                waiting[name] = 'home'
                arrived.append(name)
        for name in scene.starts:
            if name in waiting:
                continue
            home = self._homes[name]
            goal = scene.nearest_passable(home)
            task = None
            if goal is not None and (scene.reach[name][goal] or scene.widen(name)):
                task = self._task_for(scene, name, (home.x, home.y), goal, None, arrived)
            if task is None:
                waiting[name] = 'its home cannot be reached'
            else:
                tasks[name] = task
        status = ExplorationStatus.RETURNING if tasks else ExplorationStatus.RETURNED
        reason = 'on the way home' if tasks else 'home'
        return self._finish(scene, status, reason, tasks, waiting, frontiers)
