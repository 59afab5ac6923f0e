"""Runs with known errors, grid and landmarks."""

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

from explore_slam.agent.config import AgentConfig
from explore_slam.data import LaserScan, OdometryReading
from explore_slam.geometry import Pose2
from explore_slam.mapping import OccupancyGrid
from explore_slam.results import RunData, RunRecorder

STARTS = {'robot1': Pose2(1.0, 0.0, 0.5), 'robot2': Pose2(0.0, 2.0, 0.0)}


def some_landmarks(count: int = 5) -> SimpleNamespace:
    return SimpleNamespace(
        means=np.arange(3.0 * count).reshape(count, 3),
        covariances=np.repeat(0.03 * np.eye(3)[None], count, axis=0),
        counts=np.arange(count),
    )


def some_grid() -> OccupancyGrid:
    grid = OccupancyGrid()
    ranges = np.full(181, 3.0, np.float32)
    grid.insert_scan(Pose2(1.0, 0.0, 0.5), LaserScan(1.0, -1.57, np.pi / 180, ranges, 0.1, 8.0))
    return grid


@pytest.fixture
def some_run() -> Callable[..., RunData]:
    return make_run


@pytest.fixture
def landmarks() -> Callable[[int], SimpleNamespace]:
    return some_landmarks


def make_run(**extra) -> RunData:
    recorder = RunRecorder('a run', STARTS, particles=100)
    for name, start in STARTS.items():
        for index in range(101):
            stamp, moved = 10.0 + 0.1 * index, Pose2(0.05 * index, 0.0, 0.0)
            true = start.compose(moved)
            recorder.add_truth(name, stamp, true)
            drift = Pose2(1.1 * moved.x, 0.0, 0.0)
            recorder.add_odometry(name, OdometryReading(stamp, Pose2(7, 7, 1).compose(drift)))
            estimate = Pose2(true.x + 0.03, true.y - 0.04, true.theta + 0.02)
            recorder.add_pose(name, stamp, estimate)
            recorder.add_estimate(name, stamp, estimate, np.diag([9e-4, 16e-4, 4e-4]))
        recorder.add_effective_particles(15.0, 60.0)
    for index in range(11):
        recorder.add_coverage(10.0 + index, 0.098 * index)
    recorder.add_note('a <warning>')
    paths = {
        name: (np.array([10.0, 20.0]), np.array([start, start.compose(Pose2(5.0, 0.0, 0.0))]))
        for name, start in STARTS.items()
    }
    return recorder.finish(
        paths,
        grid=some_grid(),
        landmarks=some_landmarks(),
        settings=AgentConfig(),
        extra=extra or {'collisions': 0},
    )
