"""The track of a vehicle: what is ready when, clocks that jump, motion since the keyframe."""

import functools
import math

import numpy as np
import pytest

from explore_slam.agent.odometry import OdometryBuffer, Step, compound_steps
from explore_slam.agent.placement import Placement
from explore_slam.agent.vehicle_track import Keyframe, VehicleTrack, merged_steps
from explore_slam.data import LandmarkObservations, LaserScan, OdometryReading
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.registration import ScanMatcher, ScanMatchingConfig
from explore_slam.slam import OdometryNoise
from explore_slam.vision import KeyframeSelector


@pytest.fixture
def track():
    made = VehicleTrack(
        'robot1',
        Pose2(5.0, 5.0, 0.0),
        OdometryBuffer('robot1', 10.0, 2.0, 1.0),
        KeyframeSelector(),
        ScanMatcher(ScanMatchingConfig()),
        Placement('robot1', start_known=True),
    )
    for tick in range(11):
        made.odometry.add(OdometryReading(0.1 * tick, Pose2(0.05 * tick, 0.0, 0.0)))
    return made


def scan(stamp):
    return LaserScan(stamp, 0.0, 0.1, np.ones(3, np.float32), 0.0, 8.0)


def seen(stamp):
    return LandmarkObservations.empty(stamp)


def test_measurements_are_ready_when_odometry_reaches_them(track):
    for stamp in (1.1, 1.0, 0.3):
        track.wait(seen(stamp), 10)
    assert [track.next_ready(0.3).stamp for _ in range(2)] == [0.3, 1.0]
    assert track.next_ready(0.3) is None
    track.odometry.add(OdometryReading(1.2, IDENTITY))
    assert track.next_ready(0.3).stamp == 1.1
    assert track.next_ready(0.3) is None


def test_the_oldest_of_too_many_is_dropped_and_counted(track):
    for stamp in (0.1, 0.2, 0.3):
        track.wait(seen(stamp), 2)
    assert track.counts == {'dropped_without_odometry': 1}
    assert track.next_ready(0.3).stamp == 0.2


def test_scans_are_matched_when_odometry_reaches_them_oldest_first(track):
    for stamp in (0.9, 0.2, 1.05):
        track.unmatched.push(scan(stamp), 10)
    assert [track.next_to_match().stamp for _ in range(2)] == [0.2, 0.9]
    assert track.last_match_attempt == 0.9
    assert track.next_to_match() is None
    track.odometry.add(OdometryReading(1.05, IDENTITY))
    assert track.next_to_match().stamp == 1.05


@pytest.mark.parametrize(
    ('attempt', 'timeout', 'ready'),
    [
        (-np.inf, 0.3, True),  # no scans
        (0.75, 0.3, False),  # one was matched a moment ago: the next one is near
        (0.45, 0.3, True),  # too long ago: scans have ceased
        (0.8, 0.3, True),  # matched up to the stamp itself
        (0.95, 0.3, True),
        (0.75, 0.15, True),  # odometry is already further than the next scan may be
    ],
)
def test_while_scans_are_matched_measurements_wait_for_the_next_one(
    track, attempt, timeout, ready
):
    track.last_match_attempt = attempt
    track.wait(seen(0.8), 10)
    assert (track.next_ready(timeout) is not None) is ready


def test_a_restarted_clock_drops_what_waits_and_restamps_the_keyframe(track):
    track.keyframe = Keyframe(3, 0.9, Pose2(0.45, 0.0, 0.0))
    track.wait(seen(2.0), 10)
    track.wait(seen(3.0), 10)
    track.unmatched.push(scan(2.0), 10)
    track.last_scans[''], track.last_seen = (0.5, IDENTITY), 0.5
    track.matched_until = track.last_match_attempt = 0.5
    track.selector.select(0.5, IDENTITY)
    track.restart_clock()
    assert track.counts == {'dropped_by_clock_jump': 2}
    assert len(track.waiting) == len(track.unmatched) == 0
    assert track.keyframe == Keyframe(3, 1.0, Pose2(0.45, 0.0, 0.0))
    assert track.last_scans == {}
    assert track.last_seen == track.matched_until == track.last_match_attempt == -math.inf
    assert track.selector.select(0.6, IDENTITY)


def test_motion_since_the_keyframe(track):
    assert track.moved_since_keyframe(0.7) == IDENTITY
    assert track.steps_since_keyframe(0.7) == []
    track.keyframe = Keyframe(0, 0.2, track.odometry.at(0.2))
    np.testing.assert_allclose(track.moved_since_keyframe(0.75), (0.275, 0.0, 0.0), atol=1e-12)
    steps = track.steps_since_keyframe(0.75)
    assert len(steps) == 6
    assert sum(step.increment.x for step in steps) == pytest.approx(0.275)


def test_readings_that_have_left_the_buffer_are_one_step(track):
    track.keyframe = Keyframe(0, -5.0, Pose2(-2.0, 0.0, 0.0))
    steps = track.steps_since_keyframe(0.3)
    assert steps[0] == Step(Pose2(2.0, 0.0, 0.0), None)
    assert sum(step.increment.x for step in steps) == pytest.approx(2.15)


def test_merged_steps_are_few_and_the_same_motion():
    turn = Step(Pose2(0.01, 0.0, 0.02), None)
    matched = Step(Pose2(0.1, 0.0, 0.0), np.eye(3))
    steps = [turn] * 95 + [matched] * 2 + [turn] * 103
    merged = merged_steps(steps, 20)
    assert len(merged) <= 24
    assert sum(step is matched for step in merged) == 2
    ends = [
        functools.reduce(Pose2.compose, [s.increment for s in many]) for many in (steps, merged)
    ]
    np.testing.assert_allclose(*ends, atol=1e-12)
    assert merged_steps(steps[:20], 20) == steps[:20]
    assert merged_steps([], 20) == []


def test_compounded_steps_have_their_own_covariance_or_that_of_the_noise_model():
    noise = OdometryNoise()
    forward = Pose2(1.0, 0.0, 0.0)
    own = np.diag([0.1, 0.2, 0.3])
    pose, covariance = compound_steps(
        Pose2(0.0, 0.0, math.pi / 2), np.zeros((3, 3)), [Step(forward, own)], noise
    )
    np.testing.assert_allclose(pose, (0.0, 1.0, math.pi / 2), atol=1e-12)
    np.testing.assert_allclose(covariance, np.diag([0.2, 0.1, 0.3]), atol=1e-12)
    _, modelled = compound_steps(IDENTITY, np.zeros((3, 3)), [Step(forward, None)], noise)
    np.testing.assert_allclose(modelled, noise.covariance(forward))
