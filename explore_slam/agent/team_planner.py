"""Planning for the agent's team: feeds the planner, and carries out the operator's requests."""

import logging
import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

from explore_slam.agent.agent import Agent
from explore_slam.agent.operator_areas import OperatorAreas
from explore_slam.agent.vehicle_track import VehicleTrack
from explore_slam.battery import BatteryConfig, BatteryMonitor
from explore_slam.data import (
    BatteryLevel,
    BatteryReading,
    FollowerReport,
    FollowerState,
    VehicleState,
    VehicleStatus,
)
from explore_slam.errors import AgentError
from explore_slam.exploration import (
    ExplorationConfig,
    ExplorationStatus,
    KnownPlace,
    Planner,
    PlanningMode,
    PlanningResult,
    VehicleSnapshot,
)
from explore_slam.geometry import Pose2

logger = logging.getLogger(__name__)


class TeamPlanner:
    """Plans for the vehicles of an agent; explores unless paused or called home.

    mode: what the operator asked for.
    areas: where the operator wants no vehicle to be.
    result: of the last planning cycle.
    batteries: of all vehicles, by name.
    """

    def __init__(self, agent: Agent, batteries: Mapping[str, BatteryConfig] | None = None) -> None:
        """Create it; batteries: settings by vehicle, where they differ from the defaults."""
        self._agent = agent
        given = batteries or {}
        self.batteries = {
            name: BatteryMonitor(given.get(name, BatteryConfig())) for name in agent.vehicles
        }
        self._planner = Planner(agent.config.exploration)
        self._searched = False
        self._goals: dict[str, Pose2] = {}
        self.areas = OperatorAreas()
        self.mode = PlanningMode.EXPLORE
        self.result = PlanningResult(ExplorationStatus.STARTED, 'nothing searched yet')

    def configure(self, config: ExplorationConfig) -> None:
        """Replace the settings; if they differ, targets and blacklist are forgotten."""
        if config != self._planner.config:
            self._planner = Planner(config)

    def pause(self, paused: bool) -> None:
        """Stop all vehicles, or explore again; that confirms where the vehicles stand."""
        self.mode = PlanningMode.PAUSED if paused else PlanningMode.EXPLORE
        if not paused:
            for track in self._agent.tracks.values():
                track.placement.confirm()

    def return_home(self) -> None:
        """Send every vehicle to its start pose."""
        self.mode = PlanningMode.RETURN_HOME

    def set_goal(self, vehicle: str, goal: Pose2) -> None:
        """Send one vehicle to a goal (m, rad) first; it then resumes exploring.

        A vehicle whose battery is low then drives home. AgentError for an unknown vehicle, for one
        whose battery is critical, and for a goal that no vehicle may enter.
        """
        self._agent.track(vehicle)
        if self.batteries[vehicle].level is BatteryLevel.CRITICAL:
            raise AgentError(
                f'{vehicle} cannot be sent anywhere: {self.batteries[vehicle].warning}'
            )
        grid = self._agent.grid
        bounds = self.areas.out_of_bounds(grid)
        (cell,) = grid.to_cell([goal[:2]])
        within = bool(grid.contains([cell])[0])
        if bounds is not None and within and bounds[tuple(cell)]:
            raise AgentError(
                f'goal ({goal.x:.2f}, {goal.y:.2f}) of {vehicle} lies in a keep-out area or '
                'outside of the area to explore'
            )
        self._goals[vehicle] = goal

    def reset(self) -> None:
        """Forget targets, goals, blacklist and mode; the operator's areas remain."""
        self._planner = Planner(self._agent.config.exploration)
        self._goals = {}
        self._searched = False
        self.mode = PlanningMode.EXPLORE
        for track in self._agent.tracks.values():
            track.plan = None

    def report_follower(self, vehicle: str, report: FollowerReport, now: float) -> None:
        """Take the report of a path follower at a time (s)."""
        track = self._agent.track(vehicle)
        newly = report.state is FollowerState.BLOCKED and not _is_blocked(track)
        if newly and track.plan is not None:
            self._planner.report_blocked(vehicle, track.plan.goal, now)
        track.follower = report

    def report_battery(self, vehicle: str, reading: BatteryReading, now: float) -> bool:
        """Take a reading of a battery at a time (s); return whether that changes the plans.

        When the battery becomes low, the goal of the operator is given up as well: one that is set
        afterwards holds.
        """
        self._agent.track(vehicle)
        monitor = self.batteries[vehicle]
        if not monitor.add(reading, now):
            return False
        if monitor.level is BatteryLevel.OK:
            logger.info('%s: the battery is charged again; it resumes exploring', vehicle)
            return True
        low = monitor.level is BatteryLevel.LOW
        given_up = '; the goal of the operator is given up' if vehicle in self._goals else ''
        logger.warning(
            '%s: %s; %s%s', vehicle, monitor.warning, 'it drives home' if low else 'it stops',
            given_up,
        )  # fmt: skip
        self._goals.pop(vehicle, None)
        return True

    @property
    def must_withdraw(self) -> bool:
        """Whether a vehicle has a plan, but its pose is in doubt: the next cycle is urgent."""
        return any(
            track.plan is not None and not track.placement.is_reliable
            for track in self._agent.tracks.values()
        )

    def plan(self, now: float) -> PlanningResult:
        """Run one planning cycle at a time (s) and store plan and state in the agent's tracks."""
        vehicles = {
            status.vehicle: self._snapshot(status)
            for status in self._agent.statuses()
            if self._agent.is_in_map(status.vehicle)
        }
        in_doubt = any(track.placement.doubt for track in self._agent.tracks.values())
        mode = PlanningMode.PAUSED if in_doubt else self.mode
        grid = self._agent.grid
        forbidden = self.areas.out_of_bounds(grid)
        if mode is PlanningMode.EXPLORE:
            self._end_reached_goals(vehicles)
            vehicles = {
                name: known._replace(goal=self._goals.get(name))
                for name, known in vehicles.items()
            }
        looked_at = partial(self._agent.looked_at, grid)
        result = self._planner.plan(
            self.areas.view(grid), now, vehicles, mode, forbidden, looked_at
        )
        for name in result.refused:
            logger.warning('%s: the goal of the operator cannot be reached', name)
            del self._goals[name]
        if not result.searched and not self._searched and mode is not PlanningMode.PAUSED:
            # without a map the exploration has not begun, which is not a pause
            result = replace(result, status=ExplorationStatus.STARTED)
        self._searched |= result.searched
        for name, track in self._agent.tracks.items():
            track.plan = result.plans.get(name)
            track.state = self._state(name, result)
        self.result = result
        return result

    def _end_reached_goals(self, vehicles: dict[str, VehicleSnapshot]) -> None:
        """Let the vehicles that have reached the goal of the operator explore on."""
        arrival = self._agent.config.exploration.paths.arrival_distance
        for name, goal in list(self._goals.items()):
            known = vehicles.get(name)
            if known is not None and math.dist(known.pose[:2], goal[:2]) <= arrival:
                logger.info('%s has reached the goal of the operator; it resumes exploring', name)
                del self._goals[name]

    def _snapshot(self, status: VehicleStatus) -> VehicleSnapshot:
        vehicle = status.vehicle
        active = status.state not in (VehicleState.SILENT, VehicleState.LOST)
        # the others take over what it was on its way to; its scans are mapped all the same
        active = active and not _is_teleoperated(self._agent.track(vehicle))
        return VehicleSnapshot(
            self._agent.map_pose(vehicle),
            active,
            self._agent.home(vehicle),
            self._agent.track(vehicle).body,
            battery=self.batteries[vehicle].level,
            known_places=self._known_places(vehicle),
            has_camera=self._agent.track(vehicle).has_camera,
        )

    def _known_places(self, vehicle: str) -> tuple[KnownPlace, ...]:
        """Return where a vehicle may close a loop, if it is to look for that."""
        loops = self._agent.config.exploration.loops
        if not loops.loop_seeking:
            return ()
        return self._agent.known_places(vehicle, loops.loop_reach)

    def _state(self, vehicle: str, result: PlanningResult) -> VehicleState:
        track, battery = self._agent.track(vehicle), self.batteries[vehicle].level
        if battery is BatteryLevel.CRITICAL:
            return VehicleState.BATTERY_CRITICAL
        if _is_blocked(track):
            return VehicleState.BLOCKED
        if _is_teleoperated(track):
            return VehicleState.TELEOPERATED
        low = battery is BatteryLevel.LOW
        if vehicle in result.plans:
            returning = result.status is ExplorationStatus.RETURNING
            returning |= low and vehicle not in self._goals
            return VehicleState.RETURNING if returning else VehicleState.DRIVING
        if low and self._is_home(vehicle):
            return VehicleState.HOME
        return {
            ExplorationStatus.COMPLETE: VehicleState.DONE,
            ExplorationStatus.INCOMPLETE: VehicleState.DONE,
            ExplorationStatus.RETURNED: VehicleState.HOME,
        }.get(result.status, VehicleState.WAITING)

    def _is_home(self, vehicle: str) -> bool:
        arrival = self._agent.config.exploration.paths.arrival_distance
        home, pose = self._agent.home(vehicle), self._agent.map_pose(vehicle)
        return home is not None and math.dist(home[:2], pose[:2]) <= arrival


def _is_teleoperated(track: VehicleTrack) -> bool:
    return track.follower is not None and track.follower.state is FollowerState.TELEOPERATED


def _is_blocked(track: VehicleTrack) -> bool:
    return track.follower is not None and track.follower.state is FollowerState.BLOCKED
