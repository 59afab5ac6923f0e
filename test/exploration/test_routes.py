"""Travel costs on blocks of cells: which cells a block holds, costs, and what is cached."""

import numpy as np
import pytest

from explore_slam.exploration.routes import CostsFrom, RouteCache, RouteGrid, block_size

INF = np.inf


def grid_of_costs(rows, cols, first=(0, 0), block=2, unit=0.5, cost=1.0, blocked=()):
    costs = np.full((rows, cols), cost, np.float32)
    for cell in blocked:
        costs[cell] = INF
    return RouteGrid(costs, np.isfinite(costs), first, block, unit)


def test_blocks_are_counted_from_the_origin_of_the_map():
    grid = grid_of_costs(6, 6, first=(3, -4))
    cells = np.array([[0, 0], [1, 1], [2, 3], [5, 5]])
    assert grid.blocks(cells).tolist() == [[1, -2], [2, -2], [2, -1], [4, 0]]


def test_the_cost_is_the_travel_over_blocks_in_metres():
    grid = grid_of_costs(8, 8)
    field = grid.values_from(np.array([0, 0]))
    at = field.at(np.array([[0, 0], [0, 3], [3, 3], [1, 3], [9, 9], [-1, 0]]))
    expected = [0.0, 3.0, 3 * 2**0.5, 2.0 + 2**0.5, INF, INF]
    assert at.tolist() == pytest.approx(expected, rel=1e-5)


def test_costs_of_a_map_that_begins_off_the_origin():
    grid = grid_of_costs(4, 10, first=(4, -6))
    field = grid.values_from(np.array([2, -3]))
    at = field.at(np.array([[2, -3], [2, 1], [3, -3], [4, -3], [2, 2]]))
    assert at.tolist() == pytest.approx([0.0, 4.0, 1.0, INF, INF])


def test_a_block_costs_what_its_cheapest_reachable_cell_costs():
    costs = np.full((2, 6), 5.0, np.float32)
    costs[1, 3] = 2.0
    costs[0, 5] = 1.0
    reach = np.ones((2, 6), bool)
    reach[0, 5] = False
    grid = RouteGrid(costs, reach, (0, 0), 2, 0.5)
    assert grid.padded[1, 1:4].tolist() == [5.0, 2.0, 5.0]
    shifted = RouteGrid(costs, reach, (0, 1), 2, 0.5)
    assert shifted.padded[1, 1:5].tolist() == [5.0, 5.0, 2.0, 5.0]


def test_the_same_place_has_the_same_cost_whatever_part_of_the_map_is_known():
    small = grid_of_costs(6, 6, first=(2, 2))
    large = grid_of_costs(13, 11, first=(-5, -3))
    blocks = np.array([[1, 1], [3, 2]])
    assert small.values_from(blocks[0]).at(blocks)[1] == large.values_from(blocks[0]).at(blocks)[1]


@pytest.mark.parametrize(('largest', 'searches'), [(1000, 1), (0, 2)])
def test_costs_from_a_block_are_those_of_its_field(monkeypatch, largest, searches):
    grid = grid_of_costs(8, 16, blocked=[(r, 6) for r in range(6)])
    field = grid.values_from(np.array([0, 0]))
    made = []
    monkeypatch.setattr(grid, 'values_from', lambda block: made.append(block) or field)
    costs = CostsFrom(grid, np.array([0, 0]), largest)
    some = np.array([[0, 7], [3, 3], [0, 7], [9, 9]])
    other = np.array([[0, 7], [1, 5]])
    for blocks in (some, some[1:], np.empty((0, 2), np.int64), other, some):
        assert costs.to(blocks).tolist() == field.at(blocks).tolist()
    assert len(made) == searches


def test_the_cache_keeps_fields_and_takes_the_shorter_of_both_ways():
    cache = RouteCache(lifetime=3)
    closed = grid_of_costs(8, 8, blocked=[(r, 4) for r in range(8)] + [(r, 5) for r in range(8)])
    opened = grid_of_costs(8, 8)
    blocks = np.array([[0, 0], [0, 3]])
    assert np.isinf(cache.between(closed, blocks)[0, 1])
    # the fields of the closed map are still in use; a new target has one of its own
    again = cache.between(opened, blocks)
    assert np.isinf(again[0, 1])
    third = cache.between(opened, np.array([[0, 0], [0, 3], [3, 0]]))
    assert third[0, 2] == third[2, 0] == pytest.approx(3.0)
    assert third[1, 2] == pytest.approx(3 * 2**0.5, rel=1e-5)
    # after their lifetime they are computed anew
    fresh = [cache.between(opened, blocks)[0, 1] for _ in range(2)]
    assert np.isinf(fresh[0])
    assert fresh[1] == pytest.approx(3.0)


