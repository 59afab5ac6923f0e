"""Lowe's ratio test on landmarks."""

import numpy as np

from explore_slam.slam.association.ratio_test import is_distinctive
from explore_slam.slam.descriptors.kinds import SIFT

REFERENCE = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [5.0, 0.0, 0.0]])


def distinctive(nearest, distances, limit=0.4):
    found = is_distinctive(
        np.array([nearest]), np.array([distances], np.float32), REFERENCE, limit, SIFT
    )
    return bool(found[0])


def test_a_match_far_nearer_than_any_elsewhere_is_distinctive():
    assert distinctive([0, 2], [0.1, 0.2])
    assert not distinctive([0, 2], [0.15, 0.2])


def test_landmarks_at_the_same_place_do_not_compete():
    assert distinctive([0, 1], [0.15, 0.16])
    assert not distinctive([0, 1, 2], [0.15, 0.16, 0.17])


def test_the_limit_is_the_distance_of_landmarks_that_were_not_found():
    assert distinctive([0, -1], [0.25, np.inf])
    assert not distinctive([0, -1], [0.27, np.inf])


def test_a_nearly_equal_descriptor_is_distinctive_in_any_case():
    assert distinctive([0, 2], [0.019, 0.02])
    assert not distinctive([0, 2], [0.021, 0.022])


def test_nothing_found_is_not_distinctive():
    assert not distinctive([-1, -1], [np.inf, np.inf])
