"""Exponential and logarithm of SE(2) undo each other; errors are carried over motions."""

import math

import numpy as np
import pytest

from explore_slam.agent.odometry_sources.twists import exponential, logarithm, moved_error
from explore_slam.geometry import Pose2

TWISTS = [(0.4, 0.0, 0.9), (0.4, -0.1, -2.5), (0.3, 0.2, 0.0), (0.0, 0.0, 1e-9), (-0.2, 0.1, 1e-5)]


@pytest.mark.parametrize('twist', TWISTS)
def test_the_logarithm_undoes_the_exponential(twist):
    assert logarithm(exponential(np.array(twist))) == pytest.approx(twist, abs=1e-9)


def test_a_constant_velocity_leads_along_an_arc():
    pose = Pose2(0.0, 0.0, 0.0)
    small = exponential(np.array([0.4, 0.0, 0.9]) / 1000.0)
    for _ in range(1000):
        pose = pose.compose(small)
    assert exponential(np.array([0.4, 0.0, 0.9])) == pytest.approx(pose, abs=1e-9)
    radius = 0.4 / 0.9
    assert pose.x == pytest.approx(radius * math.sin(0.9))


def test_an_error_before_a_motion_is_carried_to_its_end():
    motion, error = Pose2(0.7, -0.2, 0.8), np.array([1e-6, -2e-6, 3e-6])
    off = motion.between(Pose2.from_array(error).compose(motion))
    assert np.asarray(off) == pytest.approx(moved_error(motion) @ error, abs=1e-11)
