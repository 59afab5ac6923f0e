"""The planner: frontiers, travel costs, assignment, paths and right of way, cycle by cycle.

One cycle of exploration, as `Planner.plan` runs it:

1. Record where the vehicles are, and which keep-out zones and blacklisted targets still apply.
2. Find the frontiers that some vehicle can reach (Scene, find_frontiers).
3. Compute the travel costs, and assign frontiers to vehicles by the strategy that is set. A
   vehicle whose map is in doubt may go back to a known place first (LoopSeeking).
4. Continue the present path of each vehicle if it still leads there, or plan a new one.
5. Grant rights of way, and turn paths into plans (Traffic, plan_for).

Without any target, a vehicle may pass through a tight place if that is worth it; then those with a
depth camera visit what no camera has looked at (find_unviewed), and one looks again where a way to
what is left has become blocked (SecondLook). Only then exploration ends.

A vehicle whose battery is low takes no part in this but for the right of way: it drives home, and
what it was on its way to is for the others.
"""

import logging
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import BatteryLevel, Plan
from explore_slam.exploration.blacklist import Blacklist
from explore_slam.exploration.camera_views import find_unviewed
from explore_slam.exploration.config import ExplorationConfig
from explore_slam.exploration.frontiers import find_frontiers
from explore_slam.exploration.keep_out import TRAFFIC_DISTANCE, KeepOutZones
from explore_slam.exploration.known_ways import KnownWays
from explore_slam.exploration.loop_seeking import LoopSeeking
from explore_slam.exploration.paths import SearchMemory
from explore_slam.exploration.planning_map import PlanningMap
from explore_slam.exploration.progress import BlockageCounter, Progress
from explore_slam.exploration.records import (
    Cell,
    ExplorationStatus,
    Frontier,
    Grid,
    PlanningMode,
    PlanningResult,
    Point,
    VehicleSnapshot,
    unreached_text,
)
from explore_slam.exploration.scene import Scene
from explore_slam.exploration.second_look import SecondLook
from explore_slam.exploration.standstill import Standstill
from explore_slam.exploration.strategies import STRATEGIES, Situation
from explore_slam.exploration.tasks import Orders, Task, plan_for
from explore_slam.exploration.traffic import RightOfWay, Traffic, Traveler
from explore_slam.exploration.vehicle_history import VehicleHistory
from explore_slam.geometry import Array, Pose2
from explore_slam.polyline import arc_lengths, points_at, remaining_path

logger = logging.getLogger(__name__)
LookedAt = Callable[[], NDArray[np.bool_] | None]

# Chosen by hand; `explore_slam benchmark exploration` measures what another value does
_SAME_FRONTIER = 2.0  # m; a frontier whose target has moved by no more is the same, receding
_NEAR_TARGET = 2.0  # m; a vehicle that is blocked this near to its target has failed to reach it
_FACING_DISTANCE = 100.0  # m from a goal to the point that a vehicle faces there: a direction
_KEEP_OUT_AHEAD = 0.5  # m along the path from where a vehicle is blocked to its keep-out zone
_LOOKED_AT = 1.0  # m; a vehicle that is blocked this near to its target has seen what is there
_SQUEEZE_GAIN = 4.0  # m²; a tight place is passed for a small room, not for specks
_LONGEST_TRIP = 10.0  # m; a longer way to a frontier asks no more of it
_TRAPPED_AREA = 5.0  # m², of passable cells; keep-out zones may not hold a vehicle in less
_UNSEEN_ROOM = 2.0  # m²; what remains unknown beside a vehicle that is blocked, and is no speck
_LITTLE = 0.5  # of the free area; a warning is given if less can be reached
# m²; frontiers out of reach that are expected to show less are not reported as left
_NOTABLE_GAIN = 1.0


