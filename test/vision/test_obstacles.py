"""Obstacles in depth images of scenes that are cast exactly: tables, steps, tilted mounts."""

import logging
import math
from dataclasses import replace

import numpy as np
import pytest
from vision.depth_scenes import CAMERA, MOUNT, TABLE, cast, frame

from explore_slam.data import HOLE_BIT, OBSTACLE_CELL, Intrinsics, RgbdFrame
from explore_slam.geometry import rotation_matrix
from explore_slam.settings import with_values
from explore_slam.vision import CameraMount, VisionConfig, obstacles
from explore_slam.vision.level_rays import Band, Rays
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


# -- mounts and images that cannot be right ------------------------------------------------------


def warnings(caplog):
    return [r.getMessage() for r in caplog.records if r.levelno == logging.WARNING]


def shows_nothing(found, one):
    """Return whether neither the view nor the scan of a frame contains anything."""
    return len(found.detect(one)) == 0 and bool(np.isnan(found.scan(one).ranges).all())


@pytest.mark.parametrize('z', [-0.3, 0.0])
def test_a_camera_at_or_below_the_floor_shows_nothing_and_is_named_once(z, caplog):
    found = ObstacleDetector(mount=CameraMount(0.1, 0.0, z, pitch=0.3), vehicle='robot1')
    for stamp in range(3):
        one = replace(frame(np.full((240, 320), 2.0, np.float32), stamp), sensor='front')
        assert shows_nothing(found, one)
    (warning,) = warnings(caplog)
    assert warning.startswith(f'robot1: front is mounted at z = {z:.3f} m')


@pytest.mark.parametrize('slope', [-1e-5, -0.5, 0.0, 0.5])
def test_a_ray_from_below_the_floor_shows_no_hole(slope):
    """Interpret the kernel: compiled, an index out of bounds is not an error, but a crash."""
    flat = np.zeros((4, 6), np.float32)
    rays = Rays(flat + 1, flat, flat + np.float32(slope))
    view = obstacles._View(0, 0.02, 1, 40, 9)
    band = Band(0.06, 0.9, 0.06, 0.003)
    bins, depth = flat.astype(np.int32), flat + 0.5
    occupied, _ = obstacles._sort.py_func(rays, bins, depth, (0.0, 0.0), -0.4, view, band)
    assert not occupied.any()


NO_READINGS = [
    np.zeros((240, 320), np.float32),
    np.full((240, 320), np.nan, np.float32),
    np.zeros((240, 320), np.uint16),
]


@pytest.mark.parametrize('depth', NO_READINGS, ids=['zero', 'NaN', 'mm'])
def test_a_camera_without_readings_for_long_is_named_once_each_time(depth, caplog):
    found = detector()

    def look(image, number):
        for stamp in range(number):
            one = replace(frame(image, stamp), sensor='front')
            found.scan(one)
            found.detect(one)
        return len(warnings(caplog))

    assert look(depth, 29) == 0
    assert look(depth, 1) == 1
    assert warnings(caplog)[0].startswith('robot1: front: no pixel of the last 30 depth images')
    assert look(depth, 60) == 1
    assert look(cast(), 1) == 1
    assert look(depth, 29) == 1
    assert look(depth, 31) == 2


def test_a_camera_without_readings_does_not_count_those_of_another(caplog):
    found = detector()
    for stamp in range(30):
        found.detect(replace(frame(cast(), stamp), sensor='front'))
        found.detect(replace(frame(NO_READINGS[0], stamp), sensor='rear'))
    (warning,) = warnings(caplog)
    assert 'rear' in warning


@pytest.mark.parametrize('fx', [1e-300, 0.001, 4.0])
def test_a_focal_length_of_no_camera_shows_nothing_and_is_named_once(fx, caplog):
    found = detector()
    for stamp in range(3):
        one = replace(frame(cast(), stamp), intrinsics=replace(CAMERA, fx=fx), sensor='front')
        assert shows_nothing(found, one)
    (warning,) = warnings(caplog)
    assert warning.startswith(f'robot1: front: with fx = {fx:g} and cx = 159.5, images of 320')
    assert 'none of them (fx is below 5)' in warning


def test_a_focal_length_below_that_of_an_image_of_one_column_needs_no_memory(caplog):
    tiny = Intrinsics(1, 1, 0.001, 1.0, 0.0, 0.0)
    one = RgbdFrame(0.0, np.zeros((1, 1), np.uint8), np.ones((1, 1), np.float32), tiny)
    assert shows_nothing(detector(), one)
    assert len(warnings(caplog)) == 1


