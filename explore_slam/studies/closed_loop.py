"""Exploration in one process, without ROS: simulator, path followers and agent in lock step.

The same seed gives the same run, bit for bit. The live demo runs the same components over topics.
"""

import math
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol

import numpy as np

from explore_slam.agent import Agent, AgentConfig, TeamPlanner
from explore_slam.data import (
    FollowerReport,
    LandmarkObservations,
    LaserScan,
    ObstacleView,
    OdometryReading,
    Plan,
    RgbdFrame,
    TagObservations,
    VehicleBody,
)
from explore_slam.errors import EvaluationError
from explore_slam.exploration import ExplorationStatus, PlanningResult
from explore_slam.geometry import Pose2
from explore_slam.results.reachable_area import ReachableArea
from explore_slam.results.run_data import RunData, RunRecorder
from explore_slam.settings import Section, section, setting, with_values
from explore_slam.simulation import SimulationConfig, Simulator, load_world
from explore_slam.simulation.records import TruePose
from explore_slam.vehicle import PathFollower, PathFollowerConfig
from explore_slam.vision import FeatureExtractor, KeyframeSelector
from explore_slam.vision.obstacles import ObstacleDetector

_NO_WAYPOINTS = np.empty((0, 2))
FIRST_PLANNING = 1.0  # s; by then every vehicle has delivered scans and frames


class TeamGuide(Protocol):
    """Interface of planners in a closed loop (TeamPlanner, Patrol)."""

    result: PlanningResult

    def report_follower(self, vehicle: str, report: FollowerReport, now: float) -> None:
        """Take the report of a path follower at a time (s)."""

    def plan(self, now: float) -> PlanningResult:
        """Run one planning cycle at a time (s)."""


@dataclass(frozen=True)
class ClosedLoopConfig(Section):
    """Configuration of a closed-loop run."""

    planning_period: float = setting(
        2.0, 'time between planning cycles', unit='s', low=0.1, high=60.0
    )
    time_limit: float = setting(
        1200.0,
        'simulated time after which a run ends',
        unit='s',
        low=1.0,
        high=1e5,
        tier='basic',
    )
    use_laser: bool = setting(
        True, 'whether the vehicles have a laser; without, their cameras map and explore alone'
    )
    agent: AgentConfig = section(AgentConfig)
    simulation: SimulationConfig = section(SimulationConfig)


