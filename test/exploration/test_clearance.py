"""Cost maps: what free, unknown and occupied cells cost, by their distance to obstacles."""

import math

import numpy as np
import pytest

from explore_slam.exploration.clearance import (
    clearance_factors,
    make_cost_map,
    squared_distance,
    tight_factor,
)
from explore_slam.exploration.sections import PathConfig
from explore_slam.mapping import GridConfig, OccupancyGrid

CELL = 0.125  # m; distances in cells are then exact
CONFIG = PathConfig(
    planning_radius=3 * CELL,
    minimum_planning_radius=2 * CELL,
    clearance_distance=4 * CELL,
    clearance_weight=2.0,
)


def test_the_middle_of_a_gap_is_the_cheapest():
    prices = tight_factor(np.array([0.0, 1.0, 2.0, 3.0]), 3.0)
    assert prices.dtype == np.float32
    np.testing.assert_allclose(prices, [60.0, 20.0 * (1 + 4 / 3), 20.0 * (1 + 2 / 3), 20.0])


def test_factors_by_squared_distance():
    factors, tight = clearance_factors(CONFIG, CELL, soft=True)
    distances = np.sqrt(np.arange(len(factors)))
    assert np.isinf(factors[distances <= 3.0]).all()
    near = (distances > 3.0) & (distances < 7.0)
    np.testing.assert_allclose(
        factors[near], 1.0 + 2.0 * ((7.0 - distances[near]) / 4.0) ** 2, rtol=1e-5
    )
    assert factors[-1] == 1.0
    assert np.isinf(tight[distances <= 2.0]).all()
    between = (distances > 2.0) & (distances <= 3.0)
    expected = (1.0 + 2.0) * 20.0 * (1.0 + 2.0 * (1.0 - distances[between] / 3.0))
    np.testing.assert_allclose(tight[between], expected, rtol=1e-5)
    np.testing.assert_array_equal(tight[distances > 3.0], factors[distances > 3.0])


def test_without_soft_costs_cells_beyond_the_radius_cost_nothing_extra():
    factors, _ = clearance_factors(CONFIG, CELL, soft=False)
    assert np.isinf(factors[:10]).all()
    assert (factors[10:] == 1.0).all()


def test_a_minimum_radius_above_the_planning_radius_changes_nothing():
    wide = PathConfig(planning_radius=3 * CELL, minimum_planning_radius=6 * CELL)
    _, tight = clearance_factors(wide, CELL, soft=True)
    assert np.isinf(tight[:10]).all()
    assert np.isfinite(tight[10:]).all()


def test_cells_by_class():
    probability = np.full((9, 30), 0.1)
    known = np.ones((9, 30), bool)
    probability[:, 0] = 0.97
    known[:, -3:] = False
    probability[4, 20] = 0.55
    grid = OccupancyGrid.from_probability(
        probability, known, (0.0, 0.0), GridConfig(resolution=CELL)
    )
    costs = make_cost_map(grid, CONFIG)
    assert np.isinf(costs.cost[:, :4]).all()
    assert np.isinf(costs.cost[:, -3:]).all()
    assert np.isfinite(costs.cost[:, 4:-3]).all()
    assert costs.cost[0, 15] == pytest.approx(1.0)
    assert costs.cost[4, 20] == pytest.approx(0.55 / 0.4, abs=0.01)
    assert costs.cost[4, 5] == pytest.approx(1.0 + 2.0 * 0.5**2, rel=1e-4)
    assert np.isfinite(costs.tight_cost[:, 3]).all()
    assert np.isinf(costs.tight_cost[:, :3]).all()
    assert costs.free[:, 1:-3].all()
    assert not costs.free[:, 0].any()
    np.testing.assert_array_equal(costs.unknown, ~known)
    assert costs.squared[4, 3] == 9
    assert math.isinf(make_cost_map(grid, PathConfig(occ_max=0.5)).cost[4, 20])


@pytest.mark.parametrize('seed', range(4))
@pytest.mark.parametrize('limit', [1, 3, 8])
def test_distances_are_exact_up_to_the_limit(seed, limit):
    generator = np.random.default_rng(seed)
    obstacles = generator.random((17, 23)) < 0.02 * (seed + 1)
    found = squared_distance(obstacles, limit)
    places = np.argwhere(obstacles)
    for row, col in np.ndindex(obstacles.shape):
        exact = ((places - (row, col)) ** 2).sum(axis=1).min() if len(places) else 10**6
        assert found[row, col] == (exact if exact <= limit**2 else found[row, col])
        if exact > limit**2:
            assert found[row, col] > limit**2


def test_probabilities_that_are_not_numbers_are_obstacles():
    class Damaged:
        def __init__(self, grid):
            self._grid = grid

        def __getattr__(self, name):
            return getattr(self._grid, name)

        def probability(self):
            values = self._grid.probability().copy()
            values[:, 20] = np.nan
            return values

    free = np.full((9, 40), 0.1)
    grid = OccupancyGrid.from_probability(free, free < 1.0, config=GridConfig(resolution=CELL))
    costs = make_cost_map(Damaged(grid), CONFIG)
    assert np.isinf(costs.cost[:, 17:24]).all()
    assert np.isfinite(costs.cost[:, :17]).all()
    assert np.isfinite(costs.cost[:, 24:]).all()
