"""Closures in the belief: paths bend, vehicles are tied together, wrong closures are retracted."""

import numpy as np
import pytest
from scipy.stats import chi2

from explore_slam.errors import SlamError
from explore_slam.geometry import Pose2, between
from explore_slam.settings import with_values
from explore_slam.slam import FastSlam, FastSlamConfig, RelativePose, TeamBelief
from explore_slam.slam.posterior import joint_posterior

WALK = np.diag([4e-4, 4e-4, 1e-3])
SIDE = [Pose2(1.0, 0.0, 0.0)] * 5 + [Pose2(1.0, 0.0, np.pi / 2)]
LAP = SIDE * 4
EXACT = np.diag([1e4, 1e4, 1e5])


def drive(slam, vehicle, steps, seed=0, begin=0):
    """Drive with noise; return true poses and keyframes, the start included."""
    random = np.random.default_rng(seed)
    true, keyframes = [slam.estimate(vehicle)[0]], [slam.add_keyframe(vehicle, float(begin))]
    slam.pin(keyframes[0])
    for k, step in enumerate(steps):
        noise = random.multivariate_normal(np.zeros(3), WALK)
        slam.predict(vehicle, step, WALK)
        true.append(true[-1].compose(Pose2(*(np.asarray(step) + noise))))
        keyframes.append(slam.add_keyframe(vehicle, begin + k + 1.0))
        slam.pin(keyframes[-1])
    return true, keyframes


def closure(true, keyframes, a, b, off=(0.0, 0.0, 0.0), information=EXACT):
    pose = Pose2(*(np.asarray(true[a].between(true[b])) + off))
    return RelativePose(keyframes[a], keyframes[b], pose, information)


def make(**values):
    config = with_values(FastSlamConfig(), {'particles': 200, **values})
    return FastSlam({'a': Pose2(0.0, 0.0, 0.0)}, config, seed=1)


def mean_error(slam, true):
    _, poses = slam.trajectory('a')
    return np.hypot(*(poses - np.asarray(true))[:, :2].T).mean()


def test_a_closure_bends_the_path_the_present_pose_and_its_covariance():
    ratios, distances = [], []
    for seed in range(20):
        slam = make()
        true, keyframes = drive(slam, 'a', LAP, seed)
        before = mean_error(slam, true), slam.estimate('a')[1]
        slam.close_loops([closure(true, keyframes, 0, 24)])
        ratios.append(mean_error(slam, true) / before[0])
        pose, P = slam.estimate('a')
        assert np.linalg.det(P) < 1e-3 * np.linalg.det(before[1])
        off = np.asarray(pose) - np.asarray(true[-1])
        off[2] = (off[2] + np.pi) % (2 * np.pi) - np.pi
        distances.append(off @ np.linalg.solve(P, off))
    assert np.median(ratios) < 0.5
    assert np.mean(distances) < chi2(3 * 20).ppf(0.999) / 20


def test_a_redraw_follows_a_surprise_or_comes_with_later_closures():
    slam = make()
    true, keyframes = drive(slam, 'a', LAP)
    draws = slam.redraws
    slam.close_loops([closure(true, keyframes, 0, 24)])
    assert slam.redraws == draws + 1  # the last redraw was long ago
    path = slam.best_path()
    expected = Pose2.from_array(between(path[keyframes[1]], path[keyframes[24]]))
    agreeing = RelativePose(keyframes[1], keyframes[24], expected, EXACT)
    (number,) = slam.close_loops([agreeing])
    assert slam.redraws == draws + 1
    assert slam.closure_distances()[number] < 0.1
    off = expected._replace(x=expected.x + 0.8)
    slam.close_loops([RelativePose(keyframes[2], keyframes[24], off, EXACT)])
    assert slam.redraws == draws + 2


@pytest.mark.parametrize(('per_batch', 'redrawn'), [(100, True), (2, False)])
def test_in_a_large_graph_closures_wait_longer_for_later_ones(monkeypatch, per_batch, redrawn):
    monkeypatch.setattr(joint_posterior, '_KEYFRAMES_PER_BATCH', per_batch)
    slam = make()
    true, keyframes = drive(slam, 'a', LAP)
    slam.close_loops([closure(true, keyframes, 0, 24)])
    draws = slam.redraws
    drive(slam, 'a', SIDE + SIDE[:4], begin=25)  # more than 8 keyframes, fewer than half of all
    path = slam.best_path()
    expected = Pose2.from_array(between(path[keyframes[0]], path[-1]))
    slam.close_loops([RelativePose(keyframes[0], len(path) - 1, expected, EXACT)])
    assert (slam.redraws > draws) == redrawn