class Planner:
    """Decides where each vehicle goes next; keeps tasks and failures between cycles."""

    def __init__(self, config: ExplorationConfig | None = None) -> None:
        self.config = config or ExplorationConfig()
        self._strategy = STRATEGIES[self.config.strategy].create(
            self.config.assignment, self.config.frontiers.sensor_range
        )
        self._traffic = Traffic(self.config.traffic)
        self._blacklist = Blacklist(self.config.blacklist)
        self._keep_out = KeepOutZones()
        self._blockages = BlockageCounter()
        self._history = VehicleHistory()
        self._ways = KnownWays()
        self._search_memory = SearchMemory()
        probable = STRATEGIES[self.config.strategy].probability_costs
        self._map = PlanningMap(self.config.paths, probability_costs=probable)
        self._second_look = SecondLook(self.config.obstruction_patience)
        self._loop_seeking = LoopSeeking(self.config.loops)
        self._standstill = Standstill(self.config.blacklist.progress_timeout)
        self._squeezing: str | None = None  # the vehicle that passes through a tight place
        self._looked_at: list[Point] = []  # targets (m) reached that show nothing more
        self._plans: dict[str, Plan] = {}  # in force, by name
        self._tasks: dict[str, Task] = {}
        self._retreats: dict[str, Plan] = {}  # plans of vehicles that retreat, by name
        self._warning, self._warned = '', False
        self._searches = 0
        self._empty_searches = 0  # without a target, since the last one with a target

    def report_blocked(self, vehicle: str, goal: Pose2 | Point, now: float) -> None:
        """Report that a vehicle cannot proceed towards its goal (m) at a time (s).

        Near the target, or after several blockages on the way, the target has failed: for all if
        the vehicle has seen from close by what is there, and no other vehicle was in the way, and
        for this vehicle otherwise. In any case the place just ahead becomes a keep-out zone, so
        that another path is tried.
        """
        logger.info('%s is blocked on its way to (%.2f, %.2f) at %.1f s', vehicle, *goal[:2], now)
        task, pose = self._tasks.get(vehicle), self._history.poses.get(vehicle)
        target = task.target if task else (float(goal[0]), float(goal[1]))
        near = task is None or pose is None or math.dist(pose[:2], target) <= _NEAR_TARGET
        others = self._others_ahead(vehicle, target)
        self._tasks.pop(vehicle, None)
        if self._blockages.add(vehicle, near_target=near):
            looked = pose is None or math.dist(pose[:2], target) <= _LOOKED_AT
            if looked and all(math.dist(other, target) > TRAFFIC_DISTANCE for other in others):
                self._blacklist.report(target, final=True)
            else:
                self._blacklist.report(target, vehicle)
        if task is not None and pose is not None:
            ahead = remaining_path(np.array(pose[:2]), task.path)
            x, y = points_at(ahead, arc_lengths(ahead), np.array([_KEEP_OUT_AHEAD]))[0].tolist()
            self._keep_out.add((x, y), now, others)

    def _others_ahead(self, vehicle: str, target: Point) -> list[Point]:
        """Return the positions (m) of the other vehicles that may be in the way of one."""
        others = [self._history.position(n) for n in self._history.poses if n != vehicle]
        task, pose = self._tasks.get(vehicle), self._history.poses.get(vehicle)
        if pose is None:
            return others
        here = np.array(pose[:2])
        towards = np.array(target) - here
        if task is not None:
            ahead = remaining_path(here, task.path)
            towards = points_at(ahead, arc_lengths(ahead), np.array([_KEEP_OUT_AHEAD]))[0] - here
        return [other for other in others if (np.array(other) - here) @ towards > 0.0]

    def plan(
        self,
        grid: Grid,
        now: float,
        vehicles: Mapping[str, VehicleSnapshot],
        mode: PlanningMode | str = PlanningMode.EXPLORE,
        forbidden: NDArray[np.bool_] | None = None,
        looked_at: LookedAt = lambda: None,
    ) -> PlanningResult:
        """Run one planning cycle at a time (s); see PlanningResult.

        forbidden: cells (H, W), occupied in the grid, that no vehicle may enter.
        looked_at: returns the cells (H, W) that depth cameras have looked at, None without any.
        """
        wanted = PlanningMode(mode)
        self._history.update(vehicles)
        self._keep_out.expire(now)
        if wanted is PlanningMode.PAUSED:
            return PlanningResult(ExplorationStatus.PAUSED, 'paused', searched=False)
        if 0 in grid.shape:
            return self._cannot_search('the map is empty')
        moving = self._without_stuck(self._without_discharged(vehicles), now)
        scene = Scene(
            grid,
            now,
            self.config,
            moving,
            self._history.trails,
            self._keep_out.places(),
            forbidden,
            self._search_memory,
            self._map,
        )
        lasting = any(one.battery is not BatteryLevel.CRITICAL for one in vehicles.values())
        if not scene.vehicles and (lasting or not vehicles):
            return self._cannot_search('no vehicle with a valid pose')
        if not scene.starts and lasting:
            return self._cannot_search('no vehicle is on or near a free cell of the map')
        self._searches += 1
        self._blacklist.update(now, grid, scene.costs.free)
        self._ways.update(grid, scene.costs, scene.layer.take_changed())
        if scene.starts:
            self._warn_of_little_reach(scene)
        if wanted is PlanningMode.RETURN_HOME and scene.starts:
            result = self._go_home(scene, (), Orders())
        elif scene.explorers:
            result = self._explore(scene, looked_at)
        else:
            result = self._without_explorers(scene, vehicles)
        for name, one in vehicles.items():
            if one.battery is BatteryLevel.CRITICAL:
                result.waiting[name] = 'has stopped: its battery is nearly empty'
            elif one.active and not moving[name].active:
                result.waiting[name] = 'does not move although it has a plan'
                if name in self._plans:
                    result.plans[name] = self._plans[name]
        self._plans = dict(result.plans)
        return result

    def _warn_of_little_reach(self, scene: Scene) -> None:
        """Update the warning that little of the free area can be reached; log what is new."""
        area, reached = scene.free_area()
        text = ''
        if reached < _LITTLE * area:
            text = (
                f'only {reached:.0f} of {area:.0f} m² of free space can be reached at '
                f'planning_radius {self.config.paths.planning_radius:g} m'
            )
        if text and not self._warned:
            logger.warning('%s', text)
        self._warning, self._warned = text, self._warned or bool(text)

    def _without_discharged(
        self, vehicles: Mapping[str, VehicleSnapshot]
    ) -> dict[str, VehicleSnapshot]:
        """Return the vehicles; those whose battery is critical are obstacles."""
        for name, one in vehicles.items():
            if one.battery is BatteryLevel.CRITICAL:
                self._tasks.pop(name, None)
        return {
            name: one._replace(active=one.active and one.battery is not BatteryLevel.CRITICAL)
            for name, one in vehicles.items()
        }

    def _without_stuck(
        self, vehicles: Mapping[str, VehicleSnapshot], now: float
    ) -> Mapping[str, VehicleSnapshot]:
        """Return the vehicles; those that do not move are obstacles, unless all of them are."""
        arrival = self.config.paths.arrival_distance
        driving = {
            name: name in vehicles and math.dist(plan.goal[:2], vehicles[name].pose[:2]) > arrival
            for name, plan in self._plans.items()
        }
        active = {name: one for name, one in vehicles.items() if one.active}
        stuck = self._standstill.update(now, active, driving)
        if stuck >= active.keys():
            return vehicles
        for name in stuck:
            self._tasks.pop(name, None)
        return {
            name: one._replace(active=False) if name in stuck else one
            for name, one in vehicles.items()
        }

    def _cannot_search(self, reason: str) -> PlanningResult:
        """Withdraw all plans; this is neither an empty search nor the end.

        No vehicle is known to be in a place from which it may drive, so none may follow an older
        plan: each is silent, lost, or where cells became impassable, such as a keep-out area.
        """
        self._tasks, self._retreats = {}, {}
        text = f'cannot search now: {reason}'
        return PlanningResult(ExplorationStatus.PAUSED, text, searched=False)

    def _explore(self, scene: Scene, looked_at: LookedAt) -> PlanningResult:
        """Assign frontiers; without any, look again at what is blocked before exploration ends.

        Before that, cameras look at what they have not seen yet. Vehicles that were sent to a goal
        drive there meanwhile.
        """
        guided = self._guide(scene)
        found = self._search(scene, scene.viewpoints())
        if self._release_shut_in(scene, found):
            found = self._search(scene, scene.viewpoints())
        candidates = self._worthwhile(
            scene, self._open(scene, found, scene.explorers)
        ) or self._squeeze(scene)
        if candidates:
            self._empty_searches = 0
            return self._assign(scene, candidates, guided)
        unviewed = self._unviewed(scene, looked_at)
        if unviewed:
            self._empty_searches = 0
            return self._assign(scene, unviewed, guided, with_camera=True)
        frontiers = tuple(found)
        if self._keep_out.release_temporary():
            # a keep-out zone may close the only way to the rest
            reason = 'no target outside keep-out zones, which are released'
            return self._conclude(scene, ExplorationStatus.IN_PROGRESS, reason, frontiers, guided)
        if not found and self._release_keep_out(scene, scene.explorers):
            reason = 'no target outside permanent keep-out zones; those near by are released'
            return self._conclude(scene, ExplorationStatus.IN_PROGRESS, reason, frontiers, guided)
        return self._finish(scene, guided)

    def _search(self, scene: Scene, viewpoints: NDArray[np.bool_]) -> list[Frontier]:
        """Return the frontiers that are seen from some cells (H, W).

        What lies behind them is estimated for the explorer that sees farthest.
        """
        config, usual = self.config, self.config.frontiers.sensor_range
        ranges = [scene.vehicles[name].body.sensor_range or usual for name in scene.explorers]
        if ranges and max(ranges) != usual:
            config = replace(config, frontiers=replace(config.frontiers, sensor_range=max(ranges)))
        cache = scene.frontier_cache(viewpoints)
        return find_frontiers(scene.grid, config, scene.costs, viewpoints, cache)

    def _unviewed(self, scene: Scene, looked_at: LookedAt) -> list[Frontier]:
        """Return the areas that vehicles with a camera can get to and no camera has looked at."""
        names = [name for name in scene.explorers if scene.vehicles[name].has_camera]
        config = self.config.frontiers
        seen = looked_at() if names and config.min_unviewed_area > 0.0 else None
        if seen is None:
            return []
        reach = np.logical_or.reduce([scene.reach[name] for name in names]) & scene.viewpoints()
        found = find_unviewed(scene.grid, scene.costs, seen, reach, config)
        return self._open(scene, found, names)

    def _open(
        self, scene: Scene, frontiers: list[Frontier], names: Sequence[str]
    ) -> list[Frontier]:
        """Return the frontiers that some vehicle reaches and may try, by name.

        Without any, return those that have not failed for good.
        """
        for fails in (partial(self._blacklist.blocks, now=scene.now), self._blacklist.gave_up):
            left = [
                frontier
                for frontier in frontiers
                if any(
                    scene.reach[name][frontier.target_cell]
                    and not fails(frontier.target, vehicle=name)
                    for name in names
                )
            ]
            if left:
                return left
        return []

    def _worthwhile(self, scene: Scene, frontiers: list[Frontier]) -> list[Frontier]:
        """Return the frontiers that are worth the way of the nearest vehicle."""
        if not frontiers:
            return []
        costs = scene.costs_to(scene.explorers, frontiers).min(axis=0)
        asked = self.config.frontiers.min_gain_per_travel * np.minimum(costs, _LONGEST_TRIP)
        return [f for f, least in zip(frontiers, asked, strict=True) if f.showing >= least]

    def _release_shut_in(self, scene: Scene, frontiers: list[Frontier]) -> bool:
        """Let vehicles that are shut in use tight passages; return whether any gets further.

        A vehicle is shut in if it can reach no frontier, and not even half of what is passable.
        """
        cells = [f.target_cell for f in frontiers if not self._blacklist.gave_up(f.target)]
        shut_in = [
            name
            for name in scene.explorers
            if not any(scene.reach[name][cell] for cell in cells) and scene.is_shut_in(name)
        ]
        released = [scene.allow_tight(name) for name in shut_in]
        return any(released)

    def _squeeze(self, scene: Scene) -> list[Frontier]:
        """Let one vehicle pass through a tight place if a room lies behind it.

        Return the frontiers that are worth it. The same vehicle goes on as long as there are any.
        """
        names = sorted(scene.explorers, key=lambda name: name != self._squeezing)
        for name in names:
            if not scene.allow_tight(name):
                continue
            found = self._search(scene, scene.viewpoints())
            worth = [
                f for f in self._open(scene, found, scene.explorers) if f.gain >= _SQUEEZE_GAIN
            ]
            if worth:
                self._squeezing = name
                return worth
            scene.forbid_tight(name)
        self._squeezing = None
        return []

    def _notable(self, scene: Scene) -> list[Frontier]:
        """Return all frontiers, in reach or not, that would show an area worth reporting."""
        anywhere = np.isfinite(scene.costs.cost)
        every = self._search(scene, anywhere)
        return [one for one in every if min(one.showing, one.gain) >= _NOTABLE_GAIN]

    def _left(self, scene: Scene) -> tuple[list[Frontier], list[Frontier]]:
        """Return the frontiers out of reach, and those that have failed and were not reached."""
        notable = self._notable(scene)
        reach = scene.reachable()
        far = [f for f in notable if not reach[f.target_cell]]
        radius = self.config.blacklist.blacklist_radius
        failed = [
            f
            for f in notable
            if f.showing >= _UNSEEN_ROOM
            and reach[f.target_cell]
            and not self._open(scene, [f], scene.explorers)
            and all(math.dist(f.target, place) > radius for place in self._looked_at)
        ]
        return far, failed

    def _finish(self, scene: Scene, guided: Orders) -> PlanningResult:
        """Look again where ways have become blocked, then end: complete, or say what is left."""
        far, failed = self._left(scene)
        frontiers = (*far, *failed)
        if far:
            looking = self._look_again(scene, far, guided)
            if looking:
                self._empty_searches = 0
                status = ExplorationStatus.IN_PROGRESS
                return self._conclude(scene, status, looking, frontiers, guided)
        self._empty_searches += 1
        if self._empty_searches < self.config.empty_searches:
            status = ExplorationStatus.IN_PROGRESS
            reason = f'no target in search {self._empty_searches} of {self.config.empty_searches}'
            return self._conclude(scene, status, reason, frontiers, guided)
        return self._end(scene, frontiers, guided)

    def _without_explorers(
        self, scene: Scene, vehicles: Mapping[str, VehicleSnapshot]
    ) -> PlanningResult:
        """Send the vehicles home that can still drive; explore no more unless another one may.

        Others may explore later: those that are silent, lost or teleoperated now.
        """
        orders = self._guide(scene)
        frontiers = tuple(self._notable(scene))
        later = [
            name
            for name, one in vehicles.items()
            if one.battery is BatteryLevel.OK and not self._standstill.has_failed(name)
        ]
        if later:
            reason = f'no vehicle can explore now; {", ".join(sorted(later))} may later'
            status = ExplorationStatus.IN_PROGRESS
            return self._conclude(scene, status, reason, frontiers, orders)
        return self._end(scene, frontiers, orders)

    def _end(
        self, scene: Scene, frontiers: tuple[Frontier, ...], guided: Orders
    ) -> PlanningResult:
        """End exploration with some frontiers left, once those that must drive home are there."""
        if self.config.return_to_init:
            return self._go_home(scene, frontiers, guided)
        homeward = [name for name in guided.tasks if name not in scene.explorers]
        if homeward:
            status = ExplorationStatus.IN_PROGRESS
            reason = f'{", ".join(homeward)} on the way home: battery low'
            return self._conclude(scene, status, reason, frontiers, guided)
        status, reason = ExplorationStatus.COMPLETE, 'nothing left to explore'
        if frontiers:
            status = ExplorationStatus.INCOMPLETE
            left = unreached_text(len(frontiers), sum(f.gain for f in frontiers))
            cause = 'out of reach' if scene.explorers else 'and no vehicle with enough battery'
            reason = f'nothing left to explore but {left} {cause}'
        return self._conclude(scene, status, reason, frontiers, guided)

    def _look_again(self, scene: Scene, frontiers: list[Frontier], guided: Orders) -> str:
        """Send a vehicle to where the way to frontiers has become blocked; return the reason.

        It is '' if there is no such way, or it has been looked at for long enough.
        """
        self._second_look.forget_expired(scene.now)
        radius = self.config.paths.planning_radius
        look = None
        for people in (False, True):
            if look is None:
                blocked = self._ways.blocked(scene.costs, radius, scene.forbidden, people=people)
                look = self._second_look.choose(scene, blocked, frontiers)
        if look is None:
            return ''
        name, position = look.vehicle, scene.vehicles[look.vehicle].pose[:2]
        if self._second_look.note(look, scene.now, position):
            self._keep_out.release_around(name, look.blocked)
        if name not in guided.tasks and name not in guided.waiting:
            task = self._task_for(
                scene, name, look.place, look.cell, look.blocked, [], patient=True
            )
            if task is not None:
                guided.tasks[name] = task
        return f'the way to {look.frontiers} frontiers is blocked; {name} looks again'

    def _guide(self, scene: Scene) -> Orders:
        """Plan the paths of the vehicles that were sent to a goal; each faces as its goal says.

        Vehicles whose battery is low are sent home, unless the operator has sent them elsewhere.
        """
        orders = Orders()
        self._send_home(scene, orders)
        sent = {name: scene.vehicles[name].goal for name in scene.starts}
        for name, goal in sent.items():
            if goal is None:
                continue
            standing = [other for other, its in sent.items() if its is None and other != name]
            standing = [other for other in standing if other not in self._tasks]
            cell = scene.nearest_passable(name, goal)
            if cell is None or not (scene.reach[name][cell] or scene.allow_tight(name)):
                orders.refused.append(name)
                orders.waiting[name] = 'its goal cannot be reached'
                continue
            facing = goal.compose(Pose2(_FACING_DISTANCE, 0.0, 0.0))
            target, look_at = (goal.x, goal.y), (facing.x, facing.y)
            task = self._task_for(scene, name, target, cell, look_at, standing)
            if task is None:
                orders.refused.append(name)
                orders.waiting[name] = 'its goal cannot be reached'
            else:
                orders.tasks[name] = task
        return orders

    def _send_home(self, scene: Scene, orders: Orders) -> None:
        """Plan the way home of vehicles whose battery is low."""
        for name in scene.starts:
            one = scene.vehicles[name]
            if one.battery is BatteryLevel.OK or one.goal is not None:
                continue
            if self._is_home(scene, name):
                orders.waiting[name] = 'home: battery low'
                continue
            task = self._task_home(scene, name, [])
            if task is not None:
                orders.tasks[name] = task
                continue
            orders.waiting[name] = 'battery low, and its home cannot be reached'
            self._keep_out.release_around(name, self._history.position(name))

    def _is_home(self, scene: Scene, name: str) -> bool:
        distance = math.dist(self._history.homes[name][:2], scene.vehicles[name].pose[:2])
        return distance <= self.config.paths.arrival_distance

    def _task_home(self, scene: Scene, name: str, standing: list[str]) -> Task | None:
        """Return the task of driving home, None if the home cannot be reached.

        standing: names of vehicles that the path should avoid.
        """
        home = self._history.homes[name]
        goal = scene.nearest_passable(name, home)
        if goal is None or not (scene.reach[name][goal] or scene.allow_tight(name)):
            return None
        return self._task_for(scene, name, (home.x, home.y), goal, None, standing)

    def _release_keep_out(self, scene: Scene, names: Iterable[str]) -> bool:
        """Release the keep-out zones that hold vehicles in; return whether there were any.

        Where a vehicle can still move about, it looks again before zones are released.
        """
        released = [
            self._keep_out.release_around(name, self._history.position(name))
            for name in names
            if scene.reached_area(name) < _TRAPPED_AREA
        ]
        return any(released)

    def _assign(
        self,
        scene: Scene,
        frontiers: list[Frontier],
        guided: Orders,
        *,
        with_camera: bool = False,
    ) -> PlanningResult:
        """Assign frontiers to vehicles by the strategy, and plan the paths.

        with_camera: the frontiers are areas for vehicles with a camera to look at.
        """
        names = tuple(
            name
            for name in scene.explorers
            if scene.vehicles[name].goal is None
            and (scene.vehicles[name].has_camera or not with_camera)
        )
        if self.config.loops.loop_seeking:
            names = self._seek_loops(scene, names, frontiers, guided)
        if not names:
            reason = f'{len(frontiers)} frontiers; all vehicles are on their way to goals'
            status = ExplorationStatus.IN_PROGRESS
            return self._conclude(scene, status, reason, tuple(frontiers), guided)
        costs = scene.costs_to(names, frontiers)
        for name, row in zip(names, costs, strict=True):
            failed = [self._blacklist.gave_up(f.target, name) for f in frontiers]
            row[np.array(failed)] = np.inf
        current = self._current_frontiers(names, frontiers)
        self._clear_blacklist(scene, names, current)
        reachable = np.isfinite(costs).any(axis=1)
        lost = [n for n, ok in zip(names, reachable, strict=True) if not ok]
        self._release_keep_out(scene, lost)
        switches = [
            self._tasks[name].switches if index >= 0 else 0
            for name, index in zip(names, current, strict=True)
        ]
        bodies = tuple(scene.vehicles[name].body for name in names)
        chosen = self._strategy.assign(
            Situation(scene, names, frontiers, costs, current, switches, bodies)
        )
        tasks, waiting = guided.tasks, guided.waiting
        idle = [name for name, index in zip(names, chosen, strict=True) if index < 0]
        for name, index, before, count in zip(names, chosen, current, switches, strict=True):
            if index < 0:
                waiting[name] = 'no target left for this vehicle'
                continue
            frontier = frontiers[index]
            look_at = frontier.look_at or frontier.centroid
            task = self._task_for(
                scene, name, frontier.target, frontier.target_cell, look_at, idle
            )
            if task is None:
                waiting[name] = 'no path to its target'
                continue
            tasks[name] = task
            if before >= 0 and before != index:
                task.switches = count + 1
        status = (
            ExplorationStatus.STARTED if self._searches == 1 else ExplorationStatus.IN_PROGRESS
        )
        what = 'areas that no camera has looked at' if with_camera else 'frontiers'
        reason = f'{len(frontiers)} {what}'
        return self._conclude(scene, status, reason, tuple(frontiers), guided, names, costs)

    def _seek_loops(
        self, scene: Scene, names: tuple[str, ...], frontiers: list[Frontier], orders: Orders
    ) -> tuple[str, ...]:
        """Send vehicles back to known places where that is worth it; return the other ones."""
        current = self._current_frontiers(names, frontiers)
        others = []
        for name, index in zip(names, current, strict=True):
            ahead = frontiers[index] if index >= 0 else None
            found = self._loop_seeking.target(scene, name, ahead, frontiers)
            task = None if found is None else self._task_for(scene, name, *found, None, [])
            if task is None:
                others.append(name)
            else:
                orders.tasks[name] = task
        return tuple(others)

    def _current_frontiers(self, names: tuple[str, ...], frontiers: list[Frontier]) -> list[int]:
        """Return for each vehicle the frontier that continues its present target, or -1."""
        targets = np.array([frontier.target for frontier in frontiers])
        current = []
        for name in names:
            task = self._tasks.get(name)
            index = -1
            if task is not None:
                distances = np.linalg.norm(targets - np.array(task.target), axis=1)
                nearest = int(np.argmin(distances))
                if distances[nearest] <= _SAME_FRONTIER:
                    index = nearest
            current.append(index)
        return current

    def _clear_blacklist(self, scene: Scene, names: tuple[str, ...], current: list[int]) -> None:
        """Forget failures where a vehicle has reached its target and left nothing to be seen."""
        for name, index in zip(names, current, strict=True):
            task = self._tasks.get(name)
            if task is not None and index < 0:
                self._blockages.reset(name)
                near = math.dist(scene.vehicles[name].pose[:2], task.target) <= _NEAR_TARGET
                if near and not self._blacklist.blocks(task.target, scene.now):
                    self._blacklist.clear(task.target)

    def _task_for(
        self,
        scene: Scene,
        name: str,
        target: Point,
        cell: Cell,
        look_at: Point | None,
        standing: list[str],
        *,
        patient: bool = False,
    ) -> Task | None:
        """Return a task that leads a vehicle to a target, or None if there is no path.

        The present task continues while its path is free and the vehicle makes progress.
        standing: names of vehicles that paths should avoid. patient: see Task.
        """
        task = self._tasks.get(name)
        if task is not None and (not task.leads_to(target) or task.patient is not patient):
            task = None
        if task is not None and self._continues(scene, name, task, target):
            return task
        obstacles = [other for other in standing if other != name]
        path = scene.path(name, cell, obstacles)
        if path is None:
            return None
        if task is not None:
            return task.along(path, target, look_at)
        return Task(target, path, look_at, Progress(scene.now), patient=patient)

    def _continues(self, scene: Scene, name: str, task: Task, target: Point) -> bool:
        """Record the progress of a task, report its failure; return whether its path is valid."""
        position = scene.vehicles[name].pose[:2]
        ahead = remaining_path(np.array(position), task.path)
        arrived = math.dist(position, task.target) <= self.config.paths.arrival_distance
        if task.patient:
            return task.right is RightOfWay.GO and scene.is_passable(name, ahead)
        task.progress.update(
            float(arc_lengths(ahead)[-1]),
            scene.now,
            arrived=arrived,
            waiting=task.right is not RightOfWay.GO,
        )
        late = scene.now - task.progress.since > self.config.blacklist.progress_timeout
        if task.progress.exhausted:
            self._blacklist.report(target, final=True)
            self._looked_at.append(target)
            return False
        if late:
            self._blacklist.report(target, name)
            return False
        return task.right is RightOfWay.GO and not arrived and scene.is_passable(name, ahead)

    def _conclude(
        self,
        scene: Scene,
        status: ExplorationStatus,
        reason: str,
        frontiers: tuple[Frontier, ...],
        orders: Orders,
        explorers: tuple[str, ...] | None = None,
        costs: Array | None = None,
    ) -> PlanningResult:
        """Grant rights of way, and turn tasks into plans.

        costs (V, F): of the explorers to the frontiers; by default none was computed.
        """
        tasks, waiting = orders.tasks, orders.waiting
        travelers = {}
        for name in scene.starts:
            pose = scene.vehicles[name].pose
            position = np.array([pose.x, pose.y])
            task = tasks.get(name)
            path = None if task is None else remaining_path(position, task.path)
            one = scene.vehicles[name]
            urgent = one.goal is not None or one.battery is not BatteryLevel.OK
            travelers[name] = Traveler(name, position, path, one.body, urgent)
        plans: dict[str, Plan] = {}
        retreats: dict[str, Plan] = {}
        for name, grant in self._traffic.grant(travelers, scene).items():
            before = self._retreats.get(name)
            plan = plan_for(scene, tasks.get(name), grant, travelers[name], before)
            if plan is not None:
                plans[name] = plan
                if grant.right is RightOfWay.RETREAT:
                    retreats[name] = plan
            elif grant.right is not RightOfWay.GO:
                waiting[name] = f'gives way to {grant.yields_to}'
        self._tasks, self._retreats = tasks, retreats
        names = tuple(scene.starts) if explorers is None else explorers
        matrix = np.empty((len(names), 0)) if costs is None else costs
        left = frontiers if costs is None else ()
        return PlanningResult(
            status,
            reason,
            plans,
            waiting,
            frontiers,
            names,
            matrix,
            unreachable=len(left),
            refused=tuple(orders.refused),
            unreached_m2=sum(frontier.gain for frontier in left),
            warning=self._warning,
        )

    def _go_home(
        self, scene: Scene, frontiers: tuple[Frontier, ...], orders: Orders
    ) -> PlanningResult:
        """Send every vehicle to its home, but for those that are on their way to goals."""
        tasks, waiting = orders.tasks, orders.waiting
        guided = {*tasks, *waiting}
        for name in scene.starts:
            if name not in guided and self._is_home(scene, name):
                waiting[name] = 'home'
        arrived = list(waiting)
        for name in scene.starts:
            if name in arrived or name in guided:
                continue
            task = self._task_home(scene, name, arrived)
            if task is None:
                waiting[name] = 'its home cannot be reached'
            else:
                tasks[name] = task
        status = ExplorationStatus.RETURNING if tasks else ExplorationStatus.RETURNED
        reason = 'on the way home' if tasks else 'home'
        return self._conclude(scene, status, reason, frontiers, orders)
