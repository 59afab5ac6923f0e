"""Obstacles in depth images of scenes that are cast exactly: tables, steps, tilted mounts."""

import logging
import math

import numpy as np
import pytest
from vision.depth_scenes import MOUNT, TABLE, cast, frame

from explore_slam.data import HOLE_BIT, OBSTACLE_CELL
from explore_slam.geometry import rotation_matrix
from explore_slam.settings import with_values
from explore_slam.vision import CameraMount, VisionConfig
from explore_slam.vision.obstacles import ObstacleDetector


def detector(**values):
    return ObstacleDetector(with_values(VisionConfig(), values), MOUNT, 'robot1')


def box(view, x0, x1, y0, y1):
    """Return which cells of a view have their centre in a rectangle."""
    x, y = view.points.T
    return (x > x0) & (x < x1) & (y > y0) & (y < y1)


def heights(bits):
    """Return the heights (m) of the lower side of the slices of which a cell has bits."""
    return sorted({piece / 10 for piece in range(HOLE_BIT) if (bits >> piece & 1).any()})


def test_a_table_top_fills_its_cells_in_its_slice_and_the_space_below_is_free():
    view = detector().detect(frame(cast(tables=[TABLE], noise=0.003, limit=3.5)))
    x0, x1, y0, y1, _ = TABLE
    top = box(view, x0, x1, y0, y1)
    expected = round((x1 - x0) / OBSTACLE_CELL) * round((y1 - y0) / OBSTACLE_CELL)
    assert (view.occupied[top] > 0).sum() > 0.97 * expected
    assert heights(view.occupied) == [0.6]
    elsewhere = ~box(view, x0 - 0.08, x1 + 0.08, y0 - 0.08, y1 + 0.08)
    assert not view.occupied[elsewhere].any()
    assert (view.free[top] & 1).mean() > 0.9  # just above the floor
    assert not (view.free[top & (view.occupied > 0)] & (1 << 6)).any()


def test_what_lies_on_the_floor_counts_from_its_height_on():
    low = [(1.5, 1.8, -0.3, 0.3, 0.10)]
    assert detector().detect(frame(cast(tables=low))).occupied.any()
    assert not detector(obstacle_lowest=0.13).detect(frame(cast(tables=low))).occupied.any()
    flat = detector().detect(frame(cast(noise=0.003, limit=3.5)))
    assert not flat.occupied.any()


def test_the_ceiling_of_the_band_and_its_range_are_respected():
    view = detector(obstacle_highest=0.6).detect(frame(cast(tables=[TABLE])))
    assert not view.occupied.any()
    view = detector(obstacle_range=2.0).detect(frame(cast(tables=[TABLE])))
    assert view.points[view.occupied > 0, 0].max() < 2.0 + MOUNT.x + OBSTACLE_CELL
    assert view.points[:, 0].max() < 2.0 + MOUNT.x + OBSTACLE_CELL


@pytest.mark.parametrize('edge', [1.3, 2.0])
def test_a_step_down_begins_at_its_edge_and_the_floor_before_it_is_none(edge):
    view = detector().detect(frame(cast(pit=(edge, 0.18), noise=0.003, limit=3.5)))
    hole = (view.occupied >> HOLE_BIT & 1) > 0
    ahead = np.abs(view.points[:, 1]) < 0.3
    assert view.points[hole & ahead, 0].min() == pytest.approx(edge, abs=OBSTACLE_CELL)
    floor = (view.free >> HOLE_BIT & 1) > 0
    assert view.points[floor & ahead, 0].max() == pytest.approx(edge, abs=2 * OBSTACLE_CELL)
    assert not (
        detector(step_depth=0.4).detect(frame(cast(pit=(edge, 0.18)))).occupied >> 15
    ).any()


def test_no_reading_says_nothing():
    view = detector().detect(frame(np.zeros((240, 320), np.float32)))
    assert len(view) == 0
    half = cast(tables=[TABLE])
    half[:, :160] = np.nan  # the left
    view = detector().detect(frame(half))
    assert len(view) > 0
    assert view.points[:, 1].max() < OBSTACLE_CELL


def test_a_wall_is_an_obstacle_up_to_its_face_and_nothing_behind_it_is_free():
    view = detector().detect(frame(cast(wall=2.2, noise=0.003, limit=3.5)))
    wall = box(view, 2.1, 2.3, -0.8, 0.8)
    assert (view.occupied[wall] > 0).sum() >= 2 * round(1.6 / OBSTACLE_CELL) - 2
    ahead = view.points[:, 0]
    assert ahead[view.occupied > 0].min() > 2.2 - 0.1
    assert ahead[view.occupied > 0].max() < 2.2 + 0.1
    assert ahead[view.free > 0].max() < 2.2 + 0.05
    assert len(heights(view.occupied)) == 9  # all of the band


