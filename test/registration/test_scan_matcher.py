"""Laser odometry: matches where wheel odometry is far off, refusals, and a consistent error."""

import math

import numpy as np
import pytest
from registration.ray_caster import box, polyline, scan_of

from explore_slam.data import LaserScan
from explore_slam.errors import RegistrationError
from explore_slam.geometry import IDENTITY, Pose2, planar_rotation
from explore_slam.registration import (
    Refusal,
    RefusedScan,
    ScanMatch,
    ScanMatcher,
    ScanMatchingConfig,
)
from explore_slam.registration.alignment import Alignment
from explore_slam.registration.scan_matcher import _scan_match, _window
from explore_slam.slam.checks import check_motion_covariance

ROOM = np.vstack(
    [box(-4.0, -3.0, 4.0, 3.0), polyline((1.0, -3.0), (1.0, -1.0), (2.0, -1.0)),
     box(-2.5, 1.0, -1.5, 2.0)]
)  # fmt: skip
CORRIDOR = np.vstack([polyline((-50.0, 1.0), (50.0, 1.0)), polyline((-50.0, -1.0), (50.0, -1.0))])
WHEELS = np.diag([0.05, 0.05, 0.05]) ** 2


def started(world, pose=IDENTITY):
    matcher = ScanMatcher(ScanMatchingConfig())
    first = matcher.match(scan_of(world, pose), IDENTITY, pose, WHEELS)
    assert first == RefusedScan(Refusal.FIRST, pose)
    assert matcher.started
    return matcher


@pytest.mark.parametrize('seed', range(4))
def test_with_a_weak_prior_the_way_along_a_corridor_stays_open(seed):
    matcher = ScanMatcher(ScanMatchingConfig(), open_ended=True)
    random = np.random.default_rng(seed)
    weak = np.diag([3.0, 0.05, 0.05]) ** 2
    for number in range(12):
        prior = Pose2(0.1 * number, 0.02, 0.01) if number else IDENTITY
        scan = scan_of(CORRIDOR, Pose2(0.3 * number, 0.0, 0.0), 0.01, random)
        match = matcher.match(scan, IDENTITY, prior, weak)
        if number:
            assert isinstance(match, ScanMatch)
            assert match.pose.x == pytest.approx(prior.x, abs=0.05)
            assert match.pose.y == pytest.approx(0.0, abs=0.02)
            assert math.sqrt(match.covariance[0, 0]) > 1.0
            assert math.sqrt(match.covariance[1, 1]) < 0.05


@pytest.mark.parametrize('turn', [math.radians(10.0), math.radians(-10.0)])
@pytest.mark.parametrize('shift', [(0.5, 0.0), (-0.3, 0.4), (0.0, -0.5)])
def test_wheels_that_are_off_by_half_a_metre_and_ten_degrees_are_put_right(shift, turn):
    """Also where wheel odometry claims to be far better than it is."""
    true = Pose2(0.3, -0.2, 0.2)
    prior = Pose2(true.x + shift[0], true.y + shift[1], true.theta + turn)
    for deviation in (0.2, 0.03):
        matcher = started(ROOM)
        scan = scan_of(ROOM, true, 0.01, np.random.default_rng(5))
        match = matcher.match(scan, IDENTITY, prior, deviation**2 * np.eye(3))
        assert isinstance(match, ScanMatch)
        off = np.abs(true.between(match.pose))
        assert off[:2].max() < 0.02
        assert off[2] < 0.01
        assert match.overlap > 0.8
        assert np.sqrt(np.diag(match.covariance)).max() < 0.05


def test_the_mount_of_the_laser_counts():
    laser, matcher = Pose2(0.2, 0.0, 0.3), ScanMatcher(ScanMatchingConfig())
    matcher.match(scan_of(ROOM, laser), laser, IDENTITY, WHEELS)
    true, prior = Pose2(0.1, 0.1, -0.2), Pose2(0.0, 0.0, -0.1)
    match = matcher.match(scan_of(ROOM, true.compose(laser)), laser, prior, WHEELS)
    np.testing.assert_allclose(match.pose, true, atol=0.01)


