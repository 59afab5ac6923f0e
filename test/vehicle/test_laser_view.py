"""What all lasers of a vehicle see now: places of returns, silence, sweeps."""

import math

import numpy as np
import pytest

from explore_slam.data import LaserScan, OdometryReading
from explore_slam.geometry import Pose2
from explore_slam.sweeps import Sweep
from explore_slam.vehicle.dead_reckoning import DeadReckoning
from explore_slam.vehicle.laser_view import LaserView

RATE = 1.0  # rad/s


def turning():
    """Odometry of a vehicle that turns on the spot."""
    made = DeadReckoning()
    for stamp in np.arange(0.0, 2.0, 0.05):
        made.add_odometry(OdometryReading(float(stamp), Pose2(0.0, 0.0, RATE * stamp)))
    return made


def post(stamp, **options):
    """A scan with a single return, from the last beam, 2 m ahead of the laser."""
    ranges = np.full(91, np.inf, np.float32)
    ranges[-1] = 2.0
    return LaserScan(stamp, -math.pi / 2, math.pi / 180, ranges, 0.1, 8.0, **options)


def test_returns_of_all_lasers_are_where_they_are_now():
    view = LaserView('r', turning())
    assert view.points(1.0).shape == (0, 2)
    view.add(post(1.0, sensor='front'), Pose2(0.2, 0.0, 0.0), 1.0)
    view.add(post(1.1, sensor='rear'), Pose2(-0.2, 0.0, math.pi), 1.1)
    seen = view.points(1.2)
    turn = -0.2 * RATE
    assert seen[0] == pytest.approx((2.2 * math.cos(turn), 2.2 * math.sin(turn)), abs=1e-6)
    turn = -0.1 * RATE
    assert seen[1] == pytest.approx((-2.2 * math.cos(turn), -2.2 * math.sin(turn)), abs=1e-6)
    view.add(post(1.2, sensor='front'), Pose2(0.2, 0.0, 0.0), 1.2)
    assert len(view.points(1.2)) == 2  # it replaces the scan before


def test_the_laser_that_is_silent_longest_counts():
    view = LaserView('r', turning())
    assert view.last_received == -math.inf
    view.add(post(1.0, sensor='front'), Pose2(0.2, 0.0, 0.0), 7.0)
    view.add(post(1.0, sensor='rear'), Pose2(0.2, 0.0, 0.0), 7.1)
    view.add(post(1.2, sensor='rear'), Pose2(0.2, 0.0, 0.0), 7.3)
    assert view.last_received == 7.0


def test_a_driver_that_was_restarted_with_another_frame_is_the_same_laser():
    view = LaserView('r', turning())
    view.add(post(1.0), Pose2(0.0, 0.0, 0.0), 7.0)
    view.add(post(1.1, sensor='scan, laser_link'), Pose2(0.0, 0.0, 0.0), 7.1)
    assert view.last_received == 7.1
    assert len(view.points(1.2)) == 2
    view.add(post(6.2, sensor='scan, laser_link'), Pose2(0.0, 0.0, 0.0), 12.2)
    assert len(view.points(6.2)) == 1  # what the other one has seen is long ago


@pytest.mark.parametrize('early', [True, False])
def test_a_sweep_that_was_found_elsewhere_places_the_beams(early):
    view = LaserView('r', turning())
    found = {'': Sweep(0.2, backward=False, last=False)}
    if early:
        view.set_sweeps(found)
    view.add(post(1.0), Pose2(0.0, 0.0, 0.0), 1.0)
    if not early:
        assert view.points(1.0)[0] == pytest.approx((2.0, 0.0), abs=1e-6)
        view.set_sweeps(found)
        view.add(post(1.0), Pose2(0.0, 0.0, 0.0), 1.0)
    turn = 0.2 * RATE  # the last beam was measured 0.2 s after the stamp
    expected = (2.0 * math.cos(turn), 2.0 * math.sin(turn))
    assert view.points(1.0)[0] == pytest.approx(expected, abs=1e-3)
