"""Measurements of a small world, recorded in the joint graph and in GTSAM alike."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import gtsam
import numpy as np
import pytest

from explore_slam.geometry import Array, between, compose
from explore_slam.slam.graph import GraphConfig, JointGraph

MOTION = np.diag([0.03, 0.01, 0.02]) ** 2
OBSERVATION = np.array([0.05**2, 0.0004, 0.0003, 0.03**2, 0.0, 0.03**2])
FULL = [0, 1, 2, 1, 3, 4, 2, 4, 5]
EVERYTHING = GraphConfig(
    graph_minimum_observations=2,
    graph_observations_per_keyframe=1000,
    graph_independent_observations=1e6,
    graph_bounded=False,
    graph_landmark_heights=True,
    graph_tolerance=1e-12,
)


def draw_from(random: np.random.Generator, covariance: Array) -> Array:
    return random.multivariate_normal(np.zeros(len(covariance)), covariance, method='cholesky')


@dataclass
class World:
    """Vehicles that drive circles among landmarks; everything is measured with known noise."""

    seed: int = 0
    landmarks: int = 40
    config: GraphConfig = EVERYTHING
    reach: float = 3.5
    true: dict[int, Array] = field(default_factory=dict)  # of each keyframe

    def __post_init__(self) -> None:
        self.random = np.random.default_rng(self.seed)
        low, high = [-4, -3, 0.2], [4, 5, 1.8]
        self.points = self.random.uniform(low, high, (self.landmarks, 3))
        self.graph = JointGraph(self.config)
        self.newest: dict[int, int] = {}
        self.recorded: list[tuple[Any, ...]] = []

    def start(self, vehicle: int, pose: list[float], covariance: Array | None = None) -> None:
        number = len(self.true)
        self.true[number] = np.array(pose)
        if covariance is not None:
            self.true[number] = self.true[number] + draw_from(self.random, covariance)
        self.newest[vehicle] = number
        self.graph.add_start(vehicle, number, pose, covariance)
        self.recorded.append(('start', number, np.array(pose), covariance))

    def drive(self, vehicle: int, increment: Array, covariance: Array = MOTION) -> int:
        before, number = self.newest[vehicle], len(self.true)
        moved = increment + draw_from(self.random, covariance)
        self.true[number] = compose(self.true[before], moved)
        self.newest[vehicle] = number
        self.graph.add_keyframe(vehicle, number, increment, covariance)
        self.recorded.append(('motion', before, number, increment, covariance))
        return number

    def visible(self, keyframe: int) -> Array:
        x, y, theta = self.true[keyframe]
        d = self.points[:, :2] - [x, y]
        ahead = d[:, 0] * math.cos(theta) + d[:, 1] * math.sin(theta) > 0
        return np.flatnonzero(ahead & (np.hypot(d[:, 0], d[:, 1]) < self.reach))

    def see(self, keyframe: int, share: float = 1.0) -> None:
        ids = self.visible(keyframe)
        ids = ids[self.random.random(len(ids)) < share]
        x, y, theta = self.true[keyframe]
        c, s = math.cos(theta), math.sin(theta)
        local = (self.points[ids] - [x, y, 0.0]) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        R = np.tile(OBSERVATION, (len(ids), 1))
        noise = [draw_from(self.random, OBSERVATION[FULL].reshape(3, 3)) for _ in ids]
        z = local + np.array(noise).reshape(-1, 3)
        self.graph.add_observations(keyframe, ids, z, R)
        self.recorded += [('landmark', keyframe, int(i), z[n]) for n, i in enumerate(ids)]

    def close(self, a: int, b: int, covariance: Array) -> int:
        z = between(self.true[a], self.true[b]) + draw_from(self.random, covariance)
        self.recorded.append(('closure', a, b, z, covariance))
        return self.graph.add_relative_pose(a, b, z, np.linalg.inv(covariance), robust=False)

    def meet(self, a: int, b: int, R: Array) -> int:
        z = between(self.true[a], self.true[b])[:2] + draw_from(self.random, R)
        self.recorded.append(('position', a, b, z, R))
        return self.graph.add_relative_position(a, b, z, R)

    def circle(self, steps: int, vehicles: int = 2, share: float = 1.0) -> None:
        for number in range(vehicles):
            self.start(number, [2.0 * number - 1.0, 0.0, 0.5 * number])
        for _ in range(steps):
            for number in range(vehicles):
                turn = 0.25 if number % 2 == 0 else -0.3
                self.see(self.drive(number, np.array([0.4, 0.0, turn])), share)

    def true_path(self) -> Array:
        return np.array(list(self.true.values()))

    def errors(self) -> Array:
        return between(self.true_path(), self.graph.path())


@pytest.fixture
def make_world() -> Callable[..., World]:
    return World


@dataclass
class Oracle:
    """GTSAM on what a world recorded, optimized to the last digit."""

    world: World

    def __post_init__(self) -> None:
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        key = gtsam.symbol_shorthand.X
        for kind, *data in self.world.recorded:
            getattr(self, f'_add_{kind}')(graph, *data)
        for number, pose in self.world.true.items():
            values.insert(key(number), gtsam.Pose2(*pose))
        for number in {data[2] for data in self.world.recorded if data[0] == 'landmark'}:
            values.insert(gtsam.symbol_shorthand.L(number), self.world.points[number])
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setRelativeErrorTol(1e-14)
        parameters.setAbsoluteErrorTol(1e-14)
        parameters.setMaxIterations(200)
        self.graph = graph
        self.values = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
        self.marginals = gtsam.Marginals(graph, self.values)

    @property
    def cost(self) -> float:
        return 2.0 * self.graph.error(self.values)

    def path(self) -> Array:
        poses = [self.values.atPose2(self._pose(n)) for n in self.world.true]
        return np.array([[p.x(), p.y(), p.theta()] for p in poses])

    def landmark(self, number: int) -> Array:
        return self.values.atPoint3(gtsam.symbol_shorthand.L(number))

    def covariance(self, keyframe: int) -> Array:
        theta = self.values.atPose2(self._pose(keyframe)).theta()
        turn = rotation(theta)
        return turn @ self.marginals.marginalCovariance(self._pose(keyframe)) @ turn.T

    def relative_covariance(self, a: int, b: int) -> Array:
        poses = [self.values.atPose2(self._pose(n)) for n in (a, b)]
        z = poses[0].between(poses[1])
        keys = gtsam.KeyVector([self._pose(a), self._pose(b)])
        joint = self.marginals.jointMarginalCovariance(keys).fullMatrix()
        J = np.hstack([-z.inverse().AdjointMap(), np.eye(3)])
        turn = rotation(z.theta())
        return turn @ J @ joint @ J.T @ turn.T

    def _pose(self, number: int) -> int:
        return gtsam.symbol_shorthand.X(number)

    def _add_start(self, graph: Any, number: int, pose: Array, covariance: Array | None) -> None:
        P = 1e-12 * np.eye(3) if covariance is None else covariance
        noise = gtsam.noiseModel.Gaussian.Covariance(P)
        graph.add(gtsam.CustomFactor(noise, [self._pose(number)], at(pose)))

    def _add_motion(self, graph: Any, a: int, b: int, z: Array, covariance: Array) -> None:
        noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
        graph.add(gtsam.CustomFactor(noise, [self._pose(a), self._pose(b)], apart(z)))

    _add_closure = _add_motion

    def _add_landmark(self, graph: Any, keyframe: int, number: int, z: Array) -> None:
        noise = gtsam.noiseModel.Gaussian.Covariance(OBSERVATION[FULL].reshape(3, 3))
        keys = [self._pose(keyframe), gtsam.symbol_shorthand.L(number)]
        graph.add(gtsam.CustomFactor(noise, keys, seen_from(z, 3)))

    def _add_position(self, graph: Any, a: int, b: int, z: Array, R: Array) -> None:
        noise = gtsam.noiseModel.Gaussian.Covariance(R)
        graph.add(gtsam.CustomFactor(noise, [self._pose(a), self._pose(b)], seen_from(z, 2)))


def rotation(theta: float) -> Array:
    c, s = math.cos(theta), math.sin(theta)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def components(pose: Any) -> Array:
    return np.array([pose.x(), pose.y(), pose.theta()])


# GTSAM's own factors take the logarithm of SE(2) as the error, which is another distribution


def at(z: Array) -> Callable[..., Array]:
    """Return GTSAM's error of a pose measured in the map."""

    def error(factor: Any, values: Any, jacobians: list[Array] | None) -> Array:
        pose = values.atPose2(factor.keys()[0])
        if jacobians is not None:
            jacobians[0] = rotation(pose.theta())
        d = components(pose) - z
        return np.array([d[0], d[1], math.remainder(d[2], math.tau)])

    return error


