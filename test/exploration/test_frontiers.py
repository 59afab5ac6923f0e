"""Frontiers, the clearance around obstacles, and where to stand."""

import math

import numpy as np
import pytest
from exploration_maps import grid_of
from scipy.ndimage import distance_transform_edt

from explore_slam.exploration import ExplorationConfig, find_frontiers, make_cost_map
from explore_slam.exploration.clearance import squared_distance
from explore_slam.exploration.frontiers import expected_area
from explore_slam.exploration.sections import PathConfig
from explore_slam.mapping import OccupancyGrid
from explore_slam.settings import with_values

ROOMS = """
??????????????
?############?
?#....#.....??
?#....#.....??
?#..........??
?#....#.....??
?############?
??????????????
"""


def config(**values):
    return with_values(ExplorationConfig(), {'min_frontier_gain': 0.0, **values})


def test_the_distance_transform_is_exact_up_to_its_limit():
    obstacles = np.random.default_rng(0).random((40, 60)) < 0.01
    exact = np.rint(distance_transform_edt(~obstacles) ** 2)
    limit = 7
    found = squared_distance(obstacles, limit)
    near = exact <= limit * limit
    assert np.array_equal(found[near], exact[near])
    assert (found[~near] > limit * limit).all()


def test_a_frontier_lies_beside_the_unknown_and_its_target_is_free():
    grid = grid_of(ROOMS, cells_per_letter=4)
    frontiers = find_frontiers(grid, config(max_frontier_size=10.0))
    assert len(frontiers) == 1
    (frontier,) = frontiers
    known, free = grid.known(), grid.probability() < 0.5
    for row, col in frontier.cells:
        assert known[row, col]
        assert free[row, col]
        assert not (known[row, col - 1] and known[row, col + 1]
                    and known[row - 1, col] and known[row + 1, col])  # fmt: skip
    assert frontier.size == pytest.approx(4.0)
    assert frontier.target[0] == pytest.approx(frontier.centroid[0], abs=0.3)
    assert frontier.gain > 1.0


def test_the_inflated_grid_keeps_the_radius():
    grid = grid_of(ROOMS, cells_per_letter=4)
    settings = PathConfig(planning_radius=0.6)
    costs = make_cost_map(grid, settings)
    obstacles = np.argwhere(grid.known() & (grid.probability() > 0.5))
    for cell in np.argwhere(np.isfinite(costs.cost)):
        assert np.hypot(*(obstacles - cell).T).min() * grid.resolution > 0.6
    tight = np.isfinite(costs.tight_cost)
    assert tight.sum() > np.isfinite(costs.cost).sum()
    assert not (np.isfinite(costs.cost) & ~tight).any()


def test_the_paper_is_charged_probabilities_and_others_at_least_the_floor():
    probability = np.full((9, 9), 0.2)
    probability[4, 4] = 0.5
    grid = OccupancyGrid.from_probability(probability, np.ones((9, 9), bool))
    paper = make_cost_map(grid, PathConfig(), probability_costs=True).cost
    assert paper[4, 4] == pytest.approx(0.5, abs=1e-3)
    assert paper[0, 0] == pytest.approx(0.2, abs=1e-3)
    ours = make_cost_map(grid, PathConfig(cost_floor=0.25)).cost
    assert ours[0, 0] == pytest.approx(1.0, abs=1e-3)
    assert ours[4, 4] == pytest.approx(2.0, abs=1e-2)


def test_short_frontiers_and_small_gains_are_left_alone():
    grid = grid_of(ROOMS, cells_per_letter=4)
    assert find_frontiers(grid, config(min_frontier_size=4.5)) == []
    assert find_frontiers(grid, config(min_frontier_gain=50.0)) == []


def test_long_frontiers_are_split_in_parts_that_hold_every_cell_once():
    grid = grid_of(ROOMS, cells_per_letter=4)
    whole = find_frontiers(grid, config(max_frontier_size=50.0))
    parts = find_frontiers(grid, config(max_frontier_size=1.5))
    assert len(whole) == 1
    assert len(parts) == 3
    cells = {tuple(cell) for part in parts for cell in part.cells}
    assert cells == {tuple(cell) for cell in whole[0].cells}
    assert sum(len(part.cells) for part in parts) == len(cells)


def test_a_frontier_that_no_vehicle_fits_into_is_looked_into_from_near():
    narrow = """
    ##########
    #.....####
    #........?
    #.....####
    ##########
    """
    grid = grid_of(narrow, cells_per_letter=2)
    settings = config(planning_radius=0.3, viewpoint_distance=2.5, min_frontier_size=0.2)
    (frontier,) = find_frontiers(grid, settings)
    assert np.isfinite(make_cost_map(grid, settings.paths).cost[frontier.target_cell])
    assert 0.5 < math.dist(frontier.target, frontier.centroid) < 2.5
    assert find_frontiers(grid, config(viewpoint_distance=0.5, min_frontier_size=0.2)) == []


def test_unknown_cells_that_stand_alone_are_no_frontier():
    known = np.ones((40, 40), bool)
    known[10:30:3, 10:30:3] = False
    grid = OccupancyGrid.from_probability(np.full((40, 40), 0.1), known)
    assert find_frontiers(grid, config(min_frontier_size=0.0)) == []


def test_a_small_pocket_has_exactly_its_area_as_gain():
    known = np.ones((80, 80), bool)
    known[40:50, 30:44] = False
    grid = OccupancyGrid.from_probability(np.full((80, 80), 0.1), known)
    gains = [f.gain for f in find_frontiers(grid, config())]
    assert gains
    assert gains == pytest.approx([140 * 0.05**2] * len(gains))


def test_an_empty_grid_has_no_frontier():
    assert find_frontiers(OccupancyGrid()) == []


def test_unreachable_sides_do_not_count():
    grid = grid_of(ROOMS, cells_per_letter=4)
    nowhere = np.zeros(grid.shape, bool)
    assert find_frontiers(grid, config(), reachable=nowhere) == []


def test_a_vehicle_is_told_to_look_at_what_is_unknown():
    grid = grid_of(ROOMS, cells_per_letter=4)
    (frontier,) = find_frontiers(grid, config(max_frontier_size=10.0))
    row, col = grid.to_cell([frontier.look_at])[0]
    away = math.dist(frontier.look_at, frontier.target)
    assert not grid.known()[row, col]
    assert away > 0.5


def test_expected_area_grows_faster_than_what_is_unknown_and_stays_below_it():
    assert expected_area(0.0, 8.0) == 0.0
    few, many, all_around = (expected_area(area, 8.0) for area in (20.0, 60.0, 200.0))
    assert few < 20.0 / 15.0 < many / 3.0
    assert many < all_around < 0.2 * 200.0


def test_a_crack_that_little_is_seen_through_is_no_frontier():
    text = """
    ??????????????????????
    ??????????????????????
    ??????????????????????
    ######.###############
    ######.###############
    #....................#
    #....................#
    ######################
    """
    grid = grid_of(text, cells_per_letter=2)
    assert find_frontiers(grid, config(viewpoint_distance=2.0, min_frontier_gain=0.4)) == []
    (crack,) = find_frontiers(grid, config(viewpoint_distance=2.0, min_frontier_gain=0.01))
    assert 0.01 < crack.gain < 0.4
    door = grid_of(text.replace('######.###', '######....'), cells_per_letter=2)
    (way,) = find_frontiers(door, config(viewpoint_distance=2.0, min_frontier_gain=0.4))
    assert way.gain > crack.gain
