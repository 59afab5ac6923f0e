"""Vehicles that have a plan and do not move."""

import math

import pytest

from explore_slam.exploration.records import VehicleSnapshot
from explore_slam.exploration.standstill import Standstill
from explore_slam.geometry import Pose2


def still_after(times, poses, driving=True, timeout=30.0):
    found = Standstill(timeout)
    states = []
    for now, pose in zip(times, poses, strict=True):
        states.append('a' in found.update(now, {'a': VehicleSnapshot(pose)}, {'a': driving}))
    return states


HERE = Pose2(1.0, 1.0, 0.0)


def test_a_vehicle_that_does_not_move_for_the_timeout_stands_still():
    assert still_after([0.0, 10.0, 29.0, 30.0, 40.0], [HERE] * 5) == [False] * 3 + [True] * 2


def test_a_vehicle_without_anywhere_to_go_does_not():
    assert not any(still_after([0.0, 40.0, 80.0], [HERE] * 3, driving=False))


@pytest.mark.parametrize(
    ('moved', 'still'),
    [
        (Pose2(1.05, 1.0, 0.1), True),
        (Pose2(1.15, 1.0, 0.0), False),
        (Pose2(1.0, 1.0, 0.3), False),
    ],
)
def test_driving_and_turning_are_motion_and_the_jitter_of_a_pose_is_not(moved, still):
    assert still_after([0.0, 20.0, 31.0], [HERE, moved, moved])[-1] is still


def test_it_counts_again_as_soon_as_it_moves():
    away = Pose2(2.0, 1.0, 0.0)
    assert still_after([0.0, 30.0, 31.0, 32.0], [HERE, HERE, HERE, away])[-2:] == [True, False]


def test_another_chance_comes_after_a_while_and_then_after_twice_as_long():
    times = [float(t) for t in range(0, 400, 5)]
    states = still_after(times, [HERE] * len(times))
    changes = [
        t
        for t, before, now in zip(times[1:], states, states[1:], strict=False)
        if before is not now
    ]
    assert changes == [30.0, 90.0, 120.0, 240.0, 270.0]


def test_a_pose_that_is_not_known_is_no_standstill():
    lost = Pose2(math.nan, 0.0, 0.0)
    assert not any(still_after([0.0, 40.0, 80.0], [lost] * 3))
