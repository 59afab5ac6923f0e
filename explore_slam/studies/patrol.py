"""Patrol of a mapped world: vehicles drive to random waypoints without end."""

import math

import numpy as np

from explore_slam.agent import Agent
from explore_slam.data import FollowerReport, FollowerState
from explore_slam.errors import EvaluationError
from explore_slam.exploration import (
    ExplorationStatus,
    Planner,
    PlanningMode,
    PlanningResult,
    VehicleSnapshot,
)
from explore_slam.geometry import Array, Pose2

# A waypoint counts as reached within this distance (m), a vehicle's length.
WAYPOINT_TOLERANCE = 0.6
# New waypoints are at least this far away (m), in small worlds half as far as the farthest, so
# that a patrol covers the whole world.
LEG_LENGTH = 3.0
# A vehicle that is not closer to its waypoint after this time (s) gets another one.
LEG_TIMEOUT = 120.0


class _Leg:
    """The current waypoint of a vehicle, and the time (s) at which it was drawn."""

    def __init__(self, waypoint: Pose2, since: float) -> None:
        self.waypoint = waypoint
        self.since = since


class Patrol:
    """Plans paths to random waypoints, with the planner's mode to return home.

    It has the interface of TeamPlanner, which it replaces once exploration is complete. Every
    waypoint in turn is the home of its vehicle, so that paths and right of way are those of the
    planner. reached: number of waypoints reached so far.
    """

    def __init__(self, agent: Agent, waypoints: Array, seed: int) -> None:
        if len(waypoints) == 0:
            raise EvaluationError('patrol: no waypoints, expected at least one')
        self._agent = agent
        self._waypoints = waypoints
        self._rng = np.random.default_rng(seed)
        self._planner = Planner(agent.config.exploration)
        self._legs: dict[str, _Leg] = {}
        self._blocked: set[str] = set()
        self.reached = 0
        self.result = PlanningResult(ExplorationStatus.RETURNING, 'patrol begins')

    def report_follower(self, vehicle: str, report: FollowerReport, now: float) -> None:
        """Take the report of a path follower; a blocked vehicle gets another waypoint."""
        del now
        if report.state is FollowerState.BLOCKED:
            self._blocked.add(vehicle)

    def plan(self, now: float) -> PlanningResult:
        """Plan the paths of all vehicles at a time (s)."""
        poses = {name: self._agent.map_pose(name) for name in self._agent.vehicles}
        changed = [name for name, pose in poses.items() if self._needs_waypoint(name, pose, now)]
        if changed:
            for name in changed:
                self._legs[name] = _Leg(self._draw(poses[name]), now)
            # The planner keeps the homes that it saw first.
            self._planner = Planner(self._agent.config.exploration)
        self._blocked.clear()
        vehicles = {
            name: VehicleSnapshot(pose, True, self._legs[name].waypoint)
            for name, pose in poses.items()
        }
        self.result = self._planner.plan(self._agent.grid, now, vehicles, PlanningMode.RETURN_HOME)
        return self.result

    def _needs_waypoint(self, name: str, pose: Pose2, now: float) -> bool:
        leg = self._legs.get(name)
        if leg is None:
            return True
        if math.dist(pose[:2], leg.waypoint[:2]) <= WAYPOINT_TOLERANCE:
            self.reached += 1
            return True
        without_path = self.result.searched and name not in self.result.plans
        return name in self._blocked or without_path or now - leg.since > LEG_TIMEOUT

    def _draw(self, pose: Pose2) -> Pose2:
        """Return a random waypoint away from the pose."""
        distance = np.hypot(*(self._waypoints - pose[:2]).T)
        away = distance >= min(LEG_LENGTH, 0.5 * float(distance.max()))
        candidates = self._waypoints[away]
        x, y = candidates[self._rng.integers(len(candidates))].tolist()
        return Pose2(x, y, 0.0)
