"""Restarts of a driver against ordinary driving: from zero is no motion, through zero is motion.

A restart begins at zero after a gap; lost messages leave a gap too, and a vehicle may drive
through the place where its odometry began. The numbers of the messages tell the two apart; without
them, only zero itself, or what the base cannot have driven, is a restart.
"""

import math
from itertools import pairwise

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from explore_slam.agent.odometry import OdometryBuffer
from explore_slam.data import OdometryReading
from explore_slam.geometry import IDENTITY, Pose2

EXACT = 0.005  # m and rad from zero; a driver that has just started reads zero
LAST = Pose2(4.95, 0.0, 1.0)


def empty():
    return OdometryBuffer('robot1', 30.0, 3.0, 1.0)


def drive_to(buffer, last, duration=2.0, numbered=False):
    """Drive from zero to a pose, with readings at 20 Hz; return stamp and number of the last."""
    count = round(20 * duration)
    for k in range(count + 1):
        s = k / count
        pose = Pose2(s * last.x, s * last.y, s * last.theta)
        buffer.add(OdometryReading(0.05 * k, pose, number=100 + k if numbered else None))
    return 0.05 * count, 100 + count


def add(buffer, stamp, pose, number=None):
    buffer.add(OdometryReading(stamp, pose, number=number))


# -- restarts ------------------------------------------------------------------------------------


@pytest.mark.parametrize('gap', [0.5, 2.0, 30.0])
@pytest.mark.parametrize('last', [LAST, Pose2(0.05, 0.0, 2.5), Pose2(1, 1, -3)])
def test_odometry_from_zero_after_a_gap_is_no_motion(gap, last, caplog):
    made = empty()
    drive_to(made, last)
    add(made, 2.0 + gap, IDENTITY)
    assert tuple(made.pose) == pytest.approx(tuple(last))
    assert (made.restarts, made.resets) == (1, 1)
    assert caplog.text.count('the driver was restarted') == 1
    add(made, 2.1 + gap, Pose2(0.1, 0.0, 0.2))
    assert tuple(made.pose) == pytest.approx(tuple(last.compose(Pose2(0.1, 0.0, 0.2))))
    assert made.resets == 1


@given(
    last=st.tuples(st.floats(-20, 20), st.floats(-20, 20), st.floats(-3.1, 3.1)),
    gap=st.floats(0.41, 600.0),
    speed=st.floats(0.1, 2.0),
    number=st.sampled_from([None, 1, 3, 100, 'next']),
)
def test_whatever_the_gap_and_the_pose_before_a_start_from_zero_is_no_motion(
    last, gap, speed, number
):
    made, last = empty(), Pose2(*last)
    assume(math.hypot(last.x, last.y) > 0.07 or abs(last.theta) > 0.07)
    duration = max(math.hypot(last.x, last.y) / speed, abs(last.theta), 1.0)
    stamp, before = drive_to(made, last, duration, numbered=number is not None)
    add(made, stamp + gap, IDENTITY, before + 1 if number == 'next' else number)
    assert tuple(made.pose) == pytest.approx(tuple(last))
    assert made.restarts == 1


@pytest.mark.parametrize(
    ('gap', 'first'),
    [
        (0.5, Pose2(0.03, 0.0, 0.0)),  # the first readings were lost
        (2.0, Pose2(0.03, 0.0, 0.0)),
        (2.0, Pose2(0.0, 0.0, 0.03)),  # the gyroscope drifts
        (2.0, Pose2(0.0, 0.0, 1.0)),  # the heading of an IMU, kept
        (30.0, Pose2(0.3, 0.0, 0.0)),  # it has driven since
    ],
)
def test_a_restart_is_recognized_although_the_first_readings_are_missed(gap, first):
    for number in (4, 145):  # of a new publisher, and of one that outlives the driver, as a relay
        made = empty()
        drive_to(made, LAST, numbered=True)
        add(made, 2.0 + gap, first, number=number)
        assert tuple(made.pose) == pytest.approx(tuple(LAST))
        assert (made.restarts, made.resets) == (1, 1)


def test_without_numbers_what_the_base_cannot_have_driven_is_a_restart():
    for first, restarts in ((Pose2(0.03, 0.0, 0.02), 1), (Pose2(1.5, 0.0, 0.5), 0)):
        made = empty()
        stamp, _ = drive_to(made, LAST, duration=20.0)
        add(made, stamp + 1.0, first)
        assert made.restarts == restarts


def test_a_publisher_that_begins_anew_elsewhere_is_a_restart():
    made = empty()
    stamp, _ = drive_to(made, LAST, duration=20.0, numbered=True)
    add(made, stamp + 2.0, Pose2(-5.0, 1.0, 0.0), number=1)
    assert (made.restarts, made.resets) == (1, 1)
    assert tuple(made.pose) == pytest.approx(tuple(LAST))


def test_a_base_that_counts_on_while_its_driver_restarts_has_moved():
    made = empty()
    stamp, _ = drive_to(made, LAST, duration=20.0, numbered=True)
    add(made, stamp + 5.0, Pose2(4.5, 0.2, 0.9), number=1)
    assert made.resets == 0
    assert made.pose == Pose2(4.5, 0.2, 0.9)


@pytest.mark.parametrize(
    ('gap', 'last'),
    [
        (0.05, Pose2(0.2, 0.0, 0.2)),
        (0.05, Pose2(0.0, 0.0, 0.25)),
        (0.2, Pose2(0.6, 0.0, 0.3)),
        (0.3, Pose2(0.0, 0.0, 2.5)),
        (0.39, Pose2(0.6, 0.0, 0.3)),
    ],
)
def test_a_reset_of_the_base_is_no_motion_although_it_is_slower_than_the_limit(gap, last):
    made = empty()
    drive_to(made, last, duration=6.0)
    add(made, 6.0 + gap, IDENTITY)
    assert tuple(made.pose) == pytest.approx(tuple(last))
    assert (made.restarts, made.resets) == (0, 1)


