"""The odometry buffer: interpolation, late readings, resets of the base, clocks that jump back."""

import math

import numpy as np
import pytest

from explore_slam.agent.odometry import OdometryBuffer, interpolate
from explore_slam.data import OdometryReading
from explore_slam.geometry import IDENTITY, Pose2

ZERO = np.zeros((3, 3))


@pytest.fixture
def buffer():
    made = OdometryBuffer('robot1', duration=10.0, jump_speed=2.0, clock_jump_threshold=1.0)
    for tick in range(11):
        made.add(OdometryReading(0.1 * tick, Pose2(0.05 * tick, 0.0, 0.0)))
    return made


def test_poses_are_interpolated_and_held_at_the_ends(buffer):
    assert buffer.at(0.25).x == pytest.approx(0.125)
    assert buffer.at(-5.0) == buffer.at(0.0)
    assert buffer.at(99.0).x == pytest.approx(0.5)


def test_velocity_is_that_around_a_stamp(buffer):
    assert buffer.velocity(0.5) == pytest.approx([0.5, 0.0, 0.0])
    assert buffer.velocity(1.0) == pytest.approx([0.5, 0.0, 0.0])  # of the last readings
    assert buffer.velocity(9.0) == pytest.approx([0.0, 0.0, 0.0])  # nothing is known
    made = OdometryBuffer('robot1', 10.0, 2.0, 1.0)
    assert made.velocity(0.0) == pytest.approx([0.0, 0.0, 0.0])
    for tick in range(4):
        made.add(OdometryReading(0.1 * tick, Pose2(0.0, 0.0, 3.05 + 0.1 * tick)))
    assert made.velocity(0.15) == pytest.approx([0.0, 0.0, 1.0])


def test_headings_turn_the_short_way():
    made = OdometryBuffer('robot1', 10.0, 2.0, 1.0)
    made.add(OdometryReading(0.0, Pose2(0.0, 0.0, math.pi - 0.1)))
    made.add(OdometryReading(1.0, Pose2(0.0, 0.0, -math.pi + 0.1)))
    assert abs(made.at(0.5).theta) == pytest.approx(math.pi)


def test_steps_compose_to_the_whole_way(buffer):
    pose = buffer.at(0.13)
    for step in buffer.steps(0.13, 0.87):
        pose = pose.compose(step.increment)
    assert tuple(pose) == pytest.approx(tuple(buffer.at(0.87)))
    assert len(buffer.steps(0.13, 0.87)) == 8


def test_late_and_repeated_readings_are_counted_and_left_out(buffer):
    assert not buffer.add(OdometryReading(0.95, Pose2(9.0, 9.0, 0.0)))
    assert not buffer.add(OdometryReading(1.0, Pose2(9.0, 9.0, 0.0)))
    assert buffer.pose.x == pytest.approx(0.5)


def test_a_reset_of_the_base_is_not_motion(buffer, caplog):
    buffer.add(OdometryReading(1.1, IDENTITY))
    buffer.add(OdometryReading(1.2, Pose2(50.0, 0.0, 0.0)))
    assert buffer.pose.x == pytest.approx(0.5)
    assert 'reset of the base' in caplog.text
    buffer.add(OdometryReading(1.3, Pose2(50.05, 0.0, 0.0)))
    assert buffer.pose.x == pytest.approx(0.55)


def test_a_clock_that_jumps_back_goes_on_from_the_same_pose(caplog):
    made = OdometryBuffer('robot1', 10.0, 2.0, 1.0)
    made.add(OdometryReading(100.0, Pose2(3.0, 4.0, 1.0)))
    made.add(OdometryReading(5.0, IDENTITY))
    made.add(OdometryReading(5.1, Pose2(0.1, 0.0, 0.0)))
    assert 'went back from 100.000 s to 5.000 s' in caplog.text
    expected = Pose2(3.0, 4.0, 1.0).compose(Pose2(0.1, 0.0, 0.0))
    assert tuple(made.pose) == pytest.approx(tuple(expected))
    assert made.first == 5.0


@pytest.mark.parametrize(
    ('last', 'number', 'reading', 'restarted'),
    [
        (7, 0, Pose2(0.0, 0.0, 0.0), True),  # the computer of the vehicle was rebooted
        (7, 3, Pose2(0.1, 0.05, 0.02), True),  # its first readings were missed
        (7, 8, Pose2(0.01, 0.0, 0.01), True),  # a simulator was reset
        (7, 8, Pose2(0.1, 0.05, 0.02), False),  # the clock was set while the driver went on
        (7, 0, Pose2(2.9, 4.1, 1.0), False),  # another publisher of the same odometry
        (None, None, Pose2(0.0, 0.0, 0.0), True),
        (None, None, Pose2(0.1, 0.05, 0.02), False),
        (None, None, Pose2(3.1, 4.0, 1.0), False),
    ],
)
def test_a_driver_that_was_restarted_with_another_clock_is_a_restart(
    last, number, reading, restarted, caplog
):
    made = OdometryBuffer('robot1', 10.0, 2.0, 1.0)
    made.add(OdometryReading(100.0, Pose2(3.0, 4.0, 1.0), number=last))
    assert made.add(OdometryReading(5.0, reading, number=number))
    assert made.restarts == int(restarted)
    assert made.pose == Pose2(3.0, 4.0, 1.0)
    assert len(caplog.records) == 1
    assert ('the driver was restarted' in caplog.text) is restarted