@dataclass
class ClosedLoop:
    """A closed-loop run; `step` advances the simulator by one tick, `run` continues to the end.

    vision: extract features in the agent or on the vehicle.
    update_seconds: wall time (s) of each call of the agent that updated landmarks since the last
    `discard_records`, with extraction where that takes place in the agent.
    """

    world_path: Path
    config: ClosedLoopConfig = field(default_factory=ClosedLoopConfig)
    vehicles: int = 2
    seed: int = 0
    follower: PathFollowerConfig = field(default_factory=PathFollowerConfig)
    vision: Literal['agent', 'vehicle'] = 'agent'

    def __post_init__(self) -> None:
        world = load_world(self.world_path)
        if not 1 <= self.vehicles <= len(world.starts):
            raise EvaluationError(
                f'{self.world_path}: {self.vehicles} vehicles, expected 1 to {len(world.starts)} '
                '(start poses of the world)'
            )
        starts: dict[str, Pose2] = dict(list(world.starts.items())[: self.vehicles])
        simulation, bodies, laser = self.config.simulation, {}, self.config.use_laser
        if not laser:
            simulation = with_values(simulation, {'simulated_scan_rate': 0.0})
            view = VehicleBody(
                sensor_range=self.config.agent.vision.obstacles.obstacle_range,
                field_of_view=math.radians(simulation.kinect.simulated_camera_angle),
            )
            bodies = dict.fromkeys(starts, view)
        self.simulator = Simulator(world, starts, simulation, self.seed)
        seeing = () if laser else tuple(starts)
        self.agent = Agent(
            self.config.agent, starts, self.seed, bodies=bodies, camera_scans=seeing
        )
        self.planner: TeamGuide = TeamPlanner(self.agent)
        self.followers = {name: PathFollower(self.follower, name, laser) for name in starts}
        self._title = f'{world.name}, seed {self.seed}'
        self._selectors = {name: KeyframeSelector(self.config.agent.vision) for name in starts}
        self._extractor = FeatureExtractor(self.config.agent.vision)
        self._detectors = {
            name: ObstacleDetector(self.config.agent.vision, vehicle=name) for name in starts
        }
        self._odometry: dict[str, Pose2] = {}
        self.discard_records()
        radius = self.config.agent.exploration.paths.planning_radius
        self.area = ReachableArea.of_file(self.world_path, starts.values(), radius)
        self.coverage = 0.0
        self._next_plan = FIRST_PLANNING
        self._sent: dict[str, Plan | None] = {}

    def discard_records(self) -> None:
        """Forget what has been recorded until now; the agent is not affected."""
        self.recorder = RunRecorder(
            self._title, self.agent.start_poses, self.config.agent.slam.particles
        )
        self.update_seconds: list[float] = []

    @property
    def ended(self) -> bool:
        """Whether exploration is complete or the time limit is reached."""
        status = self.planner.result.status
        ended = status.explored or status is ExplorationStatus.RETURNED
        return ended or self.simulator.time >= self.config.time_limit

    def step(self) -> PlanningResult | None:
        """Advance by one tick; return the result of planning in a tick that plans."""
        for event in self.simulator.step():
            self._process(event.vehicle, event.record)
        now = self.simulator.time
        for name, follower in self.followers.items():
            command = follower.command(now)
            self.simulator.set_velocity(name, command.linear, command.angular)
            self.planner.report_follower(name, FollowerReport(command.state, command.reason), now)
        if now < self._next_plan:
            return None
        self._next_plan = now + self.config.planning_period
        return self._plan(now)

    def run(self) -> RunData:
        """Explore until `ended`; return the data of the run."""
        while not self.ended:
            self.step()
        self.simulator.close()
        calibrations = self.agent.odometry_calibrations()
        return self.recorder.finish(
            {name: self.agent.trajectory(name) for name in self.agent.vehicles},
            calibrations=calibrations,
            grid=self.agent.grid,
            landmarks=self.agent.landmarks(),
            settings=self.config,
            extra={
                'duration': self.simulator.time,
                'collisions': self.simulator.collisions,
                'status': self.planner.result.status.value,
                'unreached_frontiers': self.planner.result.unreachable,
                'unreached_m2': self.planner.result.unreached_m2,
                'counts': self.agent.summary(),
                'odometry_calibration': {
                    name: found._asdict() for name, found in calibrations.items()
                },
            },
        )

    def _process(
        self, name: str, record: OdometryReading | LaserScan | RgbdFrame | TruePose
    ) -> None:
        follower = self.followers[name]
        if isinstance(record, TruePose):
            self.recorder.add_truth(name, record.stamp, record.pose)
            return
        if isinstance(record, RgbdFrame) and self.vision == 'vehicle':
            self._add_features(name, record)
        else:
            self._add(name, record)
        if isinstance(record, OdometryReading):
            self._odometry[name] = record.pose
            self.recorder.add_odometry(name, record)
            follower.set_odometry(record)
            follower.set_pose(record.stamp, self.agent.map_pose(name))
            for view in self.agent.take_views(name):
                follower.set_obstacles(view)
        elif isinstance(record, LaserScan):
            follower.set_scan(record)

    def _add_features(self, name: str, frame: RgbdFrame) -> None:
        """Extract features of a keyframe, and obstacles, as the vehicle does, and add them."""
        pose = self._odometry.get(name)
        if pose is not None and self._selectors[name].select(frame.stamp, pose):
            self._add(name, self._extractor.extract(frame))
            tags = self._extractor.observe_tags(frame)
            if tags is not None:
                self._add(name, tags)
        if self.config.agent.vision.obstacles.depth_obstacles:
            self._add(name, self._detectors[name].detect(frame))

    def _add(
        self,
        name: str,
        record: OdometryReading
        | LaserScan
        | RgbdFrame
        | LandmarkObservations
        | TagObservations
        | ObstacleView,
    ) -> None:
        """Add a record to the agent, and record the keyframes that result."""
        began = time.perf_counter()
        self.agent.add(name, record)
        seconds = time.perf_counter() - began
        events = self.agent.take_events()
        for event in events:
            self.recorder.add_pose(event.vehicle, event.stamp, event.pose)
            self.recorder.add_keyframe(event)
        if any(event.update is not None for event in events):
            self.update_seconds.append(seconds)

    def _plan(self, now: float) -> PlanningResult:
        result = self.planner.plan(now)
        for name, follower in self.followers.items():
            plan = result.plans.get(name)
            if plan is not None and plan is not self._sent.get(name):
                follower.set_plan(plan)
            elif plan is None and self._sent.get(name) is not None:
                follower.set_plan(Plan(now, name, Pose2(0.0, 0.0, 0.0), _NO_WAYPOINTS))
            self._sent[name] = plan
        grid = self.agent.laser_map.grid
        self.coverage = self.area.explored_fraction(grid.known(), grid.resolution, grid.origin)
        self.recorder.add_coverage(now, self.coverage)
        return result
