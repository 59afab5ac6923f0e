"""Kernels of SE(2) against the operations outside of kernels."""

import math

import numpy as np
import pytest

from explore_slam.geometry import Pose2, between, compose, wrap_angle
from explore_slam.slam import compound
from explore_slam.slam.graph import se2


def random_motion(random):
    root = random.normal(size=(3, 3))
    return random.uniform(-3.0, 3.0, 3), root @ root.T


@pytest.mark.parametrize('seed', range(5))
def test_kernels_agree_with_the_operations_outside_of_kernels(seed):
    random = np.random.default_rng(seed)
    (u, P), (v, Q) = random_motion(random), random_motion(random)
    out = np.empty(3)
    se2.compose(u, v, out)
    assert out == pytest.approx(compose(u, v), abs=1e-12)
    se2.relative(u, v, out)
    assert out == pytest.approx(between(u, v), abs=1e-12)
    mean, covariance = se2.compound(u, P, v, Q)
    expected_mean, expected = compound(Pose2(*u), P, Pose2(*v), Q)
    assert mean == pytest.approx(np.asarray(expected_mean), abs=1e-12)
    assert covariance == pytest.approx(expected, abs=1e-10)
    assert np.array_equal(covariance, covariance.T)


@pytest.mark.parametrize('angle', [0.0, 3.0, -3.0, 4.0, -4.0, 50.0, -50.0])
def test_angles_are_wrapped_alike(angle):
    assert se2.wrapped(angle) == pytest.approx(wrap_angle(angle), abs=1e-12)


def test_an_angle_in_range_keeps_its_bits():
    assert se2.wrapped(-math.pi) == -math.pi
    assert se2.wrapped(math.pi) == math.pi


@pytest.mark.parametrize('seed', range(3))
def test_jacobians_are_the_numeric_derivatives(seed):
    random = np.random.default_rng(seed)
    u, v = random.uniform(-0.7, 0.7, 3), random.uniform(-0.7, 0.7, 3)
    F, G = se2.jacobians(u, compose(u, v))
    step = 1e-6
    for k in range(3):
        delta = step * np.eye(3)[k]
        numeric = (compose(u + delta, v) - compose(u - delta, v)) / (2.0 * step)
        assert F[:, k] == pytest.approx(numeric, abs=1e-8)
        numeric = (compose(u, v + delta) - compose(u, v - delta)) / (2.0 * step)
        assert G[:, k] == pytest.approx(numeric, abs=1e-8)
