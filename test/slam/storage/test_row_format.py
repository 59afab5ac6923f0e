"""Packed covariances against plain NumPy."""

import math

import numpy as np
import pytest

from explore_slam.slam.storage.row_format import (
    UPPER_TRIANGLE,
    covariance_in_vehicle_frame,
    packed,
    unpacked,
)


def covariance(seed):
    A = np.random.default_rng(seed).standard_normal((3, 3))
    return A @ A.T


@pytest.mark.parametrize('heading', [0.0, 0.4, -1.3, 2.9])
def test_covariances_are_rotated_into_the_vehicle_frame_and_back(heading):
    C, (c, s) = covariance(1), (math.cos(heading), math.sin(heading))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    six = covariance_in_vehicle_frame(c, s, *C[UPPER_TRIANGLE])
    np.testing.assert_allclose(six, (turn.T @ C @ turn)[UPPER_TRIANGLE], atol=1e-12)
    back = covariance_in_vehicle_frame(c, -s, *six)
    np.testing.assert_allclose(back, C[UPPER_TRIANGLE], atol=1e-12)


def test_packing_keeps_every_element():
    some = np.array([covariance(seed) for seed in range(5)])
    np.testing.assert_array_equal(packed(some), [C[UPPER_TRIANGLE] for C in some])
    np.testing.assert_array_equal(unpacked(packed(some)), some)
