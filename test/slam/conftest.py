"""A small world of point landmarks, driven by vehicles with known noise."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

from explore_slam.data import LandmarkObservations
from explore_slam.geometry import Array, Pose2, to_world, wrap_angle
from explore_slam.settings import with_values
from explore_slam.slam import FastSlam, FastSlamConfig

STEP_NOISE = np.diag([0.02**2, 0.01**2, 0.03**2])


def unit_rows(random: np.random.Generator, count: int) -> np.ndarray:
    rows = random.standard_normal((count, 128))
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


@dataclass
class World:
    """Landmarks with descriptors, and vehicles that drive circles among them."""

    seed: int = 0
    landmarks: int = 60
    deviation: float = 0.03
    true: dict[str, Pose2] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.random = np.random.default_rng(self.seed)
        self.points = np.c_[
            self.random.uniform(-2, 8, self.landmarks),
            self.random.uniform(-2, 8, self.landmarks),
            self.random.uniform(0, 1, self.landmarks),
        ]
        self.descriptors = unit_rows(self.random, self.landmarks)

    def start(self, **vehicles: Pose2) -> dict[str, Pose2]:
        self.true = dict(vehicles)
        return vehicles

    def drive(self, vehicle: str, increment: Pose2) -> None:
        noise = self.random.multivariate_normal(np.zeros(3), STEP_NOISE)
        self.true[vehicle] = self.true[vehicle].compose(Pose2(*(np.asarray(increment) + noise)))

    def see(self, vehicle: str, stamp: float, reach: float = 3.5) -> LandmarkObservations:
        local = to_world(self.true[vehicle].inverse(), self.points)
        seen = np.flatnonzero((np.hypot(local[:, 0], local[:, 1]) < reach) & (local[:, 0] > 0))
        noise = self.deviation * self.random.standard_normal((len(seen), 3))
        covariance = np.tile(self.deviation**2 * np.eye(3), (len(seen), 1, 1))
        return LandmarkObservations(stamp, local[seen] + noise, covariance, self.descriptors[seen])

    def error(self, vehicle: str, pose: Pose2) -> Array:
        true = self.true[vehicle]
        return np.array([pose.x - true.x, pose.y - true.y, wrap_angle(pose.theta - true.theta)])


@pytest.fixture
def make_world() -> Callable[..., World]:
    return World


@pytest.fixture
def make_slam() -> Callable[..., FastSlam]:
    def make(starts: dict[str, Pose2], seed: int = 0, **values: object) -> FastSlam:
        settings = {'particles': 200, 'maximum_descriptor_distance': 0.0} | values
        return FastSlam(starts, with_values(FastSlamConfig(), settings), seed)

    return make


@pytest.fixture
def drive_circles() -> Callable[..., Array]:
    """Return a function that drives all vehicles in circles and returns errors (steps, V, 3)."""

    def run(slam: FastSlam, world: World, steps: int, first: int = 0) -> Array:
        errors = []
        for step in range(first, first + steps):
            row = []
            for i, vehicle in enumerate(slam.vehicles):
                increment = Pose2(0.4, 0.0, 0.3 if i % 2 == 0 else -0.3)
                world.drive(vehicle, increment)
                slam.predict(vehicle, increment, STEP_NOISE)
                seen = world.see(vehicle, float(step))
                if len(seen):
                    slam.update(vehicle, seen)
                slam.add_keyframe(vehicle, float(step))
                row.append(world.error(vehicle, slam.estimate(vehicle)[0]))
            errors.append(row)
        return np.array(errors)

    return run