def test_along_a_corridor_the_error_of_the_wheels_stays_and_is_a_random_walk():
    matcher = started(CORRIDOR)
    prior, random = Pose2(0.5, 0.08, 0.05), np.random.default_rng(2)
    match = matcher.match(
        scan_of(CORRIDOR, Pose2(0.6, 0.0, 0.0), 0.01, random), IDENTITY, prior, WHEELS
    )
    assert match.pose.x == pytest.approx(0.5, abs=0.02)
    assert match.pose.y == pytest.approx(0.0, abs=0.01)
    assert match.pose.theta == pytest.approx(0.0, abs=0.005)
    drift, white = np.sqrt(np.diag(match.drift)), np.sqrt(np.diag(match.white))
    assert drift[0] > 0.7 * 0.05
    assert drift[1] < 0.3 * 0.05
    assert white[0] < drift[0]
    matcher = started(ROOM)
    for x in (0.25, 0.5, 0.75, 1.0):
        pose = Pose2(x, 0.0, 0.0)
        in_room = matcher.match(scan_of(ROOM, pose), IDENTITY, pose, WHEELS)
    assert (np.diag(in_room.drift) < 0.6 * np.diag(in_room.white)).all()


def test_what_lies_on_nothing_known_is_refused_and_does_not_enter_the_map():
    matcher = started(ROOM)
    elsewhere = scan_of(box(-0.7, -9.0, 0.9, 12.0), IDENTITY)
    refused = matcher.match(elsewhere, IDENTITY, Pose2(0.3, 0.0, 0.0), WHEELS)
    assert refused == RefusedScan(Refusal.LITTLE_OVERLAP, Pose2(0.3, 0.0, 0.0))
    back = matcher.match(scan_of(ROOM, IDENTITY), IDENTITY, Pose2(0.1, 0.0, 0.05), WHEELS)
    np.testing.assert_allclose(back.pose, IDENTITY, atol=0.01)
    assert back.overlap > 0.95


def test_a_place_that_only_a_refused_scan_has_seen_is_matched_with_that_scan():
    """The vehicle goes through a door: nothing of the old map is in sight any more."""
    matcher = started(ROOM)
    beyond = box(20.0, -2.0, 26.0, 2.5)
    first, second = Pose2(22.0, 0.0, 0.0), Pose2(22.3, 0.1, 0.1)
    refused = matcher.match(scan_of(beyond, first), IDENTITY, first, WHEELS)
    assert isinstance(refused, RefusedScan)
    prior = second.compose(Pose2(0.05, -0.04, 0.05))
    match = matcher.match(scan_of(beyond, second), IDENTITY, prior, WHEELS)
    np.testing.assert_allclose(match.pose, second, atol=0.01)


def test_the_map_begins_anew_with_the_third_scan_that_nothing_matches():
    matcher = started(ROOM)
    worlds = box(-0.7, -9.0, 0.9, 12.0), box(-9.0, -0.8, 11.0, 0.7), box(-13.0, -12.0, 14.0, 15.0)
    for number, world in enumerate(worlds, start=1):
        refused = matcher.match(scan_of(world, IDENTITY), IDENTITY, IDENTITY, WHEELS)
        assert isinstance(refused, RefusedScan)
        assert matcher.restarts == number // 3
    last = worlds[-1]
    match = matcher.match(scan_of(last, Pose2(0.1, 0.0, 0.0)), IDENTITY, IDENTITY, WHEELS)
    np.testing.assert_allclose(match.pose, (0.1, 0.0, 0.0), atol=0.01)
    assert matcher.restarts == 1


@pytest.mark.parametrize('value', [np.inf, -np.inf, np.nan, 0.0])
def test_scans_without_returns_change_nothing(value):
    matcher = started(ROOM)
    empty = LaserScan(1.0, -1.5, 0.01, np.full(300, value, np.float32), 0.0, 8.0)
    for _ in range(5):
        refused = matcher.match(empty, IDENTITY, IDENTITY, WHEELS)
        assert refused == RefusedScan(Refusal.FEW_RETURNS, IDENTITY)
    after = matcher.match(scan_of(ROOM, IDENTITY), IDENTITY, Pose2(0.05, 0.0, 0.0), WHEELS)
    np.testing.assert_allclose(after.pose, IDENTITY, atol=0.005)


