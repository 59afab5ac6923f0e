"""The ray model and the grid: what one scan does to each cell."""

import math

import numpy as np
import pytest
from grids import same_grid
from hypothesis import given, settings
from hypothesis import strategies as st

from explore_slam.data import LaserScan
from explore_slam.errors import MappingError
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.mapping import GridConfig, OccupancyGrid


def scan_of(ranges, angle_min=0.0, increment=0.1, range_min=0.1, range_max=30.0):
    return LaserScan(0.0, angle_min, increment, np.array(ranges, np.float32), range_min, range_max)


def state_at(grid, x, y):
    """'free', 'occupied' or 'unknown' at a point."""
    cell = grid.to_cell([(x, y)])
    if not grid.contains(cell)[0] or not grid.known()[tuple(cell[0])]:
        return 'unknown'
    return 'occupied' if grid.probability()[tuple(cell[0])] > 0.5 else 'free'


def test_one_beam_frees_cells_up_to_its_hit_and_nothing_behind():
    grid = OccupancyGrid(GridConfig(resolution=0.1))
    grid.insert_scan(IDENTITY, scan_of([2.05]))
    assert [state_at(grid, x, 0.05) for x in (0.05, 1.0, 1.95, 2.05, 2.15)] == [
        'free', 'free', 'free', 'occupied', 'unknown',
    ]  # fmt: skip
    assert np.count_nonzero(grid.known()) == 21


@pytest.mark.parametrize('value', [math.nan, -math.inf, 0.05, 0.0])
def test_invalid_ranges_say_nothing(value):
    grid = OccupancyGrid()
    grid.insert_scan(IDENTITY, scan_of([value]))
    assert not grid.known().any()


@pytest.mark.parametrize('value', [math.inf, 31.0])
def test_no_return_frees_up_to_the_range_set_for_it(value):
    grid = OccupancyGrid(GridConfig(no_return_range=3.0))
    grid.insert_scan(IDENTITY, scan_of([value]))
    assert state_at(grid, 2.9, 0.0) == 'free'
    assert state_at(grid, 3.1, 0.0) == 'unknown'
    assert not (grid.probability() > 0.5).any()


def test_no_return_is_ignored_on_request():
    grid = OccupancyGrid(GridConfig(no_return_range=0.0))
    grid.insert_scan(IDENTITY, scan_of([math.inf]))
    assert not grid.known().any()


def test_a_far_return_frees_up_to_the_maximum_range_without_a_hit():
    grid = OccupancyGrid(GridConfig(max_laser_range=4.0))
    grid.insert_scan(IDENTITY, scan_of([20.0]))
    assert state_at(grid, 3.9, 0.0) == 'free'
    assert state_at(grid, 4.1, 0.0) == 'unknown'
    assert not (grid.probability() > 0.5).any()


def test_one_scan_counts_once_per_cell_and_hits_outweigh_passing_beams():
    config = GridConfig(resolution=0.5)
    grid = OccupancyGrid(config)
    grid.insert_scan(IDENTITY, scan_of([3.3, 5.0], increment=0.001))
    cell = tuple(grid.to_cell([(3.3, 0.0)])[0])
    assert grid.probability()[cell] == pytest.approx(config.hit_probability, abs=1e-3)
    near = tuple(grid.to_cell([(1.2, 0.0)])[0])
    assert grid.probability()[near] == pytest.approx(config.miss_probability, abs=1e-3)


def test_probabilities_are_clamped_and_can_change_their_mind():
    config = GridConfig(clamp_low=0.1, clamp_high=0.9)
    grid = OccupancyGrid(config)
    for _ in range(100):
        grid.insert_scan(IDENTITY, scan_of([2.02]))
    cell = tuple(grid.to_cell([(2.02, 0.0)])[0])
    assert grid.probability()[cell] == pytest.approx(0.9, abs=1e-3)
    for _ in range(12):
        grid.insert_scan(IDENTITY, scan_of([4.0]))
    assert grid.probability()[cell] < 0.5
    assert grid.probability()[tuple(grid.to_cell([(1.0, 0.0)])[0])] == pytest.approx(0.1, abs=1e-3)


def test_the_grid_grows_in_every_direction_and_keeps_what_it_holds():
    grid = OccupancyGrid()
    places = [(0.0, 0.0), (-20.0, 3.0), (15.0, -30.0), (1.0, 40.0)]
    for x, y in places:
        grid.insert_scan(Pose2(x, y, 0.7), scan_of([1.33, 2.0, 1.5], increment=1.5))
    for x, y in places:
        hit = x + 1.33 * math.cos(0.7), y + 1.33 * math.sin(0.7)
        assert state_at(grid, *hit) == 'occupied'
        assert state_at(grid, x, y) == 'free'
    ratio = np.array(grid.origin) / grid.resolution
    assert np.allclose(ratio, np.rint(ratio))


def test_the_body_of_another_vehicle_is_no_wall():
    grid = OccupancyGrid()
    bodies = [(3.0, 0.0, 0.4)]
    grid.insert_scan(IDENTITY, scan_of([2.7, 3.62], increment=0.0001), bodies)
    assert state_at(grid, 2.5, 0.0) == 'free'
    assert state_at(grid, 2.72, 0.0) != 'occupied'
    # The other beam passed it (the poses are not exact): what it hit behind is a wall.
    assert state_at(grid, 3.62, 0.0) == 'occupied'


