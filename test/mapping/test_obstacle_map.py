"""The layer of obstacles: evidence by slice of height, along the path, merged into the grid."""

import numpy as np
import pytest
from grids import same_grid

from explore_slam.data import LaserScan, ObstacleView
from explore_slam.errors import MappingError
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.mapping import (
    MAP_FRAME,
    GridConfig,
    LaserMap,
    ObstacleGrid,
    ObstacleMap,
    OccupancyGrid,
    PlacedView,
    VehicleDisc,
    cells_looked_at,
    with_obstacles,
)

TOP, LOW = np.uint16(1 << 6), np.uint16(1 << 2)


def view(occupied=0, free=0, x=(20, 30), y=(-5, 5), stamp=1.0):
    """Return a view that shows the same in all cells of a rectangle, given in cells."""
    columns, rows = np.meshgrid(np.arange(*x), np.arange(*y))
    cells = np.stack([columns.ravel(), rows.ravel()], axis=1).astype(np.int16)
    bits = [np.full(len(cells), value, np.uint16) for value in (occupied, free)]
    return ObstacleView(stamp, cells, *bits)


def place(grid, *views, pose=IDENTITY, bodies=()):
    for one in views:
        grid.insert(PlacedView(pose, one, np.array(bodies).reshape(-1, 3)))
    return grid


