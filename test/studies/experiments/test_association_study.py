"""Counts of correct matches, and percentages of descriptor distances."""

import numpy as np
import pytest

from explore_slam.data import LandmarkObservations
from explore_slam.geometry import Pose2, to_world
from explore_slam.studies.experiments.association_study import (
    RULES,
    MatchCount,
    PoseError,
    count_matches,
    distance_shares,
)
from explore_slam.studies.experiments.scenarios import unique_descriptors
from explore_slam.studies.experiments.tum_frames import TumFrame

RNG = np.random.default_rng(5)
POINTS = RNG.uniform([1.0, -1.5, 0.0], [3.0, 1.5, 2.0], (60, 3))


def frame(stamp, pose, descriptors, points=POINTS):
    back = pose.inverse()
    seen = LandmarkObservations(
        stamp, to_world(back, points), np.tile(1e-4 * np.eye(3), (len(points), 1, 1)), descriptors
    )
    return TumFrame(stamp, pose, seen, points, descriptors)


def test_perfect_frames_match_perfectly():
    descriptors = unique_descriptors(60, np.random.default_rng(0))
    frames = [frame(0.0, Pose2(0, 0, 0), descriptors), frame(1.0, Pose2(0.2, 0, 0.1), descriptors)]
    count = count_matches(frames, 1, (0.4,), np.random.default_rng(1), PoseError(1e-4, 1e-4))
    for rule in RULES:
        assert count.precision(rule, 0.4) == 1.0
        assert count.total[rule, 0.4] == 60


def test_features_that_repeat_fool_descriptors_but_not_geometry():
    """Twenty points with nearly equal descriptors, at least 0.3 m apart."""
    grid = np.stack(np.meshgrid([1.5, 2.0, 2.5, 3.0], [-1, -0.5, 0, 0.5, 1]), -1).reshape(-1, 2)
    points = np.column_stack([grid, np.full(20, 0.5)])
    rng = np.random.default_rng(2)
    base = unique_descriptors(1, rng)

    def look_alike():
        raw = base + 0.01 * rng.standard_normal((20, 128)).astype(np.float32)
        return (raw / np.linalg.norm(raw, axis=1, keepdims=True)).astype(np.float32)

    frames = [
        frame(0.0, Pose2(0, 0, 0), look_alike(), points),
        frame(1.0, Pose2(0.1, 0, 0), look_alike(), points),
    ]
    count = count_matches(frames, 1, (0.5,), np.random.default_rng(1), PoseError(0.02, 0.01))
    assert count.precision('descriptor', 0.5) < 0.3
    assert count.precision('gated', 0.5) == 1.0


def test_mutual_and_ratio_test_select_from_what_is_gated():
    descriptors = unique_descriptors(60, np.random.default_rng(0))
    frames = [
        frame(0.0, Pose2(0, 0, 0), descriptors),
        frame(1.0, Pose2(0, 0, 0), np.roll(descriptors, 1, axis=0)),
    ]
    count = count_matches(frames, 1, (4.0,), np.random.default_rng(1), PoseError(0.5, 0.5))
    totals = [count.total[rule, 4.0] for rule in RULES[1:]]
    assert totals == sorted(totals, reverse=True)


def test_frames_without_features_are_passed_over():
    descriptors = unique_descriptors(60, np.random.default_rng(0))
    empty = TumFrame(
        1.0,
        Pose2(0, 0, 0),
        LandmarkObservations.empty(1.0),
        np.empty((0, 3)),
        np.empty((0, 128), np.float32),
    )
    count = count_matches(
        [frame(0.0, Pose2(0, 0, 0), descriptors), empty], 1, (0.4,), np.random.default_rng(1)
    )
    assert count.total == {}
    assert np.isnan(count.precision('gated', 0.4))


def test_distance_shares_agree_with_all_pairs():
    descriptors = unique_descriptors(70, np.random.default_rng(3))
    limits = (0.5, 0.7, 0.75, 2.0)
    shares = distance_shares(descriptors, limits, block=16)
    apart = [
        ((descriptors[i] - descriptors[j]) ** 2).sum()
        for i in range(70)
        for j in range(70)
        if i != j
    ]
    for limit in limits:
        assert shares[limit] == pytest.approx(100 * np.mean(np.array(apart) < limit), abs=0.05)


def test_counts_add_up():
    count = MatchCount()
    count.add('gated', 0.4, np.array([True, False, True]))
    count.add('gated', 0.4, np.array([True]))
    assert count.correct['gated', 0.4] == 3
    assert count.precision('gated', 0.4) == 0.75