def test_a_drive_drifts_far_less_than_wheel_odometry_and_its_error_is_consistent():
    """The chain of drifts explains the error of the end, the white errors that of each pose."""
    noise = np.array([0.02, 0.01, 0.02])
    distances, ends = [], []
    for seed in range(6):
        random = np.random.default_rng(seed)
        matcher, true, chain, wheels = started(ROOM), IDENTITY, IDENTITY, IDENTITY
        walk = np.zeros((3, 3))  # of the error in the vehicle frame
        for step in range(80):
            move = Pose2(0.08 if step % 40 < 20 else -0.08, 0.0, 0.12 if step % 30 < 15 else -0.12)
            told = Pose2(*(np.array(move) + noise * random.normal(size=3)))
            true, wheels, prior = true.compose(move), wheels.compose(told), chain.compose(told)
            result = matcher.match(
                scan_of(ROOM, true, 0.01, random), IDENTITY, prior, np.diag(noise**2)
            )
            assert isinstance(result, ScanMatch)
            moved = chain.between(result.pose)
            c, s = math.cos(moved.theta), math.sin(moved.theta)
            axes = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
            lever = np.eye(3)
            lever[:2, 2] = [-moved.y, moved.x]
            walk = axes @ lever @ walk @ lever.T @ axes.T + result.drift
            chain = result.pose
            if step >= 20:
                off = np.array(true.between(chain))
                distances.append(off @ np.linalg.solve(walk + result.white, off))
        ends.append((math.hypot(*true.between(chain)[:2]), math.hypot(*true.between(wheels)[:2])))
    matched, dead_reckoned = np.mean(ends, axis=0)
    assert matched < 0.015
    assert matched < 0.06 * dead_reckoned
    assert 0.3 < np.mean(distances) < 6.0


def test_errors_of_a_match_are_covariances_whatever_the_rounding():
    """Along a corridor, one direction is measured well and another one hardly at all."""
    random = np.random.default_rng(0)
    for _ in range(500):
        jacobian = random.normal(size=(360, 3)) * 10.0 ** random.uniform(1.0, 4.0)
        jacobian[:, 0] *= 10.0 ** -random.uniform(3.0, 9.0)
        turn = planar_rotation(random.uniform(0.0, math.tau))
        information = turn @ jacobian.T @ jacobian @ turn.T
        odometry = np.diag(10.0 ** random.uniform(-7.0, -2.0, 3))
        match = _scan_match(Alignment(IDENTITY, information, 1.0, 0.0, 360, 1.0), odometry, False)
        for covariance in (match.white, match.drift):
            check_motion_covariance('error', covariance)
        total = np.linalg.inv(information + np.linalg.inv(odometry))
        np.testing.assert_allclose(
            match.covariance, total, rtol=0.0, atol=1e-3 * np.abs(total).max()
        )


