"""Relocalization: the pose that most matches agree on and that stands out, or none; trust."""

import numpy as np
import pytest

from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.slam.config import RelocalizationConfig
from explore_slam.slam.relocalization.relocalizer import Relocalizer

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
    assert len(found.ids) >= len(positions) - wrong
    assert 0.0 < found.heading_deviation < 0.1


def test_fewer_than_half_of_the_matches_do_not_decide():
    relocalizer, positions = lost_vehicle(), landmarks()
    observe(relocalizer, positions, TRUE, wrong=7)
    assert search(relocalizer, positions) is None


def test_a_pose_far_away_is_found():
    relocalizer, positions = lost_vehicle(), landmarks()
    observe(relocalizer, positions, TRUE)
    found = search(relocalizer, positions, Pose2(-40.0, 25.0, -2.5))
    assert found.pose == pytest.approx(TRUE, abs=1e-6)
    assert sorted(found.ids) == sorted(positions)


def test_of_two_rooms_alike_none_is_chosen():
    """Every observation is similar to a landmark of either room, 20 m apart."""
    positions = landmarks(6)
    twins = {n + 100: xy + [20.0, 0.0, 0.0] for n, xy in positions.items()}
    relocalizer = lost_vehicle()
    local = [TRUE.inverse().compose(Pose2(x, y, 0.0)) for x, y, _ in positions.values()]
    z = np.array([[p.x, p.y, 0.5] for p in local])
    ids = np.array([[n, n + 100] for n in positions])
    relocalizer.add(z, np.full(len(z), 0.02), ids, np.zeros(len(z), bool))
    assert search(relocalizer, positions | twins) is None
    only = search(relocalizer, positions | {100: twins[100], 101: twins[101]})
    assert only.pose == pytest.approx(TRUE, abs=1e-6)


@pytest.mark.parametrize(('elsewhere', 'found'), [(8, False), (6, True)])
@pytest.mark.parametrize('current', [IDENTITY, Pose2(9.0, 9.0, 1.0)])
def test_a_pose_must_gain_clearly_over_all_others(elsewhere, found, current):
    """Of 18 matches, 8 agree on another pose, the current one or not: no reason to move."""
    positions = landmarks(18)
    relocalizer = lost_vehicle()
    observe(relocalizer, {n: positions[n] for n in range(elsewhere)}, IDENTITY)
    observe(relocalizer, {n: positions[n] for n in range(elsewhere, 18)}, TRUE)
    assert (search(relocalizer, positions, current) is not None) is found


def test_a_confirmed_pose_resets_the_reach():
    relocalizer, positions = lost_vehicle(), landmarks()
    assert relocalizer.reach == pytest.approx(1.9)
    observe(relocalizer, positions, IDENTITY, agreed=True)
    assert relocalizer.reach == pytest.approx(1.0)
    assert not relocalizer.is_lost


def see_alone(relocalizer, number, agreed):
    """Add an update with one observation, of a landmark by number."""
    relocalizer.add(np.ones((1, 3)), np.ones(1), np.array([[number]]), np.array([agreed]))


def test_after_four_updates_in_which_nothing_agrees_the_whole_map_is_searched():
    relocalizer = Relocalizer(RelocalizationConfig())
    for number in range(3):
        see_alone(relocalizer, number, agreed=False)
    assert np.isfinite(relocalizer.reach)
    see_alone(relocalizer, 3, agreed=False)
    assert not relocalizer.is_trusted
    assert relocalizer.reach == np.inf


def test_one_agreement_by_chance_does_not_bring_trust_back():
    relocalizer = Relocalizer(RelocalizationConfig())
    relocalizer.reset()
    assert relocalizer.reach == np.inf
    for _ in range(3):  # of one landmark alone
        see_alone(relocalizer, 7, agreed=True)
    assert not relocalizer.is_trusted
    see_alone(relocalizer, 8, agreed=False)  # another, but it disagrees
    assert not relocalizer.is_trusted
    see_alone(relocalizer, 8, agreed=True)
    assert relocalizer.is_trusted


def test_half_of_the_window_must_agree():
    relocalizer = Relocalizer(RelocalizationConfig())
    relocalizer.reset()
    for number in range(5):
        see_alone(relocalizer, number, agreed=False)
    for number in range(4):
        see_alone(relocalizer, number, agreed=True)
        assert not relocalizer.is_trusted
    see_alone(relocalizer, 4, agreed=True)
    assert relocalizer.is_trusted


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


def test_landmarks_close_together_do_not_determine_the_heading():
    """Matches that deviate by 4 cm determine 0.15 rad from an extent of 0.27 m on."""
    for spread, found in ((0.1, False), (1.0, True)):
        positions = {
            n: np.array([6.0 + spread * np.cos(a), spread * np.sin(a), 0.02])
            for n, a in enumerate(np.linspace(0.0, 5.0, 6))
        }
        relocalizer = lost_vehicle()
        observe(relocalizer, positions, IDENTITY)
        result = search(relocalizer, positions, Pose2(3.0, 0.0, 1.0))
        assert (result is not None) is found
    lever = np.hypot(result.pose.x - 6.0, result.pose.y) * result.heading_deviation
    assert result.position_deviation == pytest.approx(np.hypot(0.041, lever), rel=0.1)


def test_state_round_trip():
    relocalizer, positions = lost_vehicle(), landmarks()
    observe(relocalizer, positions, TRUE)
    again = Relocalizer(RelocalizationConfig())
    again.restore({name: np.array(value) for name, value in relocalizer.state_dict().items()})
    assert not again.is_trusted
    found, expected = search(again, positions), search(relocalizer, positions)
    assert found.pose == expected.pose
    assert found.ids.tolist() == expected.ids.tolist()


@pytest.mark.parametrize('restored', [False, True])
def test_a_placement_counts_as_one_until_landmarks_confirm_it(restored):
    """A vehicle that loses its way later has drifted: its pose is no placement any more."""
    relocalizer = Relocalizer(RelocalizationConfig())
    assert not relocalizer.is_placed
    relocalizer.reset(placed=False)
    assert not relocalizer.is_placed
    relocalizer.reset()
    see_alone(relocalizer, 7, agreed=False)
    if restored:
        state = relocalizer.state_dict()
        relocalizer = Relocalizer(RelocalizationConfig())
        relocalizer.restore(state)
    assert relocalizer.is_placed
    for number in (7, 7, 8):
        assert relocalizer.is_placed
        see_alone(relocalizer, number, agreed=True)
    assert not relocalizer.is_placed
    for number in range(12):
        see_alone(relocalizer, number, agreed=False)
    assert not relocalizer.is_trusted
    assert not relocalizer.is_placed
