"""Association of engine paper: gate at P0, then the least descriptor distance."""

import numpy as np
import pytest

from explore_slam.slam.association.gating import associate
from explore_slam.slam.association.state import Associations, CandidateRows, Observed


def chosen(distances, offsets, gate=9.0, absent=()):
    """Associate one observation at (2, 0, 0), sigma 0.1; candidates lie offsets (m) beside it."""
    count = len(offsets)
    rows = np.zeros((count, 9, 1))
    for n, offset in enumerate(offsets):
        rows[n, :, 0] = [2.0, offset, 0.0, 0.01, 0.0, 0.0, 0.01, 0.0, 0.01]
        if n in absent:
            rows[n, 3, 0] = 0.0
    candidates = CandidateRows(
        rows, np.arange(count), np.arange(count)[None], np.array([distances]),
        np.zeros(count, bool),
    )  # fmt: skip
    observed = Observed(np.array([[2.0, 0.0, 0.0]]), np.array([[0.01, 0.0, 0.0, 0.01, 0.0, 0.01]]))
    found = Associations.undecided(1, 1)
    associate(candidates, observed, np.zeros((1, 3)), gate, found)
    return int(found.choice[0, 0]), float(found.mahalanobis_squared[0, 0])


def test_the_least_descriptor_distance_wins_among_the_gated():
    choice, square = chosen([0.3, 0.1, 0.2], [0.0, 0.2, 0.1])
    assert choice == 1
    assert square == pytest.approx(0.2**2 / 0.02)


def test_candidates_beyond_the_gate_are_left_out():
    assert chosen([0.3, 0.1], [0.0, 0.5])[0] == 0


def test_equal_descriptors_are_distinguished_by_position():
    assert chosen([0.1, 0.1], [0.2, 0.1])[0] == 1


def test_without_a_gated_candidate_the_nearest_sets_the_square():
    choice, square = chosen([0.1, 0.2], [1.0, 0.8])
    assert choice == -1
    assert square == pytest.approx(0.8**2 / 0.02)


def test_absent_landmarks_are_not_candidates():
    assert chosen([0.1], [0.0], absent=(0,)) == (-1, np.inf)