def test_a_large_graph_is_redrawn_beside_the_caller_with_the_same_result():
    beside, at_once = make(async_redraw_threshold=0), make(async_redraw_threshold=10_000_000)
    for slam in (beside, at_once):
        true, keyframes = drive(slam, 'a', LAP)
        draws, path = slam.redraws, slam.best_path()
        slam.close_loops([closure(true, keyframes, 0, 24)])
        if slam is beside:
            assert slam.redraws == draws
            np.testing.assert_array_equal(slam.best_path(), path)
        slam.predict('a', Pose2(0.1, 0.0, 0.0), 1e-4 * np.eye(3))
        slam.add_keyframe('a', 1e3)
        assert slam.redraws == draws + 1
    np.testing.assert_allclose(beside.best_path(), at_once.best_path(), atol=1e-6)


def test_a_wrong_closure_among_right_ones_hardly_counts_and_can_be_retracted():
    slam = make()
    true, keyframes = drive(slam, 'a', LAP + LAP)
    right = [closure(true, keyframes, k, k + 24) for k in range(0, 24, 2)]
    slam.close_loops(right)
    slam.redraw([0])
    error = mean_error(slam, true)
    wrong = closure(true, keyframes, 5, 29, (1.5, -1.0, 0.3))
    (number,) = slam.close_loops([wrong])
    slam.redraw([0])
    assert slam.closure_distances()[number] > 100.0
    assert mean_error(slam, true) < error + 0.1
    slam.retract_closure(number)
    slam.redraw([0])
    assert number not in slam.closure_distances()
    assert mean_error(slam, true) == pytest.approx(error, abs=1e-3)
    with pytest.raises(SlamError, match=f'factor {number} is not'):
        slam.retract_closure(number)


def test_a_closure_between_vehicles_merges_their_groups():
    starts = {'a': Pose2(0.0, 0.0, 0.0), 'b': Pose2(0.0, 3.0, 0.0)}
    slam = FastSlam(starts, FastSlamConfig(particles=200), seed=1)
    first, own = drive(slam, 'a', SIDE, seed=1)
    second, others = drive(slam, 'b', SIDE, seed=2)
    assert slam.groups.of(0) is not slam.groups.of(1)
    relative = slam.relative_covariance(own[6], np.array([others[6]]))[0]
    measured = RelativePose(own[6], others[6], first[6].between(second[6]), EXACT)
    slam.close_loops([measured])
    assert slam.groups.of(0) is slam.groups.of(1)
    after = slam.relative_covariance(own[6], np.array([others[6]]))[0]
    assert np.linalg.det(after) < 0.01 * np.linalg.det(relative)
    found = between(slam.estimate('a')[0], slam.estimate('b')[0])
    np.testing.assert_allclose(found, measured.pose, atol=0.03)


def test_covariances_of_search_windows_equal_the_posterior_and_widen_with_the_motion_since():
    slam = make(graph_bounded=False)
    true, keyframes = drive(slam, 'a', LAP)
    slam.close_loops([closure(true, keyframes, 0, 24)])
    others = np.array(keyframes[3:20:4])
    nodes = np.array([slam.path.nodes[k] for k in others])
    last = keyframes[-1]
    exact = slam.joint.graph.relative_covariance(slam.path.nodes[last], nodes)
    np.testing.assert_allclose(slam.relative_covariance(last, others), exact, atol=1e-9)
    for k in range(6):
        slam.predict('a', Pose2(0.5, 0.0, 0.1), WALK)
        last = slam.add_keyframe('a', 100.0 + k)
    exact = slam.joint.graph.relative_covariance(slam.path.nodes[last], nodes)
    found = slam.relative_covariance(last, others)
    spreads = [np.sqrt(P[:, [0, 1, 2], [0, 1, 2]]) for P in (exact, found)]
    np.testing.assert_allclose(spreads[1], spreads[0], rtol=0.05)
    for k in range(20):  # too old: computed anew
        slam.predict('a', Pose2(0.5, 0.0, 0.1), WALK)
        last = slam.add_keyframe('a', 200.0 + k)
    exact = slam.joint.graph.relative_covariance(slam.path.nodes[last], nodes)
    np.testing.assert_allclose(slam.relative_covariance(last, others), exact, rtol=1e-6)