def at(grid, x, y):
    """Return whether the cell of a point is an obstacle."""
    row, column = grid.first_cell
    scale = grid.config.resolution
    return bool(grid.obstacles()[int(y // scale) - row, int(x // scale) - column])


def test_rays_below_a_table_do_not_erase_its_top_and_those_through_its_slice_do():
    grid = place(ObstacleGrid(), view(TOP))
    assert at(grid, 1.2, 0.0)
    place(grid, *[view(free=LOW)] * 50)
    assert at(grid, 1.2, 0.0)
    place(grid, *[view(free=TOP)] * 3)
    assert not at(grid, 1.2, 0.0)


def test_an_obstacle_is_forgotten_soon_and_found_soon_however_often_it_was_seen():
    grid = place(ObstacleGrid(), *[view(TOP)] * 100)
    place(grid, *[view(free=TOP)] * 9)
    assert not at(grid, 1.2, 0.0)
    place(grid, *[view(free=TOP)] * 100, *[view(TOP)] * 2)
    assert at(grid, 1.2, 0.0)


@pytest.mark.parametrize('resolution', [0.03, 0.05, 0.1])
@pytest.mark.parametrize('heading', [0.0, 0.4, 2.1])
def test_the_cells_of_a_turned_view_have_no_gaps(resolution, heading):
    grid = ObstacleGrid(GridConfig(resolution=resolution))
    place(grid, view(TOP, x=(20, 40), y=(-10, 10)), pose=Pose2(0.7, -0.3, heading))
    area = grid.obstacles().sum() * resolution**2
    assert area == pytest.approx(1.0, rel=0.15 if resolution > 0.05 else 0.05)
    middle = Pose2(0.7, -0.3, heading).compose(Pose2(1.5, 0.0, 0.0))
    for dx in np.arange(-0.3, 0.31, 0.05):
        for dy in np.arange(-0.3, 0.31, 0.05):
            assert at(grid, middle.x + dx, middle.y + dy)


def test_the_bodies_of_other_vehicles_are_no_obstacles():
    grid = place(ObstacleGrid(), view(TOP), bodies=[(1.0, 0.0, 0.2)])
    assert not at(grid, 1.05, 0.0)
    assert at(grid, 1.4, 0.0)


def test_a_view_that_does_not_fit_is_refused_and_changes_nothing():
    grid = place(ObstacleGrid(GridConfig(maximum_map_side=10.0)), view(TOP))
    before = grid.obstacles().copy()
    with pytest.raises(MappingError, match='maximum_map_side = 10'):
        place(grid, view(TOP), pose=Pose2(20.0, 0.0, 0.0))
    with pytest.raises(MappingError, match='not finite'):
        place(grid, view(TOP), pose=Pose2(np.nan, 0.0, 0.0))
    np.testing.assert_array_equal(grid.obstacles(), before)


# -- along the path -------------------------------------------------------------------------------


def random_map(generator, count=60):
    obstacle_map = ObstacleMap()
    for keyframe in range(count):
        x = int(generator.integers(10, 30))
        bits = generator.integers(0, 1 << 16, 2)
        bodies = [VehicleDisc(MAP_FRAME, Pose2(1.0, 0.0, 0.0), 0.3)] if keyframe % 7 == 0 else []
        item = view(int(bits[0]), int(bits[1] & ~bits[0]), (x, x + 15))
        obstacle_map.add(keyframe, 'robot1', item, Pose2(0.1, 0.0, 0.1), bodies)
    return obstacle_map


def test_a_map_keeps_its_views_as_they_came():
    generator = np.random.default_rng(5)
    obstacle_map = ObstacleMap()
    cells = generator.integers(-(2**15), 2**15, (50, 2)).astype(np.int16)
    bits = generator.integers(0, 2**16, (2, 50)).astype(np.uint16)
    given = [
        view(3, 4, stamp=7.5),
        ObstacleView(8.5, cells, *bits),
        ObstacleView(9.0, cells[:0], *bits[:, :0]),
    ]
    body = VehicleDisc(0, Pose2(1.0, 0.0, 0.0), 0.3)
    for number, one in enumerate(given):
        obstacle_map.add(number, 'robot1', one, Pose2(0.1, 0.0, 0.1), [body])
    assert len(obstacle_map) == len(given)
    for number, (item, one) in enumerate(zip(obstacle_map.views, given, strict=True)):
        assert (item.keyframe, item.vehicle, item.bodies) == (number, 'robot1', (body,))
        assert item.view.stamp == one.stamp
        for name in ('cells', 'occupied', 'free'):
            np.testing.assert_array_equal(getattr(item.view, name), getattr(one, name))


def test_a_redraw_along_a_corrected_path_equals_drawing_from_scratch():
    generator = np.random.default_rng(3)
    obstacle_map = random_map(generator)
    path = np.cumsum(generator.normal(0.0, 0.2, (60, 3)), axis=0)
    for first in (59, 41, 3, 20):
        path = path.copy()
        path[first:] += generator.normal(0.0, 0.5, (60 - first, 3))
        summary = obstacle_map.redraw(path)
        assert summary.kept <= first
        other = ObstacleMap()
        for item in obstacle_map.views:
            other.add(*item)
        other.redraw(path)
        assert other.layer.first_cell == obstacle_map.layer.first_cell or first != 59
        for x, y in generator.uniform(-2.0, 4.0, (200, 2)):
            inside = [_contains(one.layer, x, y) for one in (other, obstacle_map)]
            if all(inside):
                assert at(other.layer, x, y) == at(obstacle_map.layer, x, y)


def _contains(grid, x, y):
    row, column = grid.first_cell
    rows, columns = grid.obstacles().shape
    scale = grid.config.resolution
    return 0 <= y // scale - row < rows and 0 <= x // scale - column < columns


def test_views_of_vehicles_that_are_not_in_the_map_are_not_drawn():
    obstacle_map = ObstacleMap()
    obstacle_map.add(0, 'robot1', view(TOP))
    obstacle_map.redraw(np.zeros((1, 3)), np.zeros(1, np.bool_))
    assert not obstacle_map.layer.obstacles().any()
    obstacle_map.redraw(np.zeros((1, 3)), np.ones(1, np.bool_))
    assert at(obstacle_map.layer, 1.2, 0.0)


# -- in the grid ----------------------------------------------------------------------------------


def seen_by_laser(distance=2.0):
    """Return the grid of a laser at the origin before a wall."""
    angles = np.linspace(-1.0, 1.0, 201)
    ranges = (distance / np.cos(angles)).astype(np.float32)
    laser_map = LaserMap()
    for _ in range(3):
        laser_map.add(0, 'robot1', LaserScan(0.0, -1.0, 0.01, ranges, 0.1, 8.0))
    laser_map.redraw(np.zeros((1, 3)))
    return laser_map.grid


def occupied(grid, x, y):
    ((row, column),) = grid.to_cell([(x, y)])
    return grid.to_trinary()[row, column] == 100


def test_obstacles_are_occupied_in_the_map_and_beams_below_them_do_not_count():
    laser = seen_by_laser()
    assert laser.to_trinary()[tuple(laser.to_cell([(1.2, 0.0)])[0])] == 0
    merged = with_obstacles(laser, place(ObstacleGrid(), view(TOP)))
    assert occupied(merged, 1.2, 0.0)
    assert not occupied(laser, 1.2, 0.0)  # the grid itself is as it was
    changed = (merged.to_trinary() != laser.extended(*_window(merged)).to_trinary()).sum()
    assert changed == 100


def _window(grid):
    scale = grid.resolution
    x, y = grid.origin
    return round(y / scale), round(x / scale), *grid.shape


def test_without_obstacles_the_map_is_the_grid_of_the_laser():
    laser = seen_by_laser()
    layer = place(ObstacleGrid(), view(free=TOP))
    assert with_obstacles(laser, layer) is laser


def test_noise_just_behind_a_wall_is_no_obstacle_but_one_before_it_and_one_far_behind_are():
    laser = seen_by_laser(2.0)
    lump = with_obstacles(laser, place(ObstacleGrid(), view(TOP, x=(41, 42))))
    assert not occupied(lump, 2.07, 0.0)
    before = with_obstacles(laser, place(ObstacleGrid(), view(TOP, x=(38, 39))))
    assert occupied(before, 1.92, 0.0)
    behind = with_obstacles(laser, place(ObstacleGrid(), view(TOP, x=(50, 52))))
    assert occupied(behind, 2.52, 0.0)


def test_a_map_without_a_laser_consists_of_the_obstacles():
    merged = with_obstacles(OccupancyGrid(), place(ObstacleGrid(), view(TOP)))
    assert (merged.to_trinary() == 100).sum() == 100
    assert same_grid(merged, with_obstacles(OccupancyGrid(), place(ObstacleGrid(), view(TOP))))


def test_cells_looked_at_are_those_that_views_show_wherever_the_grid_begins():
    layer = place(ObstacleGrid(), view(free=LOW, x=(20, 30), y=(-5, 5)))
    side = layer.config.resolution
    grid = OccupancyGrid.from_probability(
        np.full((40, 40), 0.1), np.ones((40, 40), np.bool_), origin=(1.2, -1.0)
    )
    seen = cells_looked_at(grid, layer)
    assert seen.shape == grid.shape
    centres = grid.to_point(np.argwhere(seen))
    assert (np.abs(centres - (1.35, 0.0)) < (0.15, 0.25)).all()
    assert len(centres) == round(0.3 / side) * round(0.5 / side)
    far = OccupancyGrid.from_probability(
        np.full((4, 4), 0.1), np.ones((4, 4), np.bool_), origin=(90.0, 90.0)
    )
    assert not cells_looked_at(far, layer).any()
