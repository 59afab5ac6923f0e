"""Relocalization: the pose that most matches agree on, within reach, or none."""

import numpy as np
import pytest

from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.slam.config import RelocalizationConfig
from explore_slam.slam.relocalization import Relocalizer

TRUE = Pose2(1.5, -0.8, 0.6)


def landmarks(count=12, seed=0):
    random = np.random.default_rng(seed)
    return {n: np.array([*random.uniform(-3.0, 3.0, 2), 0.02]) for n in range(count)}


def observe(relocalizer, positions, pose, agreed=False, wrong=0):
    """Add observations of all landmarks from a pose; the first `wrong` are of other landmarks."""
    local = [pose.inverse().compose(Pose2(x, y, 0.0)) for x, y, _ in positions.values()]
    z = np.array([[p.x, p.y, 0.5] for p in local])
    ids = np.array(list(positions))
    ids[:wrong] = np.roll(ids, 5)[:wrong]
    deviations = np.full(len(z), 0.02)
    relocalizer.add(z, deviations, ids[:, None], np.full(len(z), agreed))


def search(relocalizer, positions, current=IDENTITY):
    return relocalizer.search(positions, current, np.random.default_rng(1))


def lost_vehicle(drive=3.0):
    """Return a relocalizer of a vehicle that has driven forth and back (m)."""
    relocalizer = Relocalizer(RelocalizationConfig())
    for _ in range(2):
        relocalizer.predict(Pose2(0.5 * drive, 0.0, 0.0))
        relocalizer.predict(Pose2(0.0, 0.0, np.pi))
    return relocalizer


@pytest.mark.parametrize('wrong', [0, 5])
def test_the_pose_that_most_matches_agree_on_is_found(wrong):
    relocalizer, positions = lost_vehicle(), landmarks()
    observe(relocalizer, positions, TRUE, wrong=wrong)
    assert relocalizer.is_lost
    found = search(relocalizer, positions)
    assert np.hypot(found.pose.x - TRUE.x, found.pose.y - TRUE.y) < 0.02
    assert found.pose.theta == pytest.approx(TRUE.theta, abs=0.01)
    assert found.inliers >= len(positions) - wrong
    assert 0.0 < found.heading_deviation < 0.1


def test_fewer_than_half_of_the_matches_do_not_decide():
    relocalizer, positions = lost_vehicle(), landmarks()
    observe(relocalizer, positions, TRUE, wrong=7)
    assert search(relocalizer, positions) is None


def test_a_pose_out_of_reach_is_not_considered():
    """1.70 m away: within 1 m + 0.3 per metre driven after 3 m, beyond it after 2 m."""
    positions = landmarks()
    for drive, expected in ((3.0, True), (2.0, False)):
        relocalizer = lost_vehicle(drive)
        assert relocalizer.reach == pytest.approx(1.0 + 0.3 * drive)
        observe(relocalizer, positions, TRUE)
        assert (search(relocalizer, positions) is not None) is expected


def test_a_pose_must_gain_clearly_over_the_current_one():
    """Eight matches agree with the current pose, ten with another: no reason to move."""
    positions = landmarks(18)
    relocalizer = lost_vehicle()
    first = {n: positions[n] for n in range(8)}
    observe(relocalizer, first, IDENTITY)
    observe(relocalizer, {n: positions[n] for n in range(8, 18)}, TRUE)
    assert search(relocalizer, positions) is None
    assert search(relocalizer, positions, Pose2(0.5, 0.5, 0.0)) is not None


def test_a_confirmed_pose_resets_the_reach():
    relocalizer, positions = lost_vehicle(), landmarks()
    observe(relocalizer, positions, IDENTITY, agreed=True)
    assert relocalizer.reach == pytest.approx(1.0)
    assert not relocalizer.is_lost


@pytest.mark.parametrize(('agreeing', 'lost'), [(3, True), (5, False)])
def test_a_vehicle_is_lost_below_35_percent_of_agreement(agreeing, lost):
    relocalizer = lost_vehicle()
    z = np.ones((12, 3))
    agreed = np.arange(12) < agreeing
    relocalizer.add(z, np.ones(12), np.arange(12)[:, None], agreed)
    assert relocalizer.is_lost is lost
    relocalizer.reset()
    assert not relocalizer.is_lost


def test_two_landmarks_are_too_few():
    relocalizer, positions = lost_vehicle(), landmarks(2)
    for _ in range(4):
        observe(relocalizer, positions, TRUE)
    assert search(relocalizer, positions) is None


def test_state_round_trip():
    relocalizer, positions = lost_vehicle(), landmarks()
    observe(relocalizer, positions, TRUE)
    again = Relocalizer(RelocalizationConfig())
    again.restore({name: np.array(value) for name, value in relocalizer.state_dict().items()})
    assert search(again, positions) == search(relocalizer, positions)
