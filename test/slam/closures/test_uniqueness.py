"""At the edge of a map of equal rooms a join waits; where the path is distinctive it does not."""

import math

import numpy as np
import pytest
from registration.ray_caster import scan_of
from slam.closures.drives import along, corridor_of_rooms
from slam.closures.test_loop_search import FURNITURE, LAP, OFFICE

from explore_slam.registration import scan_cloud
from explore_slam.slam.closures.anchors import Anchor
from explore_slam.slam.closures.uniqueness import _mark, fit_of, trail_of

OTHER_MODE = 0.92


def anchors_along(walls, path, vehicle=0, seed=1):
    random = np.random.default_rng(seed)
    found, distance_driven = [], 0.0
    for k, pose in enumerate(path):
        distance_driven += math.dist(pose[:2], path[max(k - 1, 0)][:2])
        cloud = scan_cloud(scan_of(walls, pose, 0.01, random), farthest=20.0)
        found.append(Anchor(k, vehicle, distance_driven, float(k), cloud))
    return found


def fit(walls, first, second, offset=(0.0, 0.0, 0.0)):
    """Compare a path with the map of another when the join is off by an offset in the map."""
    known = anchors_along(walls, first)
    trail = trail_of(anchors_along(walls, second, 1, seed=2))
    placed = np.array([second[anchor.keyframe] for anchor in trail]) + offset
    *rest, result = fit_of(trail, placed, known, np.array(first, dtype=float))
    assert set(rest) == {None}
    assert len(rest) > 5  # it can be interrupted
    return result


@pytest.mark.parametrize('period', [3.0, 4.0, 6.0])
def test_the_next_of_equal_rooms_is_a_rival_although_the_map_ends_there(period):
    """The map holds the first rooms, the path leads through these and others beyond."""
    walls = corridor_of_rooms(0.0, 0.0, period, round(60.0 / period))
    first = along((1.0, 0.0), (19.0, 0.0))
    second = along((1.0 + period, 0.0), (23.0 + period, 0.0))
    right = fit(walls, first, second)
    assert right.score > 0.9
    assert not right.is_unique(OTHER_MODE)
    # a whole room off, where the map covers more of the path: as likely as the right one
    wrong = fit(walls, first, second, (-period, 0.0, 0.0))
    assert wrong.score > 0.9
    assert wrong.returns > right.returns
    assert not wrong.is_unique(OTHER_MODE)


@pytest.mark.parametrize('turned', [0.0, math.pi])
def test_a_path_through_an_office_fits_in_one_place(turned):
    """Also if it was driven in the other direction, so that the laser sees from the other side."""
    walls = np.vstack([OFFICE, FURNITURE])
    second = along(*(LAP[1:4] if not turned else LAP[3:0:-1]))
    result = fit(walls, along(*LAP), second)
    assert result.score > 0.9
    assert result.returns > 150
    assert result.is_unique(OTHER_MODE)


def test_a_path_in_unmapped_space_joins_nothing():
    walls = np.vstack([OFFICE, FURNITURE])
    first = along(*LAP)
    result = fit(walls, first, first[:20], (60.0, 0.0, 0.0))
    assert result.returns == 0
    assert not result.is_unique(OTHER_MODE)


def test_a_trail_is_the_newest_part_of_the_path_in_steps():
    walls = np.vstack([OFFICE, FURNITURE])
    anchors = anchors_along(walls, along(*LAP))
    trail = trail_of(anchors)
    assert trail[-1] is anchors[-1]
    distances_driven = [anchor.distance_driven for anchor in trail]
    assert 18.0 < distances_driven[-1] - distances_driven[0] <= 20.0
    assert min(np.diff(distances_driven)) >= 0.8
    assert trail_of(anchors[:1]) == anchors[:1]


def test_points_outside_of_the_map_mark_no_cell():
    """Also those that lie one cell beyond an edge."""
    cells, low = np.zeros((3, 4), np.bool_), np.array([1.0, 2.0])
    inside = low + 0.2 * np.array([[0.5, 0.5], [3.5, 2.5]])
    outside = low + 0.2 * np.array([[-0.5, 0.5], [0.5, -0.5], [4.5, 0.5], [0.5, 3.5]])
    _mark(cells, np.vstack([inside, outside]), low, True)
    assert np.argwhere(cells).tolist() == [[0, 0], [2, 3]]
