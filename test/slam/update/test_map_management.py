"""Which landmarks should be observed, and when those that are not are removed."""

import numpy as np
import pytest

from explore_slam.data import LandmarkObservations
from explore_slam.geometry import Pose2
from explore_slam.slam.update.map_management import _expected

STILL = Pose2(0.0, 0.0, 0.0)
# a wall 5 m ahead, from its middle outwards, denser than the bins of the view
WALL = np.array([[5.0, y, z] for y in np.linspace(-1.0, 1.0, 9) for z in (0.2, 0.45, 0.7)])
WALL = WALL[np.argsort(np.abs(WALL[:, 1]), kind='stable')]
WALL = np.vstack([[1.5, 0.1, 0.1], WALL])  # and something near: nothing nearer is expected


@pytest.mark.parametrize(
    ('place', 'expected'),
    [
        ([4.0, 0.0, 0.4], True),  # in front of what was observed
        ([6.0, 0.0, 0.4], False),  # occluded, or out of range
        ([-4.0, 0.0, 0.4], False),  # behind the vehicle
        ([3.0, 2.9, 0.4], False),  # beside the field of view
        ([4.0, 0.0, 3.0], False),  # above it
        ([0.5, 0.0, 0.05], False),  # nearer than anything that can be observed
    ],
)
def test_only_landmarks_in_free_view_are_expected(place, expected):
    ids, reference = np.array([7]), np.array([place])
    assert (len(_expected(reference, ids, 0.0, 0.0, 0.0, WALL)) == 1) is expected


def test_the_view_moves_with_the_vehicle():
    ids, reference = np.array([7]), np.array([[1.0, 6.0, 0.4]])
    assert len(_expected(reference, ids, 1.0, 2.0, 0.5 * np.pi, WALL)) == 1
    assert len(_expected(reference, ids, 1.0, 2.0, -0.5 * np.pi, WALL)) == 0


def test_free_entries_are_not_expected():
    assert len(_expected(np.array([[4.0, 0.0, 0.4]]), np.array([-1]), 0.0, 0.0, 0.0, WALL)) == 0


def look(slam, stamp, positions, first=0):
    count = len(positions)
    descriptors = np.eye(128, dtype=np.float32)[first : first + count]
    covariances = np.tile(1e-4 * np.eye(3), (count, 1, 1))
    return slam.update(
        'a', LandmarkObservations(float(stamp), positions, covariances, descriptors)
    )


GHOST = np.array([[4.0, 0.0, 0.45]])


def removals(slam, walls, updates):
    """Map the walls and something in front of them that is never observed again."""
    slam.predict('a', STILL, np.zeros((3, 3)))
    look(slam, 0, np.vstack([walls, GHOST]))
    return [look(slam, stamp, walls).removed for stamp in range(1, updates + 1)]


def test_a_landmark_is_removed_once_its_evidence_is_used_up(make_slam):
    slam = make_slam({'a': STILL}, particles=20, existence_miss=0.3)
    assert removals(slam, WALL, 6) == [0, 0, 0, 1, 0, 0]  # 1 - 4 · 0.3 < 0


def test_few_observations_prove_nothing(make_slam):
    slam = make_slam({'a': STILL}, particles=20, existence_miss=1.0)
    assert removals(slam, WALL[:7], 5) == [0] * 5
    slam = make_slam({'a': STILL}, particles=20, existence_miss=1.0)
    assert sum(removals(slam, WALL[:8], 5)) == 1


def test_matches_raise_the_evidence_up_to_its_limit(make_slam):
    for seen, until in ((1, 4), (3, 10), (9, 10)):
        slam = make_slam({'a': STILL}, particles=20, existence_miss=0.31, existence_limit=3.0)
        slam.predict('a', STILL, np.zeros((3, 3)))
        for stamp in range(seen):
            look(slam, stamp, np.vstack([WALL, GHOST]))
        removed = [look(slam, seen + n, WALL).removed for n in range(1, 13)]
        assert removed.index(1) + 1 == until


def test_the_paper_engine_removes_nothing(make_slam):
    slam = make_slam({'a': STILL}, particles=20, existence_miss=1.0, engine='paper')
    assert removals(slam, WALL, 5) == [0] * 5


CUBE = np.column_stack(  # 30 places in one cube of half a metre
    [np.full(30, 5.2), np.linspace(0.05, 0.45, 30), np.tile([0.1, 0.25, 0.4], 10)]
)


def cubed(make_slam, **values):
    """A filter that knows its pose, with room for ten landmarks in a cube."""
    slam = make_slam({'a': STILL}, particles=20, landmarks_per_cell=10, **values)
    slam.predict('a', STILL, np.zeros((3, 3)))
    return slam


def test_a_cube_holds_so_many_landmarks_and_its_neighbours_as_many(make_slam):
    slam = cubed(make_slam)
    assert look(slam, 0, CUBE).inserted == 10
    beside = CUBE + [0.0, 0.5, 0.0]
    assert look(slam, 1, np.vstack([CUBE[:5], beside]), 40).inserted == 15
    assert len(slam.map) == 20


def test_landmarks_that_were_matched_stay_and_others_make_room(make_slam):
    slam = cubed(make_slam)
    look(slam, 0, CUBE[:6])
    look(slam, 1, CUBE[:6])
    look(slam, 2, CUBE[6:9], 6)
    assert sorted(slam.map.ids[slam.map.entries()]) == list(range(9))
    summary = look(slam, 3, CUBE[10:13], 20)
    assert (summary.inserted, summary.removed) == (3, 2)
    assert sorted(slam.map.ids[slam.map.entries()]) == [0, 1, 2, 3, 4, 5, 8, 9, 10, 11]
    summary = look(slam, 4, CUBE[13:25], 30)
    assert (summary.inserted, summary.removed) == (4, 4)
    assert sorted(slam.map.ids[slam.map.entries()]) == [0, 1, 2, 3, 4, 5, 12, 13, 14, 15]
    assert look(slam, 5, CUBE[:6]).associated == 6


def test_a_cube_full_of_matched_landmarks_takes_no_more(make_slam):
    slam = cubed(make_slam)
    for stamp in (0, 1):
        look(slam, stamp, CUBE[:10])
    summary = look(slam, 2, CUBE[10:], 50)
    assert (summary.inserted, summary.removed) == (0, 0)
    assert len(slam.map) == 10


def test_the_paper_engine_keeps_everything(make_slam):
    slam = cubed(make_slam, engine='paper')
    assert look(slam, 0, CUBE).inserted == 30
