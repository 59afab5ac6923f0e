"""How the team of an exploration study knows where it is, maps and plans.

KnownPoses: the grid map and the planner of the agent alone; poses are known up to a correlated
error, so that a study measures planning. TeamSlam: the whole agent, with wheel odometry and scans
as on real vehicles, which follow their plans by the poses that it estimates.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Protocol

import numpy as np

from explore_slam.agent import Agent, AgentConfig, TeamPlanner
from explore_slam.data import FollowerReport, FollowerState, OdometryReading, Plan, VehicleBody
from explore_slam.exploration import (
    ExplorationConfig,
    Planner,
    PlanningMode,
    PlanningResult,
    VehicleSnapshot,
)
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.mapping import GridConfig, OccupancyGrid
from explore_slam.results.trajectory import Trajectory, pairs, position_errors
from explore_slam.simulation.config import SimulatedOdometryConfig
from explore_slam.simulation.grid.grid_simulator import GridSimulator
from explore_slam.simulation.wheel_odometry import WheelOdometry

SILENT = 3.0  # s without anything from a vehicle, after which it gets no target; as silent_timeout


class TeamMapping(Protocol):
    """Localization, map and planner of a team in the grid simulator."""

    @property
    def grid(self) -> OccupancyGrid:
        """The map."""

    def move(self) -> None:
        """Take what the vehicles measure of their motion in a time step that has ended."""

    def scan(self) -> None:
        """Take a scan of every vehicle that is not silent."""

    def report_blocked(self, vehicle: str, plan: Plan) -> None:
        """Report that a vehicle makes no progress on its plan."""

    def plan(self) -> PlanningResult:
        """Run one planning cycle."""

    def map_rms(self) -> float | None:
        """Return the RMS position error (m) of the scans in the map; None if poses are known."""


class KnownPoses:
    """Scans enter the map, and vehicles are planned for, at the poses that the simulator tells."""

    def __init__(
        self,
        simulator: GridSimulator,
        mapping: GridConfig,
        exploration: ExplorationConfig,
        bodies: Mapping[str, VehicleBody],
    ) -> None:
        self.grid = OccupancyGrid(mapping)
        self._simulator = simulator
        self._planner = Planner(exploration)
        self._bodies = bodies
        self._homes = {vehicle: simulator.known_pose(vehicle) for vehicle in simulator.vehicles}
        self._poses: dict[str, Pose2] = {}  # last ones that arrived
        self._heard: dict[str, float] = {}  # times (s) of them

    def move(self) -> None:
        """Do nothing: the simulator knows the poses."""

    def scan(self) -> None:
        """Insert a scan of every vehicle into the map, at the known pose."""
        simulator = self._simulator
        poses = {vehicle: simulator.known_pose(vehicle) for vehicle in simulator.vehicles}
        for vehicle, pose in poses.items():
            if simulator.is_silent(vehicle):
                continue
            bodies = [
                (p.x, p.y, simulator.config_of(other).disc_radius)
                for other, p in poses.items()
                if other != vehicle
            ]
            self.grid.insert_scan(pose, simulator.scan(vehicle), np.reshape(bodies, (-1, 3)))

    def report_blocked(self, vehicle: str, plan: Plan) -> None:
        """See TeamMapping."""
        self._planner.report_blocked(vehicle, plan.goal, self._simulator.time)

    def plan(self) -> PlanningResult:
        """Plan from the known poses; a vehicle that is silent is where it was heard last."""
        simulator, now = self._simulator, self._simulator.time
        for vehicle in simulator.vehicles:
            if not simulator.is_silent(vehicle):
                self._poses[vehicle], self._heard[vehicle] = simulator.known_pose(vehicle), now
        snapshots = {
            vehicle: VehicleSnapshot(
                pose,
                now - self._heard[vehicle] <= SILENT,
                self._homes[vehicle],
                self._bodies[vehicle],
            )
            for vehicle, pose in self._poses.items()
        }
        return self._planner.plan(self.grid, now, snapshots, PlanningMode.EXPLORE)

    def map_rms(self) -> None:
        """See TeamMapping."""


class TeamSlam:
    """The agent as on real vehicles; the start poses are known.

    Odometry is measured in every time step and read at its rate. The laser is at the vehicle
    origin, as the grid simulator casts its beams.
    """

    def __init__(
        self,
        simulator: GridSimulator,
        config: AgentConfig,
        odometry: SimulatedOdometryConfig,
        bodies: Mapping[str, VehicleBody],
        seed: int,
    ) -> None:
        self._simulator = simulator
        self._last = {vehicle: simulator.true_pose(vehicle) for vehicle in simulator.vehicles}
        self.agent = Agent(config, dict(self._last), seed, bodies=bodies)
        self._planner = TeamPlanner(self.agent)
        # a stream of random numbers for each vehicle, and none of those that the simulator draws
        streams = np.random.SeedSequence([seed, len(self._last)]).spawn(len(self._last))
        self._wheels = {
            vehicle: WheelOdometry(odometry, np.random.default_rng(stream))
            for vehicle, stream in zip(self._last, streams, strict=True)
        }
        self._period = 1.0 / odometry.simulated_odometry_rate
        self._next_reading = 0.0
        self._truth: dict[str, list[tuple[float, Pose2]]] = {name: [] for name in self._last}
        self.move()

    @property
    def grid(self) -> OccupancyGrid:
        """The map, drawn along the most likely path."""
        return self.agent.grid

    def move(self) -> None:
        """Measure the motion since the last call; where a reading is due, the agent takes it.

        The vehicles then know the poses that the agent has for them.
        """
        simulator, now = self._simulator, self._simulator.time
        for vehicle, wheels in self._wheels.items():
            pose = simulator.true_pose(vehicle)
            wheels.move(self._last[vehicle].between(pose))
            self._last[vehicle] = pose
            self._truth[vehicle].append((now, pose))
        if now < self._next_reading - 1e-9:
            return
        # at most one reading per step, however high the rate
        self._next_reading = max(self._next_reading + self._period, now)
        for vehicle, wheels in self._wheels.items():
            if not simulator.is_silent(vehicle):
                self.agent.add(vehicle, OdometryReading(now, wheels.pose, wheels.covariance))
                simulator.set_known_pose(vehicle, self.agent.map_pose(vehicle))

    def scan(self) -> None:
        """Pass a scan of every vehicle to the agent."""
        for vehicle in self._simulator.vehicles:
            if not self._simulator.is_silent(vehicle):
                scan = replace(self._simulator.scan(vehicle), mount=IDENTITY)
                self.agent.add(vehicle, scan)
                self._simulator.set_known_pose(vehicle, self.agent.map_pose(vehicle))

    def report_blocked(self, vehicle: str, plan: Plan) -> None:
        """Report it as a path follower does."""
        reason = f'no progress towards ({plan.goal.x:.2f}, {plan.goal.y:.2f})'
        report = FollowerReport(FollowerState.BLOCKED, reason)
        self._planner.report_follower(vehicle, report, self._simulator.time)

    def plan(self) -> PlanningResult:
        """Plan as the agent does, from what it has received until now."""
        now = self._simulator.time
        self.agent.advance(now)
        result = self._planner.plan(now)
        for vehicle in self._simulator.vehicles:
            state = FollowerState.DRIVING if vehicle in result.plans else FollowerState.WAITING
            if not self._simulator.is_silent(vehicle):
                self._planner.report_follower(vehicle, FollowerReport(state), now)
        return result

    def map_rms(self) -> float | None:
        """See TeamMapping: of all vehicles, in the frame of the known start poses.

        None before the first scan is in the map.
        """
        agent = self.agent
        path = agent.belief.best_path()
        agent.laser_map.redraw(path, agent.belief.keyframes_in_map())
        drawn = agent.laser_map.path
        squares: list[float] = []
        for vehicle, truth in self._truth.items():
            placed = [
                (one.scan.stamp, Pose2(*drawn[one.keyframe]).compose(one.laser_in_keyframe))
                for one in agent.laser_map.scans
                if one.vehicle == vehicle
            ]
            if placed:
                _, poses, true = pairs(_trajectory(placed), _trajectory(truth))
                squares.extend(np.square(position_errors(poses, true)))
        return math.sqrt(float(np.mean(squares))) if squares else None


def _trajectory(samples: list[tuple[float, Pose2]]) -> Trajectory:
    return Trajectory.of([stamp for stamp, _ in samples], [pose for _, pose in samples])