def apart(z: Array) -> Callable[..., Array]:
    """Return GTSAM's error of a pose measured in the frame of another."""

    def error(factor: Any, values: Any, jacobians: list[Array] | None) -> Array:
        a, b = (values.atPose2(key) for key in factor.keys())  # noqa: SIM118
        h = components(a.between(b))
        if jacobians is not None:
            jacobians[0] = np.array([[-1.0, 0.0, h[1]], [0.0, -1.0, -h[0]], [0.0, 0.0, -1.0]])
            jacobians[1] = rotation(h[2])
        return np.array([*(h[:2] - z[:2]), math.remainder(h[2] - z[2], math.tau)])

    return error


def seen_from(z: Array, size: int) -> Callable[..., Array]:
    """Return GTSAM's error of a point (size 3) or pose (2) seen in a vehicle's frame."""

    def error(factor: Any, values: Any, jacobians: list[Array] | None) -> Array:
        pose = values.atPose2(factor.keys()[0])
        back = rotation(pose.theta()).T
        if size == 3:
            target, J = values.atPoint3(factor.keys()[1]), back
        else:
            other = values.atPose2(factor.keys()[1])
            target, J = np.array([other.x(), other.y(), 0.0]), back @ rotation(other.theta())
        h = back @ (target - np.array([pose.x(), pose.y(), 0.0]))
        if jacobians is not None:
            A = np.array([[-1.0, 0.0, h[1]], [0.0, -1.0, -h[0]], [0.0, 0.0, 0.0]])
            jacobians[0], jacobians[1] = A[:size], J[:size]
        return (h[:size] - z)[:size]

    return error


@pytest.fixture
def oracle_of() -> Callable[[World], Oracle]:
    return Oracle
