"""Poses, homes and trails of the vehicles."""

import math

from explore_slam.exploration import VehicleSnapshot
from explore_slam.exploration.vehicle_history import VehicleHistory
from explore_slam.geometry import Pose2


def drive(history, *places, home=None):
    for x, y in places:
        history.update({'a': VehicleSnapshot(Pose2(x, y, 0.0), True, home)})


def test_home_is_the_first_pose_unless_it_is_given():
    history = VehicleHistory()
    drive(history, (1.0, 2.0), (3.0, 2.0))
    assert history.homes['a'] == Pose2(1.0, 2.0, 0.0)
    other = VehicleHistory()
    drive(other, (1.0, 2.0), home=Pose2(7.0, 7.0, 1.0))
    assert other.homes['a'] == Pose2(7.0, 7.0, 1.0)
    assert other.position('a') == (1.0, 2.0)


def test_a_trail_holds_places_apart_from_each_other():
    history = VehicleHistory()
    drive(history, (0.0, 0.0), (0.04, 0.0), (0.06, 0.0), (0.2, 0.0))
    assert history.trails['a'] == [(0.0, 0.0), (0.06, 0.0), (0.2, 0.0)]


def test_a_corrected_pose_starts_another_trail():
    history = VehicleHistory()
    drive(history, (0.0, 0.0), (2.9, 0.0))
    assert len(history.trails['a']) == 2
    drive(history, (6.0, 0.0))
    assert history.trails['a'] == [(6.0, 0.0)]


def test_a_trail_is_bounded():
    history = VehicleHistory()
    drive(history, *((0.1 * i, 0.0) for i in range(400)))
    assert len(history.trails['a']) == 300
    assert history.trails['a'][-1] == (0.1 * 399, 0.0)


def test_poses_that_are_not_finite_change_nothing():
    history = VehicleHistory()
    drive(history, (1.0, 1.0))
    history.update({'a': VehicleSnapshot(Pose2(math.nan, 0.0, 0.0))})
    history.update({'b': VehicleSnapshot(Pose2(math.inf, 0.0, 0.0))})
    assert history.poses == {'a': Pose2(1.0, 1.0, 0.0)}
    assert 'b' not in history.homes
