"""Paths of the simulated Kinect: drive from stop to stop and record one frame at each.

Images are rendered once. Seeds differ in the odometry noise, which is added afterwards, as the
paper ran its filter over recorded images "in a simulated manner".
"""

import logging
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from explore_slam.data import LandmarkObservations, RgbdFrame
from explore_slam.errors import EvaluationError
from explore_slam.geometry import Array, Pose2, wrap_angle
from explore_slam.settings import with_values
from explore_slam.simulation import SimulationConfig, Simulator, load_world
from explore_slam.studies.experiments.scenarios import (
    Noise,
    Scenario,
    VehicleStep,
    from_polar,
    path_poses,
)
from explore_slam.vision import CameraMount, FeatureExtractor, VisionConfig

logger = logging.getLogger(__name__)

SPEED, TURN_RATE = 0.6, 1.0  # m/s and rad/s, below the limits of the simulated base
LEG_TIMEOUT = 60.0  # simulated time (s) for one leg, which takes less than 10 s
POSITION_TOLERANCE, HEADING_TOLERANCE = 0.01, 0.004  # m and rad, a tenth of the odometry noise


@dataclass(frozen=True)
class RecordedStop:
    """A stop: true pose, landmark observations, and the time (s) that extraction took."""

    pose: Pose2
    observations: LandmarkObservations
    seconds: float


@dataclass(frozen=True)
class Walk:
    """The stops of one vehicle, beginning with its start."""

    vehicle: str
    stops: list[RecordedStop]


def record_walk(
    world: Path, vehicle: str, corners: Sequence[tuple[float, float]], step: float,
    config: VisionConfig | None = None,
) -> Walk:  # fmt: skip
    """Drive along a path and record a frame after every step (m); control uses the true pose."""
    planned = path_poses(list(corners), step)
    simulation = with_values(
        SimulationConfig(), {'simulated_scan_rate': 0.0, 'simulated_camera_rate': 2.0}
    )
    stops = []
    with Simulator(load_world(world), {vehicle: planned[0]}, simulation, seed=1) as simulator:
        mount = CameraMount.from_config(simulation.camera_mount)
        extractor = FeatureExtractor(config, mount)
        for goal in planned:
            _drive(simulator, vehicle, goal)
            stops.append(_record_stop(simulator, vehicle, extractor))
    if any(simulator.collisions.values()):
        raise EvaluationError(
            f'{vehicle} collided on its path in {world}: {simulator.collision_log[0]}'
        )
    logger.info('%s: %d stops in %s', vehicle, len(stops), world)
    return Walk(vehicle, stops)


def _drive(simulator: Simulator, vehicle: str, goal: Pose2) -> None:
    """Turn to the goal, drive there, turn to its heading."""
    pose = simulator.true_pose(vehicle)
    if math.hypot(goal.x - pose.x, goal.y - pose.y) > POSITION_TOLERANCE:
        _turn(simulator, vehicle, math.atan2(goal.y - pose.y, goal.x - pose.x))
        end = simulator.time + LEG_TIMEOUT
        while simulator.time < end:
            pose = simulator.true_pose(vehicle)
            ahead = pose.between(goal)
            if ahead.x <= POSITION_TOLERANCE:
                break
            bend = 1.5 * math.atan2(ahead.y, max(ahead.x, 0.1))
            simulator.set_velocity(vehicle, min(SPEED, 0.8 * ahead.x + 0.02), bend)
            simulator.step()
        else:
            raise EvaluationError(
                f'{vehicle} did not get from {pose} to {goal} in {LEG_TIMEOUT:g} s'
            )
    _turn(simulator, vehicle, goal.theta)


def _turn(simulator: Simulator, vehicle: str, heading: float) -> None:
    end = simulator.time + LEG_TIMEOUT
    while simulator.time < end:
        rest = wrap_angle(heading - simulator.true_pose(vehicle).theta)
        linear, angular = simulator.velocity(vehicle)
        if abs(rest) < HEADING_TOLERANCE and abs(linear) < 1e-3 and abs(angular) < 0.05:
            simulator.set_velocity(vehicle, 0.0, 0.0)
            return
        turn = math.copysign(min(TURN_RATE, 2.0 * abs(rest)), rest)
        simulator.set_velocity(vehicle, 0.0, turn)
        simulator.step()
    raise EvaluationError(f'{vehicle} did not turn to {heading:.2f} rad')


def _record_stop(simulator: Simulator, vehicle: str, extractor: FeatureExtractor) -> RecordedStop:
    """Stand still and extract observations from the next frame."""
    simulator.set_velocity(vehicle, 0.0, 0.0)
    end = simulator.time + 2.0
    while simulator.time < end:
        for event in simulator.step():
            still = max(map(abs, simulator.velocity(vehicle))) < 1e-3
            if isinstance(event.record, RgbdFrame) and still:
                began = time.perf_counter()
                seen = extractor.extract(event.record)
                return RecordedStop(
                    simulator.true_pose(vehicle), seen, time.perf_counter() - began
                )
    raise EvaluationError(f'{vehicle}: no frame within 2 s of simulated time')


def scenario_of(walks: Sequence[Walk], seed: int, *, table_one: bool = False) -> Scenario:
    """Return recorded paths as a scenario, vehicles in turn, with odometry noise of table I.

    The frame at the start follows a motion of zero. table_one: give observations the covariances
    of table I, 5 % of the range, instead of those of the Kinect.
    """
    noise = Noise()
    rng = np.random.default_rng(np.random.SeedSequence([seed, len(walks)]))
    starts = {walk.vehicle: walk.stops[0].pose for walk in walks}
    steps = []
    for number in range(max(len(walk.stops) for walk in walks)):
        for walk in walks:
            if number >= len(walk.stops):
                continue
            stop = walk.stops[number]
            if number == 0:
                increment, covariance = Pose2(0.0, 0.0, 0.0), 1e-12 * np.eye(3)
            else:
                true = walk.stops[number - 1].pose.between(stop.pose)
                covariance = noise.motion_covariance(true)
                noise_sample = rng.multivariate_normal(np.zeros(3), covariance, method='cholesky')
                increment = Pose2.from_array(np.add(true, noise_sample))
            seen = replace(stop.observations, stamp=float(number))
            if table_one:
                seen = replace(seen, covariances=_table_one(seen.positions, noise))
            unknown = np.full(len(seen), -1, np.int64)
            steps.append(
                VehicleStep(walk.vehicle, stop.pose, increment, covariance, seen, unknown)
            )
    return Scenario('walk', np.empty((0, 3)), starts, steps)


def _table_one(positions: Array, noise: Noise) -> Array:
    """Return the covariances (K, 3, 3) that table I gives to observations (K, 3) m."""
    x, y, z = positions.T
    tau = np.sqrt(x**2 + y**2 + z**2)
    return from_polar(tau, np.arctan2(y, x), np.arcsin(z / tau), noise)[1]
