"""Polylines: arc lengths, points at them, projection, what lies ahead; values by hand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from explore_slam.polyline import (
    arc_lengths,
    points_at,
    project,
    remaining_path,
    sample,
    truncated,
)

ELBOW = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 6.0]])


def test_arc_lengths_and_points_at_them():
    lengths = arc_lengths(ELBOW)
    assert lengths.tolist() == [0.0, 5.0, 7.0]
    found = points_at(ELBOW, lengths, np.array([-1.0, 2.5, 5.0, 6.0, 9.0]))
    np.testing.assert_allclose(found, [[0, 0], [1.5, 2], [3, 4], [3, 5], [3, 6]])
    assert arc_lengths(ELBOW[:1]).tolist() == [0.0]


@pytest.mark.parametrize(
    ('limit', 'end', 'count'), [(2.5, (1.5, 2.0), 2), (5.0, (3.0, 4.0), 2), (6.0, (3.0, 5.0), 3)]
)
def test_truncated_ends_at_the_arc_length(limit, end, count):
    cut = truncated(ELBOW, limit)
    assert cut.shape == (count, 2)
    np.testing.assert_allclose(cut[-1], end)
    assert arc_lengths(cut)[-1] == pytest.approx(limit)


def test_truncated_beyond_the_end_is_the_whole():
    assert truncated(ELBOW, 7.0) is ELBOW


@pytest.mark.parametrize(
    ('position', 'expected'),
    [
        ((2.3, 1.4), (0, (2.3 * 3 + 1.4 * 4) / 25, abs(2.3 * 4 - 1.4 * 3) / 5)),
        ((-1.0, -1.0), (0, 0.0, math.sqrt(2.0))),
        ((5.0, 5.0), (1, 0.5, 2.0)),
        ((3.0, 9.0), (1, 1.0, 3.0)),
        ((3.0, 4.0), (0, 1.0, 0.0)),
    ],
)
def test_projection_by_hand(position, expected):
    index, share, distance = project(ELBOW, np.array(position))
    assert (index, share) == (expected[0], pytest.approx(expected[1]))
    assert distance == pytest.approx(expected[2])


@given(st.tuples(st.floats(-5, 8), st.floats(-5, 8)))
def test_no_point_of_the_polyline_is_nearer_than_the_projection(position):
    _, _, distance = project(ELBOW, np.array(position))
    dense = points_at(ELBOW, arc_lengths(ELBOW), np.linspace(0.0, 7.0, 2001))
    nearest = np.hypot(*(dense - position).T).min()
    assert distance <= nearest + 1e-9
    assert nearest <= distance + 0.0018  # half the spacing of the dense points


def test_samples_are_evenly_spaced_and_hold_both_ends():
    found = sample(ELBOW, 2.5)
    np.testing.assert_allclose(found, [[0, 0], [1.5, 2], [3, 4], [3, 6]])
    assert sample(ELBOW[:1], 2.0).tolist() == [[0.0, 0.0]]


def test_the_remaining_path_starts_at_the_position_and_drops_what_is_behind():
    ahead = remaining_path(np.array([1.5, 2.1]), ELBOW)
    assert ahead.tolist() == [[1.5, 2.1], [3.0, 4.0], [3.0, 6.0]]
    last = remaining_path(np.array([3.1, 5.9]), ELBOW)
    assert last.tolist() == [[3.1, 5.9], [3.0, 6.0]]
    before = remaining_path(np.array([-1.0, 0.0]), ELBOW)
    assert before.tolist() == [[-1.0, 0.0], [3.0, 4.0], [3.0, 6.0]]


def test_repeated_and_single_waypoints_do_no_harm():
    doubled = np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 0.0]])
    assert remaining_path(np.array([0.5, 0.0]), doubled).tolist() == [[0.5, 0.0], [1.0, 0.0]]
    alone = remaining_path(np.array([1.0, 1.0]), np.array([[2.0, 2.0]]))
    assert alone.tolist() == [[1.0, 1.0], [2.0, 2.0]]