def test_cells_and_points_are_inverse():
    grid = OccupancyGrid(GridConfig(resolution=0.05))
    grid.insert_scan(Pose2(-3.0, 7.0, 0.0), scan_of([2.0]))
    cells = np.array([[0, 0], [5, 9], [-2, 70]])
    assert np.array_equal(grid.to_cell(grid.to_point(cells)), cells)
    x, y = grid.origin
    assert np.allclose(grid.to_point([[0, 0]])[0], (x + 0.025, y + 0.025))


def test_occupancy_message_values():
    grid = OccupancyGrid()
    for _ in range(30):
        grid.insert_scan(IDENTITY, scan_of([2.02]))
    wall, floor, behind = (tuple(cell) for cell in grid.to_cell([(2.02, 0), (1.0, 0), (2.2, 0)]))
    percent, cells = grid.to_percent(), grid.to_trinary()
    assert percent.dtype == cells.dtype == np.int8
    assert (percent[wall], percent[floor], percent[behind]) == (97, 3, -1)
    assert (cells[wall], cells[floor], cells[behind]) == (100, 0, -1)


def test_trinary_values_follow_the_thresholds_of_map_files():
    known = np.array([[True, True, True, True, False]])
    probability = np.array([[0.40, 0.50, 0.60, 0.90, 0.5]])
    grid = OccupancyGrid.from_probability(probability, known, (0.0, 0.0), GridConfig())
    assert grid.to_trinary().tolist() == [[0, -1, -1, 100, -1]]
    strict = GridConfig(map_free_threshold=0.3, map_occupied_threshold=0.55)
    grid = OccupancyGrid.from_probability(probability, known, (0.0, 0.0), strict)
    assert grid.to_trinary().tolist() == [[-1, -1, 100, 100, -1]]


def test_what_does_not_fit_is_refused_and_changes_nothing():
    grid = OccupancyGrid(GridConfig(maximum_map_side=50.0))
    grid.insert_scan(IDENTITY, scan_of([2.0]))
    before = grid.copy()
    for pose in (Pose2(math.nan, 0.0, 0.0), Pose2(100.0, 0.0, 0.0), Pose2(1e30, 0.0, 0.0)):
        with pytest.raises(MappingError):
            grid.insert_scan(pose, scan_of([2.0]))
    with pytest.raises(MappingError, match='finite'):
        grid.insert_scan(IDENTITY, scan_of([2.0]), [(math.nan, 0.0, 1.0)])
    assert same_grid(grid, before)


def test_grids_of_probabilities_are_checked():
    known = np.ones((2, 3), np.bool_)
    half = np.full((2, 3), 0.5)
    grid = OccupancyGrid.from_probability(half, known, (1.0, -2.0), GridConfig(resolution=0.5))
    assert grid.origin == (1.0, -2.0)
    assert grid.known().all()
    with pytest.raises(MappingError, match='NaN'):
        OccupancyGrid.from_probability(np.full((2, 3), np.nan), known)
    with pytest.raises(MappingError, match='multiple of'):
        OccupancyGrid.from_probability(half, known, (0.26, 0.0), GridConfig(resolution=0.5))
    with pytest.raises(MappingError, match='shape'):
        OccupancyGrid.from_probability(half, known[:1])


@settings(max_examples=60, deadline=None)
@given(
    x=st.floats(-5.0, 5.0),
    y=st.floats(-5.0, 5.0),
    theta=st.floats(-4.0, 4.0),
    length=st.floats(0.2, 9.0),
)
def test_every_cell_that_a_beam_crosses_is_seen(x, y, theta, length):
    grid = OccupancyGrid(GridConfig(resolution=0.1))
    grid.insert_scan(Pose2(x, y, theta), scan_of([length]))
    # Samples too near to a cell edge may fall to either side.
    at = np.linspace(0.0, float(np.float32(length)), 400)
    points = np.stack([x + at * math.cos(theta), y + at * math.sin(theta)], axis=1)
    inner = np.abs(points / 0.1 - np.rint(points / 0.1)).min(axis=1) > 1e-3
    cells = grid.to_cell(points[inner])
    assert grid.known()[cells[:, 0], cells[:, 1]].all()
    touched = np.argwhere(grid.known())
    centers = grid.to_point(touched) - (x, y)
    across = np.abs(-centers[:, 0] * math.sin(theta) + centers[:, 1] * math.cos(theta))
    assert across.max() <= 0.1 / math.sqrt(2.0) + 1e-6


def test_levels_mean_what_probability_and_known_say():
    random = np.random.default_rng(0)
    known = random.random((9, 12)) < 0.7
    grid = OccupancyGrid.from_probability(random.uniform(0.02, 0.98, (9, 12)), known)
    cells, table = grid.levels()
    values = table[cells.view(np.uint16)]
    np.testing.assert_array_equal(np.isnan(values), ~known)
    np.testing.assert_array_equal(values[known], grid.probability()[known])
