"""The grid along a path: incremental drawing equals drawing from scratch, bit for bit."""

import math
from dataclasses import replace

import numpy as np
import pytest
from grids import same_grid

from explore_slam.data import LaserScan
from explore_slam.errors import MappingError
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.mapping import MAP_FRAME, GridConfig, LaserMap, VehicleDisc
from explore_slam.mapping.path_drawing import snapshot_positions


@pytest.fixture
def generator():
    return np.random.default_rng(3)


def random_scan(generator):
    ranges = generator.uniform(0.5, 6.0, 61).astype(np.float32)
    ranges[generator.random(61) < 0.1] = np.inf
    return LaserScan(0.0, -1.5, 0.05, ranges, 0.1, 30.0)


def add_scans(laser_map, generator, count, first=0):
    for keyframe in range(first, first + count):
        bodies = [VehicleDisc(keyframe - 1, Pose2(0.4, 0.1, 0.0), 0.4)] if keyframe else []
        laser_map.add(
            keyframe, f'robot{keyframe % 3}', random_scan(generator), Pose2(0.1, 0.0, 0.1), bodies
        )


def from_scratch(laser_map, path):
    other = LaserMap(laser_map.config)
    for item in laser_map.scans:
        other.add(*item)
    other.redraw(path)
    return other.grid


def test_redrawing_where_lineages_part_equals_drawing_from_scratch(generator):
    laser_map = LaserMap(GridConfig(resolution=0.1))
    path = np.cumsum(generator.normal(0.0, 0.4, (200, 3)), axis=0)
    add_scans(laser_map, generator, 200)
    summary = laser_map.redraw(path)
    assert (summary.kept, summary.drawn, summary.waiting) == (0, 200, 0)
    for first in (199, 150, 47, 3, 180, 0):
        path = path.copy()
        path[first:] += generator.normal(0.0, 0.5, (200 - first, 3))
        summary = laser_map.redraw(path)
        assert summary.kept <= first
        assert summary.kept + summary.drawn == 200
        assert same_grid(laser_map.grid, from_scratch(laser_map, path))


def test_an_unchanged_path_draws_new_scans_only(generator):
    laser_map = LaserMap()
    path = np.cumsum(generator.normal(0.0, 0.4, (60, 3)), axis=0)
    add_scans(laser_map, generator, 40)
    laser_map.redraw(path[:40])
    grid = laser_map.grid
    add_scans(laser_map, generator, 20, first=40)
    summary = laser_map.redraw(path)
    assert (summary.kept, summary.drawn) == (40, 20)
    assert laser_map.grid is grid
    assert same_grid(grid, from_scratch(laser_map, path))


def test_a_late_change_starts_from_a_near_snapshot(generator):
    laser_map = LaserMap(GridConfig(resolution=0.2))
    path = np.cumsum(generator.normal(0.0, 0.2, (500, 3)), axis=0)
    add_scans(laser_map, generator, 500)
    laser_map.redraw(path)
    path[490:, 0] += 0.5
    assert laser_map.redraw(path).drawn <= 2 * 10 + 32


def test_what_is_not_in_the_map_yet_is_drawn_when_it_is(generator):
    """Scans of a vehicle of unknown start wait, and do not cover anything either."""
    laser_map, without = LaserMap(), LaserMap()
    path = np.cumsum(generator.normal(0.0, 0.4, (120, 3)), axis=0)
    add_scans(laser_map, generator, 120)
    in_map = np.arange(120) % 3 != 1
    for item in laser_map.scans:
        if in_map[item.keyframe]:
            without.add(*item[:-1], [body for body in item.bodies if in_map[body.keyframe]])
    laser_map.redraw(path, in_map)
    without.redraw(path)
    assert same_grid(laser_map.grid, without.grid)
    assert laser_map.redraw(path, in_map).drawn == 0
    summary = laser_map.redraw(path)
    assert summary.drawn > 110
    assert same_grid(laser_map.grid, from_scratch(laser_map, path))
    with pytest.raises(MappingError, match='in_map has shape'):
        laser_map.redraw(path, in_map[:5])


