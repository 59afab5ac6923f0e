"""Scan matching: an error of each pose that is white, beside a random walk."""

import numpy as np
import pytest

from explore_slam.geometry import between, compose
from explore_slam.slam.graph import GraphConfig, JointGraph

WALK = np.diag([2e-3, 2e-3, 1e-3]) ** 2
WHITE = np.diag([0.02, 0.015, 0.01]) ** 2
STEP = np.array([0.3, 0.0, 0.1])


def matched_chain(seed, count):
    """Return true poses and the increments between matched poses, neighbours anticorrelated."""
    random = np.random.default_rng(seed)
    true, chain = np.zeros((count, 3)), np.zeros((count, 3))
    matched = np.zeros((count, 3))
    for k in range(1, count):
        true[k] = compose(true[k - 1], STEP)
        walk = random.multivariate_normal(np.zeros(3), WALK)
        chain[k] = compose(chain[k - 1], STEP + walk)
        matched[k] = compose(chain[k], random.multivariate_normal(np.zeros(3), WHITE))
    return true, [between(matched[k - 1], matched[k]) for k in range(1, count)]


def graph_of(increments, covariance, white, **values):
    graph = JointGraph(GraphConfig(**values))
    graph.add_start(0, 0, np.zeros(3))
    for k, increment in enumerate(increments, start=1):
        graph.add_keyframe(0, k, increment, covariance, white)
    graph.optimize()
    return graph


def anees(covariance, white):
    values = []
    for seed in range(40):
        true, increments = matched_chain(seed, 60)
        graph = graph_of(increments, covariance, white, graph_bounded=False)
        for k in (10, 30, 59):
            error = graph.estimate(k) - true[k]
            error[2] = np.remainder(error[2] + np.pi, 2 * np.pi) - np.pi
            values.append(error @ np.linalg.solve(graph.covariance(k), error))
    return np.mean(values)


def test_increments_of_matched_poses_are_anticorrelated():
    found = []
    for seed in range(40):
        _, increments = matched_chain(seed, 60)
        e = np.array(increments) - STEP
        found.append(np.corrcoef(e[:-1, 2], e[1:, 2])[0, 1])
    assert -0.55 < np.mean(found) < -0.35


def test_chain_with_white_error_is_consistent():
    assert 2.4 < anees(WALK, WHITE) < 3.6  # 120 values, expectation 3


def test_chain_taken_for_a_random_walk_is_far_too_wide():
    assert anees(WALK + 2.0 * WHITE, None) < 0.5


def test_dropping_keyframes_changes_nothing():
    _, increments = matched_chain(0, 60)
    whole = graph_of(increments, WALK, WHITE, graph_bounded=False)
    bounded = graph_of(increments, WALK, WHITE)
    assert len(bounded.live_keyframes()) == 9
    np.testing.assert_allclose(bounded.path(), whole.path(), atol=1e-9)
    for k in (53, 59):
        expected = whole.covariance(k)
        np.testing.assert_allclose(bounded.covariance(k), expected, rtol=1e-5, atol=1e-9)


def test_closure_measures_the_pose_and_not_the_matched_pose():
    """A precise closure pulls out the white error of both ends, the neighbours keep theirs."""
    true, increments = matched_chain(3, 60)
    graph = graph_of(increments, WALK, WHITE, graph_bounded=False)
    before = np.array([np.trace(graph.covariance(k)) for k in (58, 59)])
    graph.add_relative_pose(0, 59, true[59], np.linalg.inv(1e-8 * np.eye(3)), robust=False)
    graph.optimize()
    after = np.array([np.trace(graph.covariance(k)) for k in (58, 59)])
    assert after[1] < 1e-3 * before[1]
    assert after[0] == pytest.approx(np.trace(2 * WHITE) + np.trace(WALK), rel=0.3)