def test_the_buffer_is_bounded():
    made = OdometryBuffer('robot1', 10.0, 2.0, 1.0)
    for tick in range(20000):
        made.add(OdometryReading(0.01 * tick, IDENTITY))
    assert len(made) < 2500
    assert made.first < made.last - 9.9


def test_a_correction_bends_the_chain_and_all_that_follows(buffer):
    since, stamp = 0.2, 0.55
    before, after = buffer.at(0.2), buffer.at(0.6)
    measured = buffer.at(stamp).compose(Pose2(0.02, -0.01, 0.1))
    moved = buffer.at(stamp).between(after)
    covariance = 1e-4 * np.eye(3)
    buffer.correct(since, stamp, measured, covariance, ZERO, ZERO)
    assert buffer.at(0.2) == before
    np.testing.assert_allclose(buffer.at(stamp), measured)
    np.testing.assert_allclose(buffer.at(0.6), measured.compose(moved))

    steps = buffer.steps(since, stamp)
    pose = before
    for step in steps:
        pose = pose.compose(step.increment)
    np.testing.assert_allclose(pose, measured)
    np.testing.assert_allclose(sum(step.covariance for step in steps), covariance)
    late = buffer.steps(0.48, stamp)
    share = (stamp - 0.48) / (stamp - since)
    np.testing.assert_allclose(sum(step.covariance for step in late), share * covariance)
    half = buffer.at(0.375).x - 0.5 * 0.375
    assert half == pytest.approx(0.01, abs=2e-3)
    assert buffer.steps(stamp, 0.9)[-1].covariance is None

    last = buffer.pose
    raw = OdometryReading(1.1, Pose2(0.55, 0.0, 0.0))
    straight = OdometryReading(1.2, Pose2(0.6, 0.0, 0.0))
    assert buffer.add(raw)
    assert buffer.add(straight)
    step = buffer.at(1.1).between(buffer.at(1.2))
    np.testing.assert_allclose(step, (0.05, 0.0, 0.0), atol=1e-9)
    assert buffer.at(1.2).theta == pytest.approx(last.theta)


def test_a_correction_beyond_the_newest_reading_is_left_out(buffer):
    poses = [buffer.at(t) for t in (0.2, 0.9)]
    buffer.correct(0.0, 5.0, Pose2(9.0, 9.0, 0.0), np.eye(3), ZERO, ZERO)
    assert [buffer.at(t) for t in (0.2, 0.9)] == poses


def test_interpolation_is_linear_in_position_and_heading():
    a, b = Pose2(1.0, 2.0, 0.2), Pose2(3.0, -2.0, 0.6)
    assert tuple(interpolate(a, b, 0.0)) == pytest.approx(a)
    assert tuple(interpolate(a, b, 0.25)) == pytest.approx((1.5, 1.0, 0.3))
    assert tuple(interpolate(a, b, 1.0)) == pytest.approx(b)
    across = interpolate(Pose2(0.0, 0.0, 3.0), Pose2(0.0, 0.0, -3.0), 0.75)
    assert across.theta == pytest.approx(3.0 + 0.75 * (2.0 * math.pi - 6.0) - 2.0 * math.pi)


def test_poses_between_readings_divide_the_time_between_them():
    made = OdometryBuffer('robot1', 10.0, 2.0, 1.0)
    made.add(OdometryReading(1.0, Pose2(1.0, 0.0, 0.0)))
    made.add(OdometryReading(3.0, Pose2(2.0, 0.0, 0.8)))
    assert tuple(made.at(1.5)) == pytest.approx((1.25, 0.0, 0.2))
    assert made.at(3.0) == Pose2(2.0, 0.0, 0.8)
    (step,) = made.steps(1.5, 2.5)
    assert tuple(step.increment) == pytest.approx(made.at(1.5).between(made.at(2.5)))


def test_no_time_is_one_step_without_motion(buffer):
    (step,) = buffer.steps(0.35, 0.35)
    assert tuple(step.increment) == pytest.approx(IDENTITY)


def test_steps_beyond_the_newest_reading_end_there(buffer):
    steps = buffer.steps(0.95, 1.5)
    assert sum(step.increment.x for step in steps) == pytest.approx(0.025)


def test_a_correction_grows_linearly_and_so_does_its_covariance(buffer):
    measured = buffer.at(0.8)
    drift = np.diag([6e-4, 0.0, 0.0])
    buffer.correct(0.2, 0.8, Pose2(measured.x, 0.06, 0.0), drift, ZERO, ZERO)
    for stamp, offset in (
        (0.1, 0.0),
        (0.2, 0.0),
        (0.3, 0.01),
        (0.5, 0.03),
        (0.8, 0.06),
        (1.0, 0.06),
    ):
        assert buffer.at(stamp).y == pytest.approx(offset, abs=1e-12)
        assert buffer.at(stamp).x == pytest.approx(0.5 * stamp)
    steps = buffer.steps(0.2, 0.8)
    np.testing.assert_allclose([s.covariance[0, 0] for s in steps], 1e-4)
    (part,) = buffer.steps(0.32, 0.37)
    assert part.covariance[0, 0] == pytest.approx(0.5e-4)