def test_vehicles_that_nothing_ties_are_independent():
    starts = {'a': Pose2(0.0, 0.0, 0.3), 'b': Pose2(0.0, 3.0, -0.4)}
    slam = FastSlam(starts, FastSlamConfig(particles=200), seed=1)
    _, own = drive(slam, 'a', SIDE, seed=1)
    _, others = drive(slam, 'b', SIDE, seed=2)
    found = slam.relative_covariance(own[6], np.array([own[2], others[6], others[0]]))
    random = np.random.default_rng(0)
    one, other = (
        np.asarray(slam.estimate(name)[0])
        + random.multivariate_normal(np.zeros(3), slam.estimate(name)[1], 100_000)
        for name in ('a', 'b')
    )
    sampled = np.cov(between(one, other).T)
    deviations = np.sqrt(np.diag(sampled))
    np.testing.assert_allclose(np.sqrt(np.diag(found[1])), deviations, rtol=0.05)
    assert found[2][2, 2] == pytest.approx(slam.estimate('a')[1][2, 2], rel=0.01)


def test_pinned_keyframes_stay_and_closures_need_a_joint_graph():
    slam = make()
    _, keyframes = drive(slam, 'a', LAP)
    slam.unpin(keyframes[-2])
    for k in range(30):
        slam.predict('a', Pose2(0.5, 0.0, 0.1), WALK)
        slam.add_keyframe('a', 100.0 + k)
    live = slam.joint.graph.live_keyframes()
    assert slam.path.nodes[keyframes[-1]] in live
    assert slam.path.nodes[keyframes[-2]] not in live
    slam.unpin(keyframes[-1])
    assert slam.path.nodes[keyframes[-1]] not in slam.joint.graph.live_keyframes()
    true, more = drive(slam, 'a', SIDE, begin=300)
    good = closure(true, more, 0, 5)
    dropped = good._replace(reference=keyframes[-1])
    distances = slam.closure_distances()
    with pytest.raises(SlamError, match='was dropped'):
        slam.close_loops([good, dropped])
    with pytest.raises(SlamError, match='information'):
        slam.close_loops([good, good._replace(information=-EXACT)])
    assert slam.closure_distances() == distances
    with pytest.raises(SlamError, match='keyframe is 999, expected 0'):
        slam.pin(999)
    paper = make(engine='paper')
    with pytest.raises(SlamError, match='need the setting joint_graph'):
        paper.close_loops([])


def test_a_team_with_dedicated_maps_closes_loops_in_each_of_them():
    starts = {'a': Pose2(0.0, 0.0, 0.0), 'b': Pose2(0.0, 3.0, 0.0)}
    team = TeamBelief(starts, FastSlamConfig(particles=50, maps='dedicated'), seed=1)
    keyframes, true = {'a': [], 'b': []}, {}
    for name in ('a', 'b'):
        true[name], keyframes[name] = drive(team, name, LAP, seed=len(name))
    assert team.closes_loops
    assert team.in_one_map_with('b') == [1]
    numbers = [
        team.close_loops([closure(true[name], keyframes[name], 0, 24)])[0] for name in starts
    ]
    assert numbers[0] != numbers[1]
    assert sorted(team.closure_distances()) == sorted(numbers)
    for name in starts:
        found = team.estimate(name)[0]
        np.testing.assert_allclose(found[:2], true[name][-1][:2], atol=0.05)
    team.retract_closure(numbers[1])
    assert list(team.closure_distances()) == numbers[:1]
    mixed = RelativePose(keyframes['a'][0], keyframes['b'][0], Pose2(0, 0, 0), EXACT)
    with pytest.raises(SlamError, match='expected those of one'):
        team.close_loops([mixed])
    copy = TeamBelief.from_state(team.state_dict())
    P = copy.relative_covariance(keyframes['b'][24], np.array([keyframes['b'][0]]))
    np.testing.assert_array_equal(
        P, team.relative_covariance(keyframes['b'][24], np.array([keyframes['b'][0]]))
    )
