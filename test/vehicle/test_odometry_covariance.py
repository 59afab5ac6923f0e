"""Covariance of wheel odometry against the usual propagation in the odometry frame."""

import dataclasses
import math

import numpy as np
import pytest

from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.settings import settings_of
from explore_slam.vehicle.driver_config import BaseNoiseConfig
from explore_slam.vehicle.odometry_covariance import OdometryCovariance

CONFIG = BaseNoiseConfig(
    base_distance_variance=0.03,
    base_heading_variance_turn=0.02,
    base_heading_variance_distance=0.05,
)
STEPS = (Pose2(0.4, 0.1, 0.3), Pose2(0.0, 0.0, -0.7), Pose2(-0.5, 0.02, 0.0), Pose2(0.3, 0.0, 2.0))


def in_the_odometry_frame(steps):
    """Propagate pose and covariance by hand: Jacobian of the composition, noise at its end."""
    pose, covariance = IDENTITY, np.zeros((3, 3))
    for step in steps:
        moved = pose.compose(step)
        jacobian = np.eye(3)
        jacobian[:2, 2] = pose.y - moved.y, moved.x - pose.x
        distance, turn = math.hypot(step.x, step.y), abs(step.theta)
        noise = np.diag([0.03 * distance, 0.003 * distance, 0.02 * turn + 0.05 * distance])
        c, s = math.cos(moved.theta), math.sin(moved.theta)
        rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        covariance = jacobian @ covariance @ jacobian.T + rotation @ noise @ rotation.T
        pose = moved
    return pose, covariance


@pytest.mark.parametrize('count', [1, 2, 3, 4])
def test_agrees_with_the_propagation_in_the_odometry_frame(count):
    covariance = OdometryCovariance(CONFIG)
    for step in STEPS[:count]:
        covariance.propagate(step)
    pose, expected = in_the_odometry_frame(STEPS[:count])
    np.testing.assert_allclose(covariance.value(pose), expected, rtol=1e-12, atol=1e-15)


def test_no_motion_adds_nothing():
    covariance = OdometryCovariance(CONFIG)
    assert not covariance.value(IDENTITY).any()
    covariance.propagate(STEPS[0])
    before = covariance.value(STEPS[0])
    covariance.propagate(IDENTITY)
    np.testing.assert_array_equal(covariance.value(STEPS[0]), before)


@pytest.mark.parametrize('name', [info.name for info, _ in settings_of(BaseNoiseConfig())])
def test_every_setting_has_an_effect(name):
    def covariance(config):
        made = OdometryCovariance(config)
        for step in STEPS:
            made.propagate(step)
        return made.value(IDENTITY)

    plain = covariance(BaseNoiseConfig())
    assert np.all(np.linalg.eigvalsh(plain) > 0.0)
    changed = covariance(dataclasses.replace(BaseNoiseConfig(), **{name: 0.1}))
    assert not np.allclose(plain, changed)


def test_a_heading_error_grows_sideways_with_the_distance():
    config = BaseNoiseConfig(
        base_distance_variance=0.0,
        base_heading_variance_distance=0.0,
        base_heading_variance_turn=0.01,
    )
    made, pose = OdometryCovariance(config), IDENTITY
    for step in (Pose2(0.0, 0.0, 1.0), *([Pose2(0.1, 0.0, 0.0)] * 50)):
        made.propagate(step)
        pose = pose.compose(step)
    covariance = made.value(pose)
    across = np.array([-math.sin(1.0), math.cos(1.0), 0.0])
    along = np.array([math.cos(1.0), math.sin(1.0), 0.0])
    assert across @ covariance @ across == pytest.approx(0.01 * 5.0**2, rel=1e-6)
    assert along @ covariance @ along == pytest.approx(0.0, abs=1e-9)
