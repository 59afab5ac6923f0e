"""Discs, connected regions, nearest passable cells, opened trails."""

import math

import numpy as np
import pytest

from explore_slam.exploration.regions import (
    connected_region,
    nearest_passable,
    open_around,
    set_disc,
)

INF = np.inf
EVERY = np.ones((1, 1), np.bool_)  # squares of cells


@pytest.mark.parametrize('center', [(5, 6), (0, 0), (9, 11), (-2, 3), (5, 14), (-9, -9)])
@pytest.mark.parametrize('radius', [0.0, 1.0, 2.5, 4.9])
def test_a_disc_holds_the_cells_within_its_radius(center, radius):
    mask = np.zeros((10, 12), np.bool_)
    set_disc(mask, *center, radius)
    rows, cols = np.indices(mask.shape)
    expected = (rows - center[0]) ** 2 + (cols - center[1]) ** 2 <= radius**2
    np.testing.assert_array_equal(mask, expected)


def test_a_region_is_connected_over_corners_and_ends_at_walls():
    cost = np.array(
        [[1, 1, INF, 1], [INF, INF, 1, INF], [1, INF, INF, INF], [1, 1, INF, 1]], np.float32
    )
    np.testing.assert_array_equal(
        connected_region(cost, 0, 0),
        np.array([[1, 1, 0, 1], [0, 0, 1, 0], [0, 0, 0, 0], [0, 0, 0, 0]], bool),
    )
    np.testing.assert_array_equal(
        connected_region(cost, 3, 1),
        np.array([[0, 0, 0, 0], [0, 0, 0, 0], [1, 0, 0, 0], [1, 1, 0, 0]], bool),
    )


def test_the_nearest_passable_cell_is_the_nearest_within_the_radius():
    cost = np.full((9, 9), INF, np.float32)
    cost[2, 3] = cost[7, 8] = 1.0
    assert nearest_passable(cost, (2, 3), 0.0) == (2, 3)
    assert nearest_passable(cost, (2, 5), 2.0) == (2, 3)
    assert nearest_passable(cost, (2, 5), 1.9) is None
    assert nearest_passable(cost, (4, 5), 2.7) is None
    assert nearest_passable(cost, (4, 5), 2.9) == (2, 3)
    assert nearest_passable(cost, (5, 6), 9.0) == (7, 8)
    assert nearest_passable(cost, (7, 11), 3.0) == (7, 8)
    assert nearest_passable(cost, (-1, 3), 3.0) == (2, 3)
    assert nearest_passable(cost, (-1, 3), 2.9) is None
    assert nearest_passable(cost, (99, 99), 3.0) is None


def test_a_trail_is_opened_at_the_price_of_its_clearance():
    cost = np.full((7, 9), INF, np.float32)
    cost[3, 6] = 1.0
    allowed = np.ones((7, 9), np.bool_)
    allowed[2, 3] = False
    squared = np.tile(np.arange(9, dtype=np.int32), (7, 1))
    prices = np.array([9.0, 8.0, 7.0, 6.0, 5.0], np.float32)
    open_around(cost, allowed, squared, np.array([[3, 2], [3, 2], [3, 5]]), 1, prices, EVERY)
    expected = np.full((7, 9), INF, np.float32)
    expected[2:5, 1:4] = [[8.0, 7.0, 6.0]] * 3
    expected[2:5, 4:7] = 5.0
    expected[2, 3] = INF
    expected[3, 6] = 1.0
    np.testing.assert_array_equal(cost, expected)


def test_a_trail_along_the_edge_of_the_grid_stays_inside():
    cost = np.full((3, 4), INF, np.float32)
    squared = np.ones((3, 4), np.int32)
    prices = np.array([3.0, 2.0], np.float32)
    open_around(
        cost, np.ones((3, 4), np.bool_), squared, np.array([[0, 0], [2, 3]]), 1, prices, EVERY
    )
    assert math.isinf(cost[0, 2])
    assert math.isinf(cost[2, 1])
    assert np.isfinite(cost).sum() == 8