@pytest.mark.parametrize('dtype', [np.uint16, np.float32])
def test_both_encodings_of_depth_show_the_same(dtype):
    depth = np.rint(cast(tables=[TABLE]) * 1000.0)
    given = depth.astype(np.uint16) if dtype is np.uint16 else (depth * 1e-3).astype(np.float32)
    usual = detector().detect(frame((depth * 1e-3).astype(np.float32)))
    view = detector().detect(frame(given))
    assert np.count_nonzero(view.occupied) == pytest.approx(
        np.count_nonzero(usual.occupied), abs=2
    )


def test_a_camera_on_the_side_sees_in_the_vehicle_frame():
    mount = CameraMount(0.0, 0.2, 0.4, yaw=math.pi / 2)
    turned = rotation_matrix(0.0, 0.0, math.pi / 2)[:2, :2]
    depth = cast(CameraMount(0.0, 0.0, 0.4), tables=[TABLE])
    view = ObstacleDetector(mount=mount).detect(frame(depth))
    middle = view.points[view.occupied > 0].mean(axis=0)
    expected = turned @ (2.1, 0.0) + (0.0, 0.2)
    assert middle == pytest.approx(expected, abs=0.1)


TILTED = CameraMount(0.1, 0.0, 0.45, roll=0.03, pitch=0.07)


def test_a_mount_that_is_off_is_corrected_by_the_floor_and_named_once(caplog):
    found = detector()
    with caplog.at_level(logging.WARNING):
        for stamp in range(8):
            view = found.detect(frame(cast(TILTED, tables=[TABLE], noise=0.003, limit=3.5), stamp))
    (warning,) = [r.getMessage() for r in caplog.records if 'robot1' in r.getMessage()]
    assert 'camera_pitch +0.07' in warning
    floor = found.floor()
    assert floor.along == pytest.approx(0.07, abs=0.008)
    assert floor.across == pytest.approx(-0.03, abs=0.008)
    assert floor.height == pytest.approx(-0.05, abs=0.015)
    assert heights(view.occupied) == [0.6]
    x0, x1, y0, y1, _ = TABLE
    assert not view.occupied[~box(view, x0 - 0.15, x1 + 0.15, y0 - 0.15, y1 + 0.15)].any()


def test_a_mount_that_is_right_is_not_complained_of(caplog):
    found = detector()
    with caplog.at_level(logging.WARNING):
        for stamp in range(8):
            found.detect(frame(cast(pit=(1.8, 0.18), noise=0.003, limit=3.5), stamp))
    assert not caplog.records
    assert max(map(abs, found.floor())) < 0.02


# -- scans of vehicles without a laser -----------------------------------------------------------


def test_the_scan_of_a_camera_is_that_of_a_laser_in_its_place():
    scan = detector().scan(frame(cast(wall=2.2, noise=0.003, limit=3.5)))
    hit = np.isfinite(scan.ranges)
    assert hit.sum() == scan.ranges.size == pytest.approx(115, abs=2)  # 57.6 degrees
    expected = (2.2 - MOUNT.x) / np.cos(scan.angles)
    assert np.abs(scan.ranges - expected).max() < 0.02
    assert abs(float((scan.ranges - expected).mean())) < 0.003
    assert scan.mount == (MOUNT.x, MOUNT.y, 0.0)


def test_beams_over_open_floor_have_no_return_and_those_without_readings_no_measurement():
    open_floor = cast(noise=0.003, limit=3.5)
    assert np.isposinf(detector().scan(frame(open_floor)).ranges).all()
    near = open_floor.copy()
    near[near > 2.0] = 0.0  # something dark: the floor is seen up to there alone
    assert np.isnan(detector().scan(frame(near)).ranges).all()


def test_a_scan_of_a_camera_passes_below_table_tops_and_ends_at_lower_things():
    below = detector().scan(frame(cast(tables=[TABLE], limit=3.5))).ranges
    assert np.isposinf(below[30:80]).all()
    low = detector().scan(frame(cast(tables=[(1.6, 2.6, -0.6, 0.6, 0.3)], limit=3.5))).ranges
    # a sheet without a front: the mean of the nearest 0.15 m of it
    assert np.nanmin(low) == pytest.approx(1.6 - MOUNT.x, abs=0.16)