def test_targets_that_are_gone_are_forgotten():
    cache = RouteCache()
    grid = grid_of_costs(8, 8)
    cache.between(grid, np.array([[0, 0], [0, 3]]))
    cache.between(grid, np.array([[0, 3], [1, 1]]))
    assert sorted(cache._fields) == [(0, 3), (1, 1)]


def room(rows=20, cols=40, wall=20, door=None):
    """A room of which a wall of two columns parts the left from the right, but for a door."""
    walls = [
        (r, c) for r in range(rows) for c in (wall, wall + 1) if r not in (door, door and door + 1)
    ]
    return grid_of_costs(rows, cols, blocked=walls)


def test_on_a_large_map_costs_are_those_of_the_fields_where_they_are_known():
    grid = room(door=4)
    blocks = np.array([[0, 0], [9, 3], [2, 16], [8, 18], [5, 2]])
    targets = np.array([0, 1, 2, 3])
    exact = RouteCache().between(grid, blocks, targets)
    assert np.isfinite(exact).all()
    found = RouteCache(largest_field=10).between(grid, blocks, targets)
    np.testing.assert_allclose(found, exact)


def test_on_a_large_map_few_costs_are_computed_anew_in_a_cycle():
    closed, opened = room(), room(door=4)
    blocks = np.array([[0, 0], [9, 3], [2, 16], [8, 18], [5, 2], [1, 17]])
    first = np.array([0, 1, 2, 3])
    cache = RouteCache(lifetime=3, largest_field=10)
    before = cache.between(closed, blocks, first)
    assert np.isinf(before[:2, 2:]).all()
    exact = RouteCache().between(opened, blocks, first)
    for _ in range(3):
        assert np.isinf(cache.between(opened, blocks, first)[:2, 2:]).all()
    half = cache.between(opened, blocks, first)  # two of four targets have been renewed
    assert 0 < np.isfinite(half[:2, 2:]).sum() <= 4
    whole = cache.between(opened, blocks, first)
    np.testing.assert_allclose(whole, exact)


def test_on_a_large_map_the_way_from_many_new_targets_leads_over_a_vehicle():
    grid = grid_of_costs(4, 240)  # 60 m long
    blocks = np.array([[0, col] for col in (0, 110, 112, 114, 116, 118)])
    cache = RouteCache(largest_field=10)
    cache.between(grid, blocks, np.array([0]))
    costs = np.abs(blocks[None, :, 1] - np.array([[5], [108]])) * grid.unit
    found = cache.between(grid, blocks, np.arange(6), costs)
    exact = RouteCache().between(grid, blocks, np.arange(6))
    # near targets know the ways among them, and the old target the way to all of them
    np.testing.assert_allclose(found, exact)
    new = np.array([[0, 100], [0, 60], [0, 62], [0, 64], [0, 10], [0, 0]])
    costs = np.abs(new[None, :, 1] - np.array([[5], [66]])) * grid.unit
    found = cache.between(grid, new, np.arange(5), costs)  # the last one is a frontier only
    exact = RouteCache().between(grid, new, np.arange(5))
    assert np.isfinite(found).all()
    assert (found >= exact - 1e-3).all()
    assert found[3, 4] == pytest.approx(exact[3, 4] + 2 * 2 * grid.unit)  # from 64 over 66 to 10


def test_values_near_a_block_are_those_of_the_whole_grid_there():
    grid = grid_of_costs(8, 80, first=(-4, 6))
    block = np.array([-1, 10])
    near = grid.values_near(block, 5.0)
    blocks = np.array([[-1, 10], [1, 5], [-2, 15], [1, 3], [0, 16], [-1, 4]])
    exact = grid.values_from(block).at(blocks)
    assert near.at(blocks[:3]).tolist() == exact[:3].tolist()
    assert np.isinf(near.at(blocks[4:])).all()


def test_rows_of_targets_that_are_gone_are_forgotten():
    cache = RouteCache(largest_field=10)
    grid = grid_of_costs(8, 20)
    cache.between(grid, np.array([[0, 0], [0, 3], [2, 2]]), np.array([0, 1]))
    cache.between(grid, np.array([[0, 3], [1, 1]]), np.array([1]))
    assert sorted(cache._fields) == [(0, 3), (1, 1)]


@pytest.mark.parametrize(
    ('width', 'radius', 'resolution', 'cells'),
    [(0.3, 0.5, 0.1, 3), (0.3, 0.25, 0.1, 2), (0.3, 0.0, 0.1, 1), (0.35, 1.0, 0.1, 3)],
)
def test_blocks_are_no_wider_than_the_radius(width, radius, resolution, cells):
    assert block_size(width, radius, resolution) == cells
