"""The velocity filter: what it learns from poses, and what it says where nothing is measured."""

import numpy as np
import pytest

from explore_slam.agent.odometry_sources.velocity_filter import VelocityFilter

STEP = 0.1
EXACT = np.diag([1e-6, 1e-6, 1e-6])


def test_the_velocity_follows_from_the_measured_poses():
    found, true = VelocityFilter(), np.array([0.4, 0.0, 0.5])
    for _ in range(10):
        shift = STEP * (true - found.velocity)  # to first order
        found.update(STEP, shift, found.predicted(STEP)[:3, :3], EXACT)
    assert found.velocity == pytest.approx(true, abs=0.02)
    assert np.sqrt(np.diag(found.covariance)[3:]).max() < 0.4


def test_without_measurements_the_growth_adds_up_to_the_error_of_an_unknown_velocity():
    found = VelocityFilter()
    for _ in range(10):
        found.update(STEP, np.zeros(3), found.predicted(STEP)[:3, :3], EXACT)
    total, along = 0.0, 0.0
    for _ in range(600):
        total += found.growth(STEP)[0, 0]
        found.wait(STEP)
        along = found.covariance[0, 0]
    # 60 s at up to 1.2 m/s: anything between a standstill and twice the way
    assert total == pytest.approx(along, rel=0.01)
    assert 20.0 < np.sqrt(total) < 72.0
    assert np.sqrt(found.covariance[3, 3]) <= 0.6 + 1e-6


def test_after_a_gap_the_velocity_may_be_any():
    found = VelocityFilter()
    for _ in range(10):
        shift = np.array([0.04, 0.0, 0.0]) - STEP * found.velocity
        found.update(STEP, shift, found.predicted(STEP)[:3, :3], EXACT)
    found.forget_velocity()
    assert (found.velocity == 0.0).all()
    assert np.sqrt(found.predicted(2.0)[0, 0]) > 1.2