def test_without_memory_for_snapshots_the_result_is_the_same(generator):
    laser_map = LaserMap(GridConfig(snapshot_memory=0.0))
    path = np.cumsum(generator.normal(0.0, 0.2, (50, 3)), axis=0)
    add_scans(laser_map, generator, 50)
    laser_map.redraw(path)
    path[30:, 1] += 0.3
    assert laser_map.redraw(path).drawn == 50
    assert same_grid(laser_map.grid, from_scratch(laser_map, path))


def test_scans_are_drawn_again_only_where_a_keyframe_has_moved_noticeably(generator):
    laser_map = LaserMap()
    path = np.cumsum(generator.normal(0.0, 0.2, (100, 3)), axis=0)
    add_scans(laser_map, generator, 100)
    laser_map.redraw(path)
    grid, little = laser_map.grid, path + (0.006, 0.006, 0.003)
    assert laser_map.redraw(little).drawn == 0
    assert laser_map.grid is grid
    np.testing.assert_array_equal(laser_map.path, path)
    turned = little.copy()
    turned[90:, 2] += 0.006  # with the turn before, more than 2 cm at 3 m
    assert 10 <= laser_map.redraw(turned).drawn < 40
    np.testing.assert_array_equal(laser_map.path[:90], path[:90])
    np.testing.assert_array_equal(laser_map.path[90:], turned[90:])
    assert same_grid(laser_map.grid, from_scratch(laser_map, laser_map.path))


def test_small_motions_add_up(generator):
    laser_map = LaserMap()
    path = np.zeros((5, 3))
    add_scans(laser_map, generator, 5)
    laser_map.redraw(path)
    drawn = [laser_map.redraw(path + (0.006 * k, 0.0, 0.0)).drawn for k in range(1, 5)]
    assert drawn == [0, 0, 0, 5]


def test_a_scan_waits_for_its_keyframe(generator):
    laser_map = LaserMap()
    add_scans(laser_map, generator, 3)
    assert laser_map.redraw(np.zeros((2, 3))).waiting == 1
    assert laser_map.redraw(np.zeros((3, 3))).drawn == 1


def test_bodies_move_with_the_path():
    laser_map = LaserMap()
    scan = LaserScan(0.0, 0.0, 0.1, np.array([2.0], np.float32), 0.1, 30.0)
    laser_map.add(0, 'a', LaserScan(0.0, 0.0, 0.1, np.array([np.nan], np.float32), 0.1, 30.0))
    laser_map.add(1, 'b', scan, IDENTITY, [VehicleDisc(0, Pose2(0.3, 0.0, 0.0), 0.4)])
    away = np.array([[9.0, 9.0, 0.0], [0.0, 0.0, 0.0]])
    laser_map.redraw(away)
    assert (laser_map.grid.probability() > 0.5).any()
    here = np.array([[1.8, 0.0, 0.0], [0.0, 0.0, 0.0]])
    laser_map.redraw(here)
    assert not (laser_map.grid.probability() > 0.5).any()


def test_bad_paths_and_keyframes_are_refused_and_the_grid_stays(generator):
    laser_map = LaserMap()
    add_scans(laser_map, generator, 5)
    path = np.zeros((5, 3))
    laser_map.redraw(path)
    before = laser_map.grid.copy()
    for bad in (np.zeros((5, 2)), np.full((5, 3), math.nan)):
        with pytest.raises(MappingError, match='path'):
            laser_map.redraw(bad)
    with pytest.raises(MappingError, match='keyframe'):
        laser_map.add(-1, 'a', random_scan(generator))
    assert same_grid(laser_map.grid, before)


def test_a_scan_too_far_out_is_left_out_and_counted(generator):
    laser_map = LaserMap(GridConfig(maximum_map_side=60.0))
    add_scans(laser_map, generator, 3)
    path = np.zeros((3, 3))
    path[1, 0] = 5000.0
    assert laser_map.redraw(path).refused == 1
    assert max(laser_map.grid.shape) * laser_map.grid.resolution <= 60.0


def test_snapshots_are_dense_towards_the_present_and_few_in_number():
    assert snapshot_positions(15) == set()
    assert snapshot_positions(16) == {16}
    assert snapshot_positions(48) == {48, 32}
    assert snapshot_positions(500) == {496, 480, 448, 384, 256}
    assert len(snapshot_positions(10**6)) < 2 * 17


