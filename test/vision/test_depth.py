"""Depth images: units, validity, edges, back-projection and its covariance."""

import math

import numpy as np
import pytest

from explore_slam.data import Intrinsics
from explore_slam.vision.depth import (
    analyse_depth,
    back_project,
    camera_rays,
    depth_in_metres,
    point_covariances,
)
from explore_slam.vision.sections import DepthConfig

CAMERA = Intrinsics(320, 240, 250.0, 260.0, 160.0, 120.0)


def test_both_encodings_become_metres_and_missing_values_zero():
    millimetres = depth_in_metres(np.array([[0, 1, 1500, 65535]], np.uint16))
    np.testing.assert_allclose(millimetres, [[0.0, 0.001, 1.5, 65.535]], rtol=1e-6)
    metres = depth_in_metres(np.array([[np.nan, np.inf, -1.0, 0.0, 2.5]], np.float32))
    assert metres.tolist() == [[0.0, 0.0, 0.0, 0.0, 2.5]]
    assert millimetres.dtype == metres.dtype == np.float32


def test_depth_within_the_range_is_valid_both_ends_included():
    config = DepthConfig(min_depth=1.0, max_depth=2.0)
    for value, valid in ((0.99, False), (1.0, True), (1.5, True), (2.0, True), (2.01, False)):
        layers = analyse_depth(np.full((9, 9), value, np.float32), config)
        assert (layers.depth[4, 4] > 0.0) is np.bool_(valid)
        if valid:
            assert layers.depth[4, 4] == np.float32(value)


def test_the_spread_is_the_range_of_depths_within_two_pixels():
    depth = np.full((20, 20), 2.0, np.float32)
    depth[:, 12:] = 2.5
    upright = analyse_depth(depth, DepthConfig()).spread[10]
    lying = analyse_depth(np.ascontiguousarray(depth.T), DepthConfig()).spread[:, 10]
    for spread in (upright, lying):
        np.testing.assert_allclose(spread[:10], 0.0)
        np.testing.assert_allclose(spread[10:14], 0.5)
        np.testing.assert_allclose(spread[14:], 0.0)


def test_missing_depths_do_not_count_for_the_spread_but_depths_out_of_range_do():
    depth = np.full((20, 20), 2.0, np.float32)
    depth[:, 12:] = np.nan
    assert analyse_depth(depth, DepthConfig()).spread.max() == 0.0
    depth[:, 12:] = 9.0
    layers = analyse_depth(depth, DepthConfig())
    assert layers.spread[10, 11] == pytest.approx(7.0)
    assert layers.depth[10, 15] == layers.spread[10, 15] == 0.0


@pytest.mark.parametrize('wall', [3.40, 3.44, 3.48, 3.52])
def test_a_wall_at_the_end_of_the_range_of_the_camera_is_not_measured_too_near(wall):
    # a Kinect, whose readings beyond 3.5 m are missing: only the near half of the noise remains
    noise = 0.003 * wall**2
    measured = wall + noise * np.random.default_rng(7).standard_normal((240, 320))
    measured[measured > 3.5] = 0.0
    depth = analyse_depth(measured.astype(np.float32), DepthConfig()).depth
    valid = depth > 0.0
    assert abs(float((depth[valid] - wall).sum())) <= 0.1 * noise * depth.size
    if wall == 3.40:
        assert valid.mean() > 0.9


def test_rays_and_points_of_the_pinhole_model():
    pixels = np.array([[160.0, 120.0], [410.0, 120.0], [160.0, -140.0]])
    np.testing.assert_allclose(camera_rays(pixels, CAMERA), [[0, 0], [1, 0], [0, -1]])
    points = back_project(pixels, np.array([1.0, 2.0, 3.0]), CAMERA)
    np.testing.assert_allclose(points, [[0, 0, 1], [2, 0, 2], [0, -3, 3]])


def test_lens_distortion_without_effect_is_the_pinhole_model():
    zero = Intrinsics(320, 240, 250.0, 260.0, 160.0, 120.0, (0.0, 0.0, 0.0, 0.0, 0.0))
    tiny = Intrinsics(320, 240, 250.0, 260.0, 160.0, 120.0, (1e-9, 0.0, 0.0, 0.0))
    pixels = np.array([[10.0, 20.0], [300.0, 200.0]])
    expected = camera_rays(pixels, CAMERA)
    np.testing.assert_array_equal(camera_rays(pixels, zero), expected)
    np.testing.assert_allclose(camera_rays(pixels, tiny), expected, atol=1e-7)
    assert camera_rays(np.empty((0, 2)), tiny).shape == (0, 2)


def test_covariances_to_first_order_by_numeric_derivatives():
    pixels, depths = np.array([[200.0, 60.0], [10.0, 230.0]]), np.array([1.5, 3.0])
    pixel_noise, depth_noise = np.array([0.7, 1.2]), np.array([0.01, 0.05])
    points = back_project(pixels, depths, CAMERA)
    found = point_covariances(points, CAMERA, pixel_noise, depth_noise)
    h = 1e-5
    for row in range(2):
        columns = []
        for axis in range(3):
            step = np.zeros(3)
            step[axis] = h
            ends = [
                back_project(
                    pixels[row : row + 1] + sign * step[:2],
                    depths[row : row + 1] + sign * step[2],
                    CAMERA,
                )[0]
                for sign in (1.0, -1.0)
            ]
            columns.append((ends[0] - ends[1]) / (2.0 * h))
        jacobian = np.column_stack(columns)
        noise = np.array([pixel_noise[row], pixel_noise[row], depth_noise[row]]) ** 2
        np.testing.assert_allclose(
            found[row], jacobian @ np.diag(noise) @ jacobian.T, rtol=1e-6, atol=1e-12
        )
    assert math.isclose(found[0, 2, 2], 1e-4)
