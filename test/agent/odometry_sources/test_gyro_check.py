"""A gyroscope is judged by its turns: units, axes and sign are named with their values."""

import numpy as np
import pytest

from explore_slam.agent.odometry_sources.gyro_check import GyroCheck


def compared(factors, turns=40, wheels=0.03):
    """The verdict on a gyroscope whose turns about x, y and z are these times the wheels'."""
    check = GyroCheck()
    for _ in range(turns):
        check.compare('wheels', wheels, wheels * np.array(factors), 0.05)
    return check


@pytest.mark.parametrize('factor', [1.0, 1.0 / 0.7, 1.0 / 1.4])
def test_wheels_of_poor_odometry_confirm_it(factor):
    check = compared((0.0, 0.01, factor))
    assert check.accepted
    assert check.problem == ''


@pytest.mark.parametrize(
    ('factors', 'words'),
    [
        ((0.0, 0.0, 57.3), ['57.3 times', 'degrees per second']),
        ((0.0, 0.0, 57.3 / 1.4), ['40.9 times', 'degrees per second']),
        ((0.0, 0.0, -1.0), ['-1.00 times', 'upside down', 'imu_mount']),
        ((1.02, 0.0, 0.03), ['its x axis', '1.02 times', 'imu_mount']),
        ((0.0, -0.98, 0.0), ['its y axis', '-0.98 times']),
        ((0.0, 0.0, 0.0), ['0.00 times', 'expected 0.4 to 2.5']),
        ((0.0, 0.0, 5.0), ['5.00 times']),
    ],
)
def test_what_is_wrong_is_named_with_its_value(factors, words):
    check = compared(factors)
    assert not check.accepted
    for word in words:
        assert word in check.problem


def test_a_rate_that_no_base_reaches_is_refused_at_once():
    check = GyroCheck()
    check.check_rate((0.1, 0.0, -51.6))
    assert 'angular_velocity.z is -51.6 rad/s' in check.problem
    assert 'degrees per second' in check.problem


def test_nothing_is_decided_at_rest_or_after_a_small_turn():
    assert not compared((0.0, 0.0, 57.3), wheels=0.001).is_done
    assert not compared((0.0, 0.0, 57.3), turns=10).is_done
    assert not compared((0.0, 0.0, 1.0), turns=4).is_done