def test_memory_bounds_the_number_of_snapshots(generator):
    path = np.cumsum(generator.normal(0.0, 0.1, (200, 3)), axis=0)
    size = None
    for snapshots in (1, 3):
        laser_map = LaserMap(GridConfig(resolution=0.1))
        add_scans(laser_map, np.random.default_rng(1), 200)
        scans = laser_map.scans
        laser_map.redraw(path)
        size = laser_map.grid.evidence().nbytes / 1e6
        bounded = LaserMap(GridConfig(resolution=0.1, snapshot_memory=size * (snapshots + 0.5)))
        for item in scans:
            bounded.add(*item)
        bounded.redraw(path)
        assert len(bounded._snapshots) == snapshots
        assert max(bounded._snapshots) == 192
        changed = path.copy()
        changed[195:, 0] += 0.3
        assert bounded.redraw(changed).drawn == 8


def corridor_scan(pose, generator):
    """Return what a laser sees in a corridor of 2.04 m, with 1 cm of noise and 2 % outliers."""
    bearings = pose.theta - 1.5 + 0.05 * np.arange(61)
    sides = np.where(np.sin(bearings) > 0.0, 1.02 - pose.y, -1.02 - pose.y)
    with np.errstate(divide='ignore'):
        ranges = np.minimum(sides / np.sin(bearings), 8.0) + generator.normal(0.0, 0.01, 61)
    ranges[generator.random(61) < 0.02] *= 0.6
    return LaserScan(0.0, -1.5, 0.05, ranges.astype(np.float32), 0.1, 30.0)


UNKNOWN, FREE, OCCUPIED = 0, 1, 3


def column_at(grid, x):
    """Return the column of a grid at x (m)."""
    return round((x - grid.origin[0]) / grid.resolution)


def classes(grid):
    """Return whether cells are UNKNOWN, FREE, undecided (2) or OCCUPIED."""
    limits = grid.config.map_free_threshold, grid.config.map_occupied_threshold
    return np.where(grid.known(), 1 + np.digitize(grid.probability(), limits), UNKNOWN)


def test_scans_are_bounded_by_the_area_not_by_the_time(generator):
    """A vehicle drives to and fro; the map redrawn from what is kept shows the same walls."""
    laser_map, poses, held = LaserMap(), [], []
    for trip in range(30):
        for step in range(60):
            x, heading = (0.1 * step, 0.0) if trip % 2 == 0 else (6.0 - 0.1 * step, math.pi)
            pose = Pose2(x, generator.normal(0.5, 0.1), heading)
            laser_map.add(len(poses), 'robot1', corridor_scan(pose, generator))
            poses.append(pose)
        laser_map.redraw(np.array(poses))
        held.append(len(laser_map))
    assert held[0] == 60  # one pass is kept whole
    assert held[-1] == held[-9] == len(laser_map.scans)
    stamps = [item.keyframe for item in laser_map.scans]
    assert stamps[-1] == len(poses) - 1
    drawn = classes(laser_map.grid)
    everywhere = np.array(poses) + (0.0, 0.05, 0.0)
    everywhere[:1] += 0.1
    assert laser_map.redraw(everywhere).drawn == held[-1]
    assert same_grid(laser_map.grid, from_scratch(laser_map, everywhere))
    laser_map.redraw(np.array(poses))
    again = classes(laser_map.grid)
    near = np.s_[:, column_at(laser_map.grid, 0.5) : column_at(laser_map.grid, 5.5)]
    assert np.mean(again[near][drawn[near] == OCCUPIED] == OCCUPIED) > 0.9
    assert np.mean(again[near][drawn[near] == FREE] == FREE) > 0.99


def room_scan():
    """Return what a laser sees all around in the middle of a room of 4 m."""
    bearings = np.linspace(-math.pi, math.pi, 361)
    sides = np.maximum(np.abs(np.cos(bearings)), np.abs(np.sin(bearings)))
    return LaserScan(
        0.0, -math.pi, bearings[1] - bearings[0], (2.0 / sides).astype(np.float32), 0.1, 30.0
    )