# -- ordinary driving ----------------------------------------------------------------------------


def shuttle(speed, _rate):
    """Drive back and forth along x through the origin, always facing the same way."""
    span = 4.0

    def pose(t):
        s = (speed * t + 1.0) % (2.0 * span)
        return Pose2(min(s, 2.0 * span - s) - 0.5 * span, 0.0, 0.0)

    return pose


def circle(speed, turn_rate):
    """Drive in circles through the origin, where the heading is 0."""
    radius = speed / turn_rate

    def pose(t):
        angle = turn_rate * t + 1.0
        heading = math.remainder(angle, math.tau)
        return Pose2(radius * math.sin(angle), radius * (1.0 - math.cos(angle)), heading)

    return pose


def spin(_speed, turn_rate):
    """Turn on the spot at the origin, to and fro."""

    def pose(t):
        s = (turn_rate * t + 0.5) % (4.0 * math.pi)
        return Pose2(0.0, 0.0, math.remainder(min(s, 4.0 * math.pi - s), math.tau))

    return pose


def home_and_back(speed, _turn_rate):
    """Drive 3 m away, back to the start, rest there, and again."""
    leg, rest = 3.0 / speed, 4.0

    def pose(t):
        t %= 2.0 * leg + rest
        return Pose2(min(speed * t, max(6.0 - speed * t, 0.0)), 0.0, 0.0)

    return pose


DRIVES = st.builds(
    lambda kind, speed, rate: kind(speed, rate),
    st.sampled_from([shuttle, circle, spin, home_and_back]),
    st.floats(0.1, 2.0),
    st.floats(0.2, 3.0),
)
RATES = st.sampled_from([1.0, 2.0, 5.0, 10.0, 20.0, 50.0])  # Hz


def readings(drive, rate, jitter):
    """Return readings of 40 s or more, whose stamps are as late as the jitter (s) says."""
    count = max(int(40 * rate), 40)
    return [
        OdometryReading(k / rate + jitter[k % len(jitter)] / rate, drive(k / rate), number=k + 1)
        for k in range(count)
    ]


JITTERS = st.lists(st.floats(0.0, 0.3), min_size=1, max_size=7)


@given(drive=DRIVES, rate=RATES, jitter=JITTERS, numbered=st.booleans())
def test_driving_through_the_origin_is_motion(drive, rate, jitter, numbered):
    made = empty()
    for one in readings(drive, rate, jitter):
        add(made, one.stamp, one.pose, one.number if numbered else None)
        assert made.resets == 0
        assert made.pose == one.pose


@given(
    drive=DRIVES,
    rate=RATES,
    start=st.floats(2.0, 25.0),
    duration=st.floats(0.0, 10.0),
    loss=st.floats(0.0, 0.3),
    random=st.randoms(use_true_random=False),
)
def test_lost_readings_are_no_restart_wherever_the_vehicle_is_then(
    drive, rate, start, duration, loss, random
):
    """Wifi gaps of up to 10 s, and up to 30 % of the readings lost besides."""
    made = empty()
    for one in readings(drive, rate, [0.0]):
        if start <= one.stamp < start + duration or random.random() < loss:
            continue
        add(made, one.stamp, one.pose, one.number)
        assert made.restarts == 0
        assert made.resets == 0
        assert made.pose == one.pose


@given(drive=DRIVES, rate=RATES, start=st.floats(2.0, 25.0), duration=st.floats(1.0, 10.0))
def test_without_numbers_a_gap_is_no_restart_unless_it_ends_at_zero(drive, rate, start, duration):
    made, sent = empty(), readings(drive, rate, [0.0])
    heard = [one for one in sent if not start <= one.stamp < start + duration]
    for before, one in pairwise(heard):
        at_zero = math.hypot(one.pose.x, one.pose.y) <= EXACT and (
            abs(one.pose.theta) <= EXACT or math.hypot(before.pose.x, before.pose.y) > 0.3
        )
        if at_zero and one.stamp - before.stamp > 0.39:
            return  # nothing tells it from a restart
        add(made, one.stamp, one.pose)
        assert made.resets == 0


@pytest.mark.parametrize('interval', [0.05, 0.2, 1.0])
def test_a_vehicle_that_returns_to_its_start_is_no_restart(interval):
    made = empty()
    for k in range(-40, 41):
        add(made, interval * (k + 40), Pose2(0.5 * interval * k, 0.0, 0.0))
    assert (made.restarts, made.resets) == (0, 0)
    assert made.pose.x == pytest.approx(20.0 * interval)


def test_a_gap_far_from_zero_is_no_restart():
    made = empty()
    drive_to(made, Pose2(4.0, 0.0, 0.0))
    add(made, 4.0, Pose2(1.0, 0.0, 0.0))
    assert (made.restarts, made.resets) == (0, 0)
    assert made.pose.x == pytest.approx(1.0)


def test_a_heading_that_jumps_is_no_motion(caplog):
    made = empty()
    add(made, 0.0, IDENTITY)
    add(made, 0.1, Pose2(0.0, 0.0, 0.2))
    add(made, 0.2, Pose2(0.0, 0.0, -2.5))
    assert made.pose.theta == pytest.approx(0.2)
    assert 'reset of the base' in caplog.text
