"""Point clouds of scans: validity of readings, normals, deskewing, masks."""

import math

import numpy as np
import pytest
from registration.ray_caster import box, scan_of

from explore_slam.data import LaserScan
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.registration import PointCloud, merged, scan_cloud, thinned

ROOM = box(-3.0, -2.0, 3.0, 2.0)


def test_only_valid_readings_are_points():
    ranges = np.array([1.0, np.nan, np.inf, -np.inf, 0.0, 0.2, 9.0, 12.0, 2.0], np.float32)
    scan = LaserScan(0.0, 0.0, 0.1, ranges, 0.3, 10.0)
    cloud = scan_cloud(scan, farthest=8.0)
    np.testing.assert_allclose(np.hypot(*cloud.points.T), [1.0, 2.0], rtol=1e-6)
    np.testing.assert_allclose(np.arctan2(*cloud.points.T[::-1]), [0.0, 0.8], rtol=1e-6)
    nothing = LaserScan(0.0, 0.0, 0.1, np.full(5, np.nan, np.float32), 0.0, 10.0)
    assert len(scan_cloud(nothing)) == 0


def test_normals_are_across_the_walls_and_towards_the_laser():
    laser = Pose2(0.3, -0.1, 0.4)
    cloud = scan_cloud(scan_of(ROOM, laser), laser)
    points, normals = cloud.surfaces
    assert len(points) > 150
    np.testing.assert_allclose(np.hypot(*normals.T), 1.0)
    assert (((points - (laser.x, laser.y)) * normals).sum(axis=1) < 0.0).all()
    on_side = np.abs(np.abs(points[:, 0]) - 3.0) < 1e-5
    corner = (np.abs(points[:, 0]) > 2.5) & (np.abs(points[:, 1]) > 1.5)
    clear = on_side & ~corner
    assert clear.sum() > 10
    np.testing.assert_allclose(np.abs(normals[clear, 0]), 1.0, atol=1e-3)


def test_a_lone_return_has_no_normal():
    ranges = np.full(41, np.inf, np.float32)
    ranges[20] = 2.0
    cloud = scan_cloud(LaserScan(0.0, -0.35, 0.0175, ranges, 0.0, 10.0))
    assert len(cloud) == 1
    assert not cloud.on_surfaces.any()


def test_bodies_are_masked():
    cloud = scan_cloud(scan_of(np.vstack([ROOM, box(1.0, -0.2, 1.4, 0.2)]), IDENTITY))
    inside = np.hypot(cloud.points[:, 0] - 1.2, cloud.points[:, 1]) < 0.4
    assert inside.sum() > 5
    left = cloud.masked([(1.2, 0.0, 0.4), (50.0, 0.0, 1.0)])
    np.testing.assert_array_equal(left.points, cloud.points[~inside])
    assert cloud.masked([]) is cloud
    with pytest.raises(match='discs'):
        cloud.masked([(math.nan, 0.0, 1.0)])


def test_moved_and_merged_clouds():
    cloud = scan_cloud(scan_of(ROOM, IDENTITY))
    there = Pose2(1.0, 2.0, 0.7)
    back = cloud.moved(there).moved(there.inverse())
    np.testing.assert_allclose(back.points, cloud.points, atol=1e-12)
    np.testing.assert_allclose(back.normals, cloud.normals, atol=1e-12)
    np.testing.assert_allclose(back.sparse_points, cloud.sparse_points, atol=1e-12)
    both = merged([cloud, cloud.moved(there)])
    assert len(both) == 2 * len(cloud)
    assert len(merged([])) == 0


def test_returns_nearby_that_graze_their_surface_weigh_little():
    hall = box(-2.0, -1.0, 20.0, 1.0)
    cloud = scan_cloud(scan_of(hall, IDENTITY))
    (points, _), weights = cloud.surfaces, cloud.surface_weights
    assert len(weights) == len(points)
    ahead, beside = points[:, 0], np.abs(np.abs(points[:, 1]) - 1.0) < 1e-5
    # half for a cosine of 0.2, at 4.9 m along a wall 1 m away
    np.testing.assert_allclose(weights[beside & (ahead > 4.0) & (ahead < 4.9)], 0.55, atol=0.07)
    assert (weights[beside & (ahead < 0.5)] > 0.95).all()
    far = beside & (ahead > 5.0)
    assert far.any()
    assert (weights[far] == 1.0).all()  # the heading in a long corridor depends on them


def test_thinning_leaves_one_point_in_a_square():
    points = np.random.default_rng(1).uniform(-2.0, 2.0, (2000, 2))
    thin = thinned(points, 0.5)
    assert 64 <= len(thin) <= 81
    squares = {tuple(row) for row in np.round(thin / 0.5).astype(int)}
    assert len(squares) == len(thin)
    assert squares == {tuple(row) for row in np.round(points / 0.5).astype(int)}


def test_bad_input_is_named():
    points = np.zeros((3, 2))
    with pytest.raises(match=r'normals has shape \(2, 2\)'):
        PointCloud(points, np.zeros((2, 2)), np.zeros(3))
    with pytest.raises(match=r'weights has shape \(2,\)'):
        PointCloud(points, points, np.zeros(2))
    with pytest.raises(match='points holds'):
        PointCloud(np.full((3, 2), np.nan), points, np.zeros(3))
