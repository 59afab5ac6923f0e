"""Which observations close a loop, and what a retracted closure leaves in the graph."""

import numpy as np
import pytest
from slam.conftest import unit_rows

from explore_slam.slam.config import FastSlamConfig
from explore_slam.slam.descriptors.kinds import kind_named
from explore_slam.slam.graph import JointGraph
from explore_slam.slam.landmarks.landmark_map import LandmarkMap, make_index
from explore_slam.slam.relocalization.landmark_closures import (
    LandmarkClosure,
    LandmarkClosures,
    separate,
)
from explore_slam.slam.storage.ancestry import AncestryTree

NOTHING = np.empty(0, np.int64)
R = np.tile([1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3], (4, 1))


def closure(keyframe, vehicle=0, first_recent=50, merged=NOTHING):
    return LandmarkClosure(vehicle, keyframe, first_recent, merged)


def noted(updates):
    """Return the closures after updates of (keyframe, old landmarks, distance driven)."""
    closures = LandmarkClosures()
    for keyframe, count, driven in updates:
        closures.note(closure(keyframe), np.arange(6) < count, driven)
    return [found.keyframe for found in closures.closures]


@pytest.mark.parametrize(
    ('updates', 'keyframes'),
    [
        ([(1, 5, 9.0), (2, 5, 9.5)], []),  # near the start everything is old
        ([(1, 5, 9.0), (2, 0, 15.0), (3, 5, 20.0), (4, 5, 21.0)], [3]),
        ([(1, 2, 20.0), (2, 2, 21.0), (3, 3, 22.0)], [1]),  # with what led to it
        ([(1, 2, 16.0), (2, 3, 20.0)], [2]),  # too long before
        ([(k, 1, 20.0 + k) for k in range(12)] + [(12, 3, 32.0)], [12]),
        ([(1, 4, 20.0), (2, 4, 29.0), (3, 4, 38.0)], [1]),  # old landmarks all the way
    ],
)
def test_old_landmarks_after_a_while_are_a_closure(updates, keyframes):
    assert noted(updates) == keyframes


def test_few_closures_are_kept_and_the_newest_come_first():
    closures = LandmarkClosures()
    for k in range(20):
        closures.add(closure(k, vehicle=k % 2), 20.0 * k)
    assert [c.keyframe for c in closures.closures] == list(range(12, 20))
    assert [c.keyframe for c in closures.newest(0, {0, 1})] == [18, 19]
    assert [c.keyframe for c in closures.newest(2, {0, 1, 2})] == [19, 18]
    (gone,) = closures.newest(0, {0})
    closures.retract(gone)
    assert [c.keyframe for c in closures.newest(0, {0})] == [16]


def test_the_state_is_restored():
    closures = LandmarkClosures()
    closures.add(closure(3, merged=np.array([4, 7])), 12.0)
    closures.note(closure(5, vehicle=1), np.ones(4, np.bool_), 14.0)
    again = LandmarkClosures()
    again.restore(closures.state_dict())
    for one, other in zip(again.closures, closures.closures, strict=True):
        assert one[:3] == other[:3]
        np.testing.assert_array_equal(one.merged, other.merged)
    for name, value in closures.state_dict().items():
        np.testing.assert_array_equal(again.state_dict()[name], value)


def test_what_was_observed_since_a_closure_becomes_other_landmarks():
    """Landmarks 0 and 1 are old; 2 and 3 are recent, and 3 was merged into 1."""
    graph = JointGraph()
    graph.add_start(0, 0, np.zeros(3))
    z = np.array([[2.0, 1.0, 0.0], [2.0, -1.0, 0.0], [3.0, 0.5, 0.0], [3.0, -0.5, 0.0]])
    graph.add_observations(0, [0, 1], z[:2], R[:2])
    for k in range(1, 4):
        graph.add_keyframe(0, k, [0.1, 0.0, 0.0], 1e-4 * np.eye(3))
    graph.add_observations(2, [2, 3], z[2:], R[2:])
    merged = graph.observation_numbers([3])
    graph.merge_landmarks([3], [1])
    graph.add_observations(3, [0, 1, 2], z[:3], R[:3])

    config = FastSlamConfig()
    kind = kind_named(config.association.descriptor_kind)
    landmarks, tree = LandmarkMap(4, kind, make_index(config.association)), AncestryTree(4)
    vectors = unit_rows(np.random.default_rng(0), 3)
    addresses = landmarks.rows.allocate(3)
    landmarks.rows.workspace[addresses] = 1.0
    landmarks.add(addresses, vectors, 0, z[:3], tree)

    made = separate(graph, landmarks, closure(3, first_recent=2, merged=merged))
    assert made.landmarks.tolist() == [0, 1]
    assert made.copies.tolist() == [3, 4]
    assert made.counts.tolist() == [1, 2]
    first = graph.observations_of([0, 1, 2, 3, 4]).first
    assert np.diff(first).tolist() == [1, 1, 2, 1, 2]
    np.testing.assert_array_equal(made.renamed(np.array([1, -1, 2, 0])), [4, -1, 2, 3])

    made.add_copies(landmarks, tree)
    entries = landmarks.entries_with(made.copies)
    assert (entries >= 0).all()
    np.testing.assert_array_equal(landmarks.counts[entries], made.counts)
    np.testing.assert_array_equal(
        landmarks.index.vectors(entries), landmarks.index.vectors(landmarks.entries_with([0, 1]))
    )
    assert landmarks.next_id == 5