def test_a_view_is_at_most_160_degrees_wide(caplog):
    found = detector()
    for stamp in range(3):
        one = replace(frame(cast(), stamp), intrinsics=replace(CAMERA, fx=20.0))
        view, scan = found.detect(one), found.scan(one)
    bearings = np.arctan2(view.points[:, 1], view.points[:, 0] - MOUNT.x)
    far = view.points[:, 0] - MOUNT.x > 5 * OBSTACLE_CELL  # a cell is narrow from there
    assert math.radians(70.0) < np.abs(bearings[far]).max() < math.radians(81.0)
    assert np.abs(scan.angles).max() < math.radians(81.0)
    (warning,) = warnings(caplog)
    assert 'reach 82.9 degrees to the side, expected at most 80' in warning


@pytest.mark.parametrize(
    ('said', 'expected'),
    [
        (CameraMount(0.1, 0.0, 0.47, pitch=0.2), ('tilted by 0.0 degrees', '-0.130 m')),
        (CameraMount(0.1, 0.0, 0.6, pitch=0.2 - math.radians(15.0)), ('tilted by 15.4',)),
        (CameraMount(0.1, 0.0, 0.6, pitch=0.2 + math.radians(20.0)), ('tilted by -20.9',)),
    ],
)
@pytest.mark.parametrize('call', ['detect', 'scan'])
def test_a_floor_far_from_where_the_mount_has_it_is_named_once(said, expected, call, caplog):
    depth = cast(CameraMount(0.1, 0.0, 0.6, pitch=0.2), limit=5.0)
    found = ObstacleDetector(mount=said, vehicle='robot1')
    for stamp in range(60):
        getattr(found, call)(replace(frame(depth, stamp), sensor='front'))
        assert len(warnings(caplog)) == (stamp >= 19)
    (warning,) = warnings(caplog)
    assert warning.startswith('robot1: front sees no floor near where its mount has it')
    assert '100 % of the readings' in warning
    assert all(value in warning for value in expected)


@pytest.mark.parametrize('wall', [0.8, 2.0])
@pytest.mark.parametrize('yaw', [0.0, 0.5, 1.0])
@pytest.mark.parametrize('z', [0.4, 1.2])  # from 1.2 m, no floor is in view
def test_a_wall_is_no_floor(wall, yaw, z, caplog):
    mount = CameraMount(0.1, 0.0, z, yaw=yaw)
    found, depth = ObstacleDetector(mount=mount), cast(mount, wall=wall, noise=0.003, limit=5.0)
    for stamp in range(25):
        found.detect(frame(depth, stamp))
    assert not warnings(caplog)


def test_a_step_down_is_no_floor_once_the_floor_is_known(caplog):
    found = detector()
    for stamp in range(40):
        found.detect(frame(cast(pit=(9.0 if stamp < 10 else 0.3, 0.18), limit=5.0), stamp))
    assert not warnings(caplog)
    assert found.floor().height == pytest.approx(0.0, abs=0.01)


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


def test_scans_are_levelled_by_the_floor_from_the_first_frame_on(caplog):
    depth = cast(TILTED, noise=0.003, limit=5.0)
    found = detector()
    for stamp in range(6):
        scan = found.scan(frame(depth, stamp))
        assert not np.isfinite(scan.ranges).any()  # floor alone; without it, an obstacle
    assert found.floor().along == pytest.approx(0.07, abs=0.008)
    (warning,) = warnings(caplog)
    assert 'camera_pitch +0.07' in warning


def test_a_frame_is_prepared_once_for_its_scans_and_its_view(monkeypatch):
    """A frame may wait for odometry while the scans of newer ones are made."""
    prepared = []
    convert = obstacles.depth_in_metres
    monkeypatch.setattr(
        obstacles, 'depth_in_metres', lambda depth: prepared.append(1) or convert(depth)
    )
    found = detector()
    frames = [frame(cast(wall=1.5 + 0.1 * number), number) for number in range(3)]
    scans = [found.scan(one) for one in frames]
    views = [found.detect(one) for one in frames]
    assert len(prepared) == 3
    alone = detector()
    for one, scan, view in zip(frames, scans, views, strict=True):
        assert scan.stamp == view.stamp == one.stamp
        assert view.cells.tobytes() == alone.detect(one).cells.tobytes()
    found.detect(replace(frames[2]))  # equal, but another one
    assert len(prepared) == 7