def test_all_poses_share_the_error_of_the_first_scan_and_their_drift_covers_it():
    """The mean over many matches with one scan is off by the error of that scan."""
    noise, steps, squares = np.array([0.02, 0.02, 0.02]), 24, []
    for seed in range(40):
        random = np.random.default_rng(seed)
        matcher = ScanMatcher(ScanMatchingConfig())
        matcher.match(scan_of(ROOM, IDENTITY, 0.01, random), IDENTITY, IDENTITY, np.diag(noise**2))
        true, chain, drift, offsets, white = IDENTITY, IDENTITY, np.zeros((3, 3)), [], []
        for step in range(steps):
            move = Pose2(0.02 if step % 2 else -0.02, 0.0, 0.0)
            true = true.compose(move)
            prior = chain.compose(Pose2(*(np.array(move) + noise * random.normal(size=3))))
            match = matcher.match(
                scan_of(ROOM, true, 0.01, random), IDENTITY, prior, np.diag(noise**2)
            )
            chain, drift = match.pose, drift + match.drift
            offsets.append(true.between(chain))
            white.append(match.white)
        late = slice(steps // 2, steps)
        off = np.mean(offsets[late], axis=0)
        covariance = drift + np.mean(white[late], axis=0) / (steps // 2)
        squares.append(off @ np.linalg.solve(covariance, off))
    assert 1.0 < np.mean(squares) < 4.5  # 3 in the mean, by the noise of a mean of 40


@pytest.mark.parametrize('independent', [1.0, 0.6, 0.05])
def test_the_window_drifts_by_errors_that_scans_share(independent):
    information = np.diag([4e5, 1e5, 1e6])
    found = Alignment(IDENTITY, information, 1.0, 0.0, 360, independent)
    odometry = np.diag([0.02, 0.02, 0.02]) ** 2
    still, moved = (_scan_match(found, odometry, window_moved) for window_moved in (False, True))
    assert not still.window.any()
    np.testing.assert_allclose(moved.window, 0.7 * (1.0 - independent) * moved.white)
    np.testing.assert_allclose(moved.drift - moved.window, still.drift, atol=1e-12)
    np.testing.assert_allclose(moved.white, still.white)


def test_the_window_covers_three_deviations_of_the_odometry_within_limits():
    window = _window(IDENTITY, np.diag([0.02, 0.04, 0.05]) ** 2)
    assert (window.reach, window.turn) == pytest.approx((0.12 + 0.1, 0.15 + 0.03))
    # at two standard deviations the score is lower by 0.025
    assert window.position_penalty * 0.08**2 == pytest.approx(0.025)
    assert window.heading_penalty * 0.1**2 == pytest.approx(0.025)
    exact, unknown = (_window(IDENTITY, d**2 * np.eye(3)) for d in (1e-6, 10.0))
    assert (exact.reach, exact.turn) == pytest.approx((0.1, 0.03), abs=1e-5)
    assert (unknown.reach, unknown.turn) == (0.6, 0.5)


def test_other_vehicles_are_masked():
    matcher = started(ROOM)
    body = np.vstack([ROOM, box(0.8, -0.6, 1.4, 0.6)])
    true = Pose2(0.1, 0.0, 0.0)
    hidden = matcher.match(
        scan_of(body, true), IDENTITY, IDENTITY, WHEELS, bodies=[(1.0, 0.0, 0.8)]
    )
    assert hidden.overlap > 0.97
    np.testing.assert_allclose(hidden.pose, true, atol=0.01)


def test_forgotten_scans_are_not_matched_with():
    matcher = started(ROOM)
    matcher.reset()
    assert not matcher.started
    refused = matcher.match(scan_of(ROOM, IDENTITY), IDENTITY, IDENTITY, WHEELS)
    assert refused.reason is Refusal.FIRST


def test_results_are_the_same_bit_for_bit():
    def poses():
        matcher, random = ScanMatcher(ScanMatchingConfig()), np.random.default_rng(3)
        return [
            matcher.match(
                scan_of(ROOM, Pose2(0.1 * k, 0.0, 0.05 * k), 0.02, random),
                IDENTITY, Pose2(0.11 * k, 0.0, 0.04 * k), WHEELS,
            ).pose
            for k in range(6)
        ]  # fmt: skip

    assert poses() == poses()


@pytest.mark.parametrize(
    ('prior', 'covariance', 'message'),
    [
        (Pose2(math.nan, 0.0, 0.0), WHEELS, 'prior is'),
        (IDENTITY, np.full((3, 3), np.nan), 'covariance'),
        (IDENTITY, np.eye(2), r'shape \(2, 2\)'),
        (IDENTITY, np.diag([1.0, -1.0, 1.0]), 'negative variance'),
    ],
)
def test_bad_input_is_named_and_changes_nothing(prior, covariance, message):
    matcher = started(ROOM)
    with pytest.raises(RegistrationError, match=message):
        matcher.match(scan_of(ROOM, IDENTITY), IDENTITY, prior, covariance)
    match = matcher.match(scan_of(ROOM, IDENTITY), IDENTITY, IDENTITY, WHEELS)
    np.testing.assert_allclose(match.pose, IDENTITY, atol=1e-3)
