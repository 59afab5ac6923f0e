"""Systematic errors of the simulated wheel odometry; test_simulator tests its noise."""

import math

import numpy as np
import pytest

from explore_slam.geometry import Pose2
from explore_slam.settings import with_values
from explore_slam.simulation.config import SimulatedOdometryConfig
from explore_slam.simulation.wheel_odometry import WheelOdometry

EXACT = {
    'simulated_distance_variance': 0.0,
    'simulated_drift_variance': 0.0,
    'simulated_turn_variance': 0.0,
}


def measured(increment, steps, **errors):
    config = with_values(SimulatedOdometryConfig(), EXACT | errors)
    wheels = WheelOdometry(config, np.random.default_rng(0))
    for _ in range(steps):
        wheels.move(increment)
    return wheels.pose


def test_without_errors_the_motion_is_exact():
    assert measured(Pose2(0.1, 0.0, 0.0), 20) == pytest.approx((2.0, 0.0, 0.0))


def test_distances_and_turns_are_scaled():
    ahead = measured(Pose2(0.1, 0.0, 0.0), 20, simulated_distance_scale=0.05)
    assert ahead == pytest.approx((2.1, 0.0, 0.0))
    turned = measured(Pose2(0.0, 0.0, -0.1), 10, simulated_turn_scale=0.05)
    assert turned.theta == pytest.approx(-1.05)


@pytest.mark.parametrize('way', [1.0, -1.0])
def test_wheels_of_unequal_diameter_drive_an_arc(way):
    pose = measured(Pose2(0.01 * way, 0.0, 0.0), 200, simulated_heading_drift=-0.058)
    assert pose.theta == pytest.approx(-0.058 * 2.0 * way)
    radius = 1.0 / 0.058
    assert math.hypot(pose.x, pose.y) == pytest.approx(2.0 * radius * math.sin(1.0 / radius), 1e-3)
