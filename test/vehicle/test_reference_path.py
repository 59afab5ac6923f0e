"""The reference path: arc length, projection within a window, sign of the distance."""

import math

import numpy as np
import pytest

from explore_slam.vehicle.reference_path import ReferencePath

ELBOW = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 0.0], [3.0, 4.0]])  # the corner is repeated


def test_length_and_points_by_arc_length():
    path = ReferencePath(ELBOW)
    assert path.length == 7.0
    assert path.s.tolist() == [0.0, 3.0, 7.0]
    for s, point in ((-1.0, (0, 0)), (1.5, (1.5, 0)), (3.0, (3, 0)), (5.0, (3, 2)), (9.0, (3, 4))):
        assert path.point_at(s) == pytest.approx(point)


@pytest.mark.parametrize(
    ('position', 'start', 'window', 'expected'),
    [
        ((1.0, 0.5), 0.0, 2.0, (1.0, 0.5)),  # left of the path
        ((1.0, -0.5), 0.0, 2.0, (1.0, -0.5)),
        ((2.0, 2.0), 0.0, 2.0, (2.0, 2.0)),  # the second leg lies beyond the window
        ((2.0, 2.0), 2.5, 9.0, (5.0, 1.0)),
        ((4.0, 2.0), 3.0, 9.0, (5.0, -1.0)),
        ((1.0, 0.5), 2.0, 9.0, (2.0, 0.5)),  # never back before the start of the window
        ((3.0, 6.0), 6.0, 2.0, (7.0, 2.0)),  # beyond the end
        ((-3.0, 4.0), 0.0, 2.0, (0.0, 5.0)),  # before the beginning
        ((3.0, 3.5), 7.0, 2.0, (7.0, 0.0)),
    ],
)
def test_projection_by_hand(position, start, window, expected):
    s, distance = ReferencePath(ELBOW).project(np.array(position), start, window)
    assert (s, abs(distance)) == pytest.approx((expected[0], abs(expected[1])))
    if expected[1] and expected[0] not in (0.0, 7.0):
        assert math.copysign(1.0, distance) == math.copysign(1.0, expected[1])


@pytest.mark.parametrize(
    ('position', 'side'), [((0.5, 1.5), 1), ((1.5, 0.5), -1), ((0.9, 1.0), 1), ((2.5, -0.2), -1)]
)
def test_the_distance_is_positive_on_the_left_of_a_slanting_path(position, side):
    diagonal = ReferencePath(np.array([[0.0, 0.0], [2.0, 2.0]]))
    _, distance = diagonal.project(np.array(position), 0.0, 9.0)
    assert distance == pytest.approx((position[1] - position[0]) / math.sqrt(2.0))
    assert distance * side > 0.0
    _, behind = ReferencePath(np.array([[2.0, 2.0], [0.0, 0.0]])).project(
        np.array(position), 0.0, 9.0
    )
    assert behind == pytest.approx(-distance)


def test_a_single_waypoint_has_no_length():
    path = ReferencePath(np.array([[1.0, 2.0]]))
    assert path.length == 0.0
    assert path.project(np.array([4.0, 6.0]), 0.0, 2.0) == (0.0, 5.0)
    assert path.point_at(1.0).tolist() == [1.0, 2.0]