def test_a_second_correction_is_added_to_the_first(buffer):
    buffer.correct(0.0, 0.5, Pose2(0.25, 0.1, 0.0), ZERO, ZERO, ZERO)
    buffer.correct(0.5, 1.0, Pose2(0.5, 0.3, 0.0), ZERO, ZERO, ZERO)
    assert buffer.at(0.75).y == pytest.approx(0.2, abs=0.011)
    buffer.add(OdometryReading(1.1, Pose2(0.55, 0.0, 0.0)))
    assert tuple(buffer.pose) == pytest.approx((0.55, 0.3, 0.0))


def test_a_pose_between_two_measured_ones_errs_with_both_and_like_a_bridge(buffer):
    assert buffer.white_at(0.5) is None
    first, second = np.diag([4e-4, 1e-4, 1e-6]), np.diag([1e-4, 9e-4, 4e-6])
    wheels = np.diag([2e-3, 1e-3, 1e-4])
    buffer.correct(0.0, 0.4, buffer.at(0.4), ZERO, first, wheels)
    buffer.correct(0.4, 0.8, buffer.at(0.8), ZERO, second, wheels)
    np.testing.assert_allclose(buffer.white_at(0.4), first, atol=1e-15)
    np.testing.assert_allclose(buffer.white_at(0.8), second, atol=1e-15)
    half = 0.25 * first + 0.25 * second + 0.25 * wheels
    np.testing.assert_allclose(buffer.white_at(0.6), half, atol=1e-15)
    np.testing.assert_allclose(buffer.white_at(0.2), 0.25 * first + 0.25 * wheels, atol=1e-15)
    np.testing.assert_allclose(buffer.white_at(0.9), second, atol=1e-15)  # wheel odometry goes on


def test_the_error_of_a_measured_pose_turns_with_the_vehicle():
    buffer = OdometryBuffer('robot1', 10.0, 2.0, 1.0)
    for tick, heading in enumerate((0.0, 0.0, math.pi / 2)):
        buffer.add(OdometryReading(0.1 * tick, Pose2(0.0, 0.0, heading)))
    white = np.diag([4e-4, 1e-4, 1e-6])
    buffer.correct(0.0, 0.1, buffer.at(0.1), ZERO, white, ZERO)
    np.testing.assert_allclose(buffer.white_at(0.2), np.diag([1e-4, 4e-4, 1e-6]), atol=1e-12)


def test_a_restarted_clock_forgets_measured_poses():
    buffer = OdometryBuffer('robot1', 10.0, 2.0, 1.0)
    for stamp in (20.0, 20.1):
        buffer.add(OdometryReading(stamp, IDENTITY))
    buffer.correct(20.0, 20.1, IDENTITY, ZERO, np.eye(3), ZERO)
    assert buffer.white_at(20.1) is not None
    buffer.add(OdometryReading(3.0, IDENTITY))
    assert buffer.white_at(3.0) is None


def test_nothing_is_corrected_without_time(buffer):
    before = buffer.at(0.5)
    buffer.correct(0.5, 0.5, Pose2(9.0, 9.0, 0.0), np.eye(3), ZERO, ZERO)
    assert buffer.at(0.5) == before


def test_the_speed_limit_has_some_slack_for_stamps(caplog):
    made = OdometryBuffer('robot1', 10.0, 2.0, 1.0)
    made.add(OdometryReading(0.0, IDENTITY))
    made.add(OdometryReading(0.1, Pose2(0.29, 0.0, 0.0)))
    assert made.pose.x == 0.29
    assert made.resets == 0
    made.add(OdometryReading(0.2, Pose2(0.6, 0.0, 0.0)))
    assert made.pose.x == 0.29
    assert made.resets == 1
    assert 'jumped from (0.29, 0.00) to (0.60, 0.00) in 0.100 s' in caplog.text


def test_a_clock_that_goes_back_by_less_than_the_threshold_is_late(buffer):
    assert not buffer.add(OdometryReading(0.01, IDENTITY))
    assert buffer.last == 1.0
    assert buffer.add(OdometryReading(0.0, IDENTITY))
    assert (buffer.first, buffer.last, buffer.resets) == (0.0, 0.0, 1)


def test_the_history_is_kept_for_its_duration_and_trimmed_at_twice_of_it():
    made = OdometryBuffer('robot1', 1.0, 2.0, 1.0)
    lengths = []
    for tick in range(400):
        made.add(OdometryReading(0.01 * tick, IDENTITY))
        lengths.append(len(made))
        assert made.first <= max(0.0, made.last - 0.98)
        assert made.last - made.first <= 2.0 + 1e-9
    assert max(lengths) in (201, 202)
    assert min(lengths[202:]) in (100, 101, 102)