def test_a_place_is_one_of_the_map_not_of_the_frame_that_a_vehicle_began_in():
    """A room that was mapped in a frame of its own, and joined 20 m away, is not given up."""
    laser_map, scan = LaserMap(), room_scan()
    own = np.array([(0.1 + 0.15 * k, 0.5, 0.1) for k in range(5)])
    for keyframe in range(17):
        laser_map.add(keyframe, 'robot1', scan)
    laser_map.redraw(own, np.zeros(5, np.bool_))
    joined = own + (20.0, 0.0, 0.0)
    laser_map.redraw(joined)
    here = np.array([(0.1 + 0.05 * k, 0.5, 0.1) for k in range(12)])
    path = np.vstack([joined, here])
    laser_map.redraw(path)
    laser_map.redraw(path + (0.0, 0.05, 0.0))
    assert len(laser_map) == 5 + 10
    ((row, column),) = laser_map.grid.to_cell([(20.5, 1.5)])
    assert laser_map.grid.to_trinary()[row, column] == 0


def test_a_vehicle_that_stands_still_replaces_its_own_scans():
    laser_map, scan = LaserMap(), room_scan()
    turning = [(0.5, 0.5, 0.05 + 0.08 * k) for k in range(9)]
    path = np.array(turning + [turning[-1]] * 60)
    for keyframe in range(len(path)):
        laser_map.add(keyframe, 'robot1', scan)
    laser_map.redraw(path)
    kept = [item.keyframe for item in laser_map.scans]
    assert kept[:8] == list(range(8))
    assert kept[8:] == [67, 68]


def test_lasers_of_one_vehicle_do_not_replace_one_another():
    laser_map = LaserMap()
    for keyframe in range(40):
        for sensor in ('front', 'rear'):
            laser_map.add(keyframe, 'robot1', replace(room_scan(), sensor=sensor))
    laser_map.redraw(np.full((40, 3), 0.5))
    assert len(laser_map) == 2 * 10


def test_a_body_that_moved_redraws_the_scan_that_saw_it(generator):
    laser_map = LaserMap()
    for keyframe in range(4):
        laser_map.add(keyframe, 'a', random_scan(generator))
    laser_map.add(3, 'b', random_scan(generator), IDENTITY, [VehicleDisc(1, IDENTITY, 0.4)])
    path = np.zeros((5, 3))
    laser_map.redraw(path)
    path[1] += 0.5
    assert laser_map.redraw(path).kept == 0
    path[3] += 0.5
    laser_map.redraw(path)
    path[4] += 0.5  # a keyframe without scans
    assert laser_map.redraw(path) == (5, 0, 0, 0)


def test_a_body_in_the_map_frame_does_not_wait_for_a_keyframe():
    laser_map = LaserMap()
    scan = LaserScan(0.0, 0.0, 0.1, np.array([2.0], np.float32), 0.1, 30.0)
    laser_map.add(0, 'a', scan, IDENTITY, [VehicleDisc(MAP_FRAME, Pose2(2.0, 0.0, 0.0), 0.4)])
    laser_map.add(0, 'a', scan, IDENTITY, [VehicleDisc(7, IDENTITY, 0.4)])
    assert laser_map.redraw(np.zeros((1, 3))) == (0, 1, 1, 0)
    assert not (laser_map.grid.probability() > 0.5).any()
    assert laser_map.redraw(np.zeros((8, 3))) == (1, 1, 0, 0)


def test_the_laser_is_where_its_mount_says():
    laser_map = LaserMap(GridConfig(resolution=0.1))
    scan = LaserScan(0.0, 0.0, 0.1, np.array([2.0], np.float32), 0.1, 30.0)
    laser_map.add(0, 'a', scan, Pose2(0.5, 0.0, math.pi / 2))
    laser_map.redraw(np.array([[1.0, 1.0, math.pi / 2]]))
    hit = laser_map.grid.to_point(np.argwhere(laser_map.grid.probability() > 0.5))
    np.testing.assert_allclose(hit, [[-1.0, 1.5]], atol=0.1)
