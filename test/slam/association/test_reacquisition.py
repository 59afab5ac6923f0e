"""Lone matches: a landmark that a vehicle returns to counts when others confirm it."""

import numpy as np
import pytest

from explore_slam.slam.association.reacquisition import without_lone_matches
from explore_slam.slam.association.state import CandidateSet, Observed

SAME = 0.02


def found(candidates, distances):
    """Return K observations with candidates (K, J) and descriptor distances (K, J)."""
    count = len(candidates)
    observed = Observed(np.zeros((count, 3)), np.ones((count, 6)))
    candidates = np.array(candidates)
    entries = np.arange(candidates.max() + 1)
    similar = np.where(candidates >= 0, candidates + 100, -1)
    return CandidateSet(
        observed, observed, np.zeros((count, 32), np.float32), entries, candidates,
        np.array(distances), similar, np.ones(count, bool),
    )  # fmt: skip


def chosen(candidates):
    """Return the support of particles that all choose the first candidate."""
    support = np.zeros(np.shape(candidates))
    support[:, 0] = np.array(candidates)[:, 0] >= 0
    return support


@pytest.mark.parametrize('returning', [1, 2])
def test_one_or_two_reacquired_landmarks_are_left_out(returning):
    candidates = [[0, -1], [1, -1], [2, -1], [3, -1], [-1, -1]]
    ages = np.full(4, 0.5)
    ages[:returning] = 7.0
    fewer = without_lone_matches(
        found(candidates, np.full((5, 2), 0.1)), chosen(candidates), ages, SAME
    )
    assert (fewer.candidates[:returning] < 0).all()
    np.testing.assert_array_equal(fewer.candidates[returning:], candidates[returning:])
    np.testing.assert_array_equal(fewer.withheld, np.arange(5) < returning)
    assert not fewer.is_distinctive[:returning].any()
    assert fewer.is_distinctive[returning:].all()
    assert (fewer.similar_ids[:returning] < 0).all()


def test_three_reacquired_landmarks_confirm_each_other():
    candidates = [[0], [1], [2], [3]]
    ages = np.array([7.0, 7.5, 8.0, 0.2])
    assert (
        without_lone_matches(
            found(candidates, np.full((4, 1), 0.1)), chosen(candidates), ages, SAME
        )
        is None
    )


def test_with_many_observations_more_are_needed():
    """Three of 400 may be alike by chance."""
    candidates = [[k] if k < 3 else [-1] for k in range(400)]
    ages = np.full(3, np.inf)
    fewer = without_lone_matches(
        found(candidates, np.full((400, 1), 0.1)), chosen(candidates), ages, SAME
    )
    assert (fewer.candidates < 0).all()
    assert np.count_nonzero(fewer.withheld) == 3


def test_a_descriptor_that_names_the_landmark_needs_no_confirmation():
    candidates = [[0], [1]]
    ages = np.array([7.0, 7.0])
    fewer = without_lone_matches(found(candidates, [[0.0], [0.3]]), chosen(candidates), ages, SAME)
    np.testing.assert_array_equal(fewer.candidates, [[0], [-1]])


def test_the_other_candidate_of_an_observation_remains():
    """An old look-alike goes, the landmark observed just before stays."""
    candidates = [[0, 1], [-1, -1]]
    ages = np.array([np.inf, 0.0])
    fewer = without_lone_matches(
        found(candidates, np.full((2, 2), 0.1)), chosen(candidates), ages, SAME
    )
    np.testing.assert_array_equal(fewer.candidates, [[-1, 1], [-1, -1]])


def test_an_old_landmark_out_of_the_gate_does_not_keep_an_observation_from_the_map():
    """No particle has chosen that of the second observation; the first one's is left out."""
    candidates = [[0], [1], [-1]]
    support = np.array([[1.0], [0.0], [0.0]])
    fewer = without_lone_matches(
        found(candidates, np.full((3, 1), 0.1)), support, np.array([7.0, 70.0]), SAME
    )
    assert (fewer.candidates < 0).all()
    np.testing.assert_array_equal(fewer.withheld, [True, False, False])


def test_lone_matches_that_no_particle_has_chosen_need_no_second_proposal():
    candidates = [[0], [1], [-1]]
    assert (
        without_lone_matches(
            found(candidates, np.full((3, 1), 0.1)), np.zeros((3, 1)), np.array([7.0, 70.0]), SAME
        )
        is None
    )


def test_landmarks_of_a_later_visit_do_not_confirm_those_of_an_earlier_one():
    """Those mapped since the vehicle lost sight of the old ones share the error of its pose."""
    candidates = [[k] for k in range(6)]
    ages = np.array([20.0, 21.0, 3.0, 3.5, 4.2, 0.5])
    fewer = without_lone_matches(
        found(candidates, np.full((6, 1), 0.1)), chosen(candidates), ages, SAME
    )
    np.testing.assert_array_equal(fewer.candidates[:, 0], [-1, -1, 2, 3, 4, 5])
    np.testing.assert_array_equal(fewer.withheld, [True, True, False, False, False, False])


def test_another_candidate_of_a_confirmed_visit_is_left_to_the_particles():
    candidates = [[0, -1], [1, -1], [2, -1], [3, 4]]
    ages = np.array([7.0, 7.0, 7.0, 0.5, 7.3])
    assert (
        without_lone_matches(
            found(candidates, np.full((4, 2), 0.1)), chosen(candidates), ages, SAME
        )
        is None
    )
