"""Dead reckoning: interpolation, extrapolation, resets and poses that come early or late."""

import math

import pytest

from explore_slam.data import OdometryReading
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.vehicle.dead_reckoning import DeadReckoning


def reckoning(*readings):
    made = DeadReckoning()
    for stamp, *pose in readings:
        made.add_odometry(OdometryReading(stamp, Pose2(*pose)))
    return made


def test_without_odometry_there_is_no_pose():
    made = DeadReckoning()
    assert made.pose_stamp == -math.inf
    assert made.odometry_at(3.0) == IDENTITY
    assert made.map_pose(3.0) is None


def test_interpolates_between_the_readings_around_a_stamp():
    made = reckoning(
        (0.0, 0.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0), (2.0, 2.0, 0.0, 0.4), (3.0, 5.0, 0.0, 0.4)
    )
    assert made.odometry_at(0.25) == pytest.approx(Pose2(0.25, 0.0, 0.0))
    assert made.odometry_at(1.0) == pytest.approx(Pose2(1.0, 0.0, 0.0))
    assert made.odometry_at(1.5) == pytest.approx(Pose2(1.5, 0.0, 0.2))
    assert made.odometry_at(2.9).x == pytest.approx(4.7)
    assert made.odometry_at(-1.0) == Pose2(0.0, 0.0, 0.0)  # before the first reading


def test_interpolates_in_the_frame_of_the_earlier_reading():
    made = reckoning((0.0, 1.0, 2.0, math.pi / 2), (2.0, 1.0, 4.0, math.pi / 2))
    assert made.odometry_at(0.5) == pytest.approx(Pose2(1.0, 2.5, math.pi / 2))


def test_extrapolates_at_constant_velocity_for_300_ms():
    made = reckoning((0.0, 0.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0), (2.0, 1.5, 0.0, 0.2))
    assert made.odometry_at(2.0) == Pose2(1.5, 0.0, 0.2)
    ahead = made.odometry_at(2.2)  # 0.2 of the last increment (0.5, 0, 0.2)
    assert ahead == pytest.approx(Pose2(1.5 + 0.1 * math.cos(0.2), 0.1 * math.sin(0.2), 0.24))
    assert made.odometry_at(2.3) == pytest.approx(made.odometry_at(9.0))


def test_extrapolates_at_most_three_intervals():
    made = reckoning((0.0, 0.0, 0.0, 0.0), (0.05, 0.01, 0.0, 0.0))
    assert made.odometry_at(0.3).x == pytest.approx(0.04)


def test_one_reading_holds_everywhere():
    made = reckoning((5.0, 1.0, 2.0, 0.5))
    for stamp in (4.0, 5.0, 6.0):
        assert made.odometry_at(stamp) == Pose2(1.0, 2.0, 0.5)


def test_the_map_pose_moves_with_odometry():
    made = reckoning((0.0, 0.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0), (2.0, 3.0, 0.0, 0.0))
    made.set_pose(1.0, Pose2(10.0, 5.0, math.pi / 2))
    assert made.pose_stamp == 1.0
    assert made.map_pose(2.0) == pytest.approx(Pose2(10.0, 7.0, math.pi / 2))


def test_a_pose_waits_for_the_odometry_of_its_time():
    made = reckoning((0.0, 0.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0))
    made.set_pose(1.31, Pose2(9.0, 0.0, 0.0))
    assert made.map_pose(1.0) is None
    made.add_odometry(OdometryReading(1.31, Pose2(1.2, 0.0, 0.0)))
    assert made.map_pose(1.31) == pytest.approx(Pose2(9.0, 0.0, 0.0))
    made.set_pose(1.6, Pose2(20.0, 0.0, 0.0))  # within what can be extrapolated
    assert made.pose_stamp == 1.6
    early = DeadReckoning()
    early.set_pose(0.0, Pose2(4.0, 0.0, 0.0))
    early.add_odometry(OdometryReading(0.1, Pose2(7.0, 0.0, 0.0)))
    assert early.map_pose(0.1) == pytest.approx(Pose2(4.0, 0.0, 0.0))


def test_a_pose_older_than_all_odometry_is_ignored():
    made = reckoning((10.0, 0.0, 0.0, 0.0), (11.0, 1.0, 0.0, 0.0))
    made.set_pose(9.6, Pose2(5.0, 0.0, 0.0))
    assert made.map_pose(11.0) is None
    made.set_pose(10.0 - 0.3, Pose2(5.0, 0.0, 0.0))
    assert made.map_pose(11.0) == pytest.approx(Pose2(6.0, 0.0, 0.0))


def test_a_minute_of_odometry_is_kept():
    made = reckoning(*((0.5 * k, 0.1 * k, 0.0, 0.0) for k in range(201)))  # 100 s
    made.set_pose(39.0, Pose2(0.0, 0.0, 0.0))
    assert made.map_pose(100.0) is None
    made.set_pose(40.5, Pose2(0.0, 0.0, 0.0))
    assert made.map_pose(100.0) == pytest.approx(Pose2(20.0 - 8.1, 0.0, 0.0))


@pytest.mark.parametrize(
    ('stamp', 'x', 'resets'),
    [(0.5, 0.0, True), (1.5, 2.4, False), (1.5, 2.6, True), (1.5, -2.6, True)],
)
def test_a_jump_in_time_or_position_is_a_reset(stamp, x, resets):
    """More than 1 m beyond 3 m/s since the last reading, or a stamp that is older."""
    made = reckoning((0.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    made.set_pose(1.0, Pose2(3.0, 0.0, 0.0))
    made.add_odometry(OdometryReading(stamp, Pose2(x, 0.0, 0.0)))
    assert (made.map_pose(stamp) is None) == resets
    assert (made.pose_stamp == -math.inf) == resets
    assert made.odometry_at(stamp).x == x


def test_a_repeated_stamp_is_ignored():
    made = reckoning((0.0, 0.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0), (1.0, 50.0, 0.0, 0.0))
    assert made.odometry_at(1.0) == Pose2(1.0, 0.0, 0.0)
