"""Value iteration and A* against Dijkstra of scipy on the same graph."""

import itertools
import math

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from explore_slam.errors import ExplorationError
from explore_slam.exploration import plan_path, shortcut, travel_cost
from explore_slam.exploration.paths import SearchMemory, search_path
from explore_slam.exploration.value_iteration import padded_costs

OCC_MAX = 0.6


def exact_values(grid, start, charged='entered'):
    height, width = grid.shape
    rows, cols, data = [], [], []
    for r in range(height):
        for c in range(width):
            for dr in (-1, 0, 1):
                for dc in (-1, 0, 1):
                    nr, nc = r + dr, c + dc
                    inside = (dr or dc) and 0 <= nr < height and 0 <= nc < width
                    if inside and grid[r, c] <= OCC_MAX and grid[nr, nc] <= OCC_MAX:
                        rows.append(r * width + c)
                        cols.append(nr * width + nc)
                        paid = grid[nr, nc] if charged == 'entered' else grid[r, c]
                        data.append(math.hypot(dr, dc) * float(paid))
    graph = csr_matrix((data, (rows, cols)), shape=(grid.size, grid.size))
    return dijkstra(graph, indices=start[0] * width + start[1]).reshape(grid.shape)


def random_grid(seed, low=0.03, high=0.5):
    generator = np.random.default_rng(seed)
    grid = generator.uniform(low, high, (37, 52)).astype(np.float32)
    grid[generator.random(grid.shape) < 0.3] = 0.9
    grid[5, 7] = 0.1
    return grid


def office_grid():
    grid = np.full((61, 61), 0.03, np.float32)
    grid[::12] = grid[:, ::12] = 0.97
    for k in range(0, 48, 12):
        for j in range(0, 60, 12):
            grid[k + 12, j + 4 : j + 8] = 0.03
            grid[j + 3 : j + 9, k + 12] = 0.03
    return grid


@pytest.mark.parametrize('charged', ['entered', 'left'])
@pytest.mark.parametrize(
    'grid',
    [random_grid(0), random_grid(1), random_grid(2, 1e-5, 0.6), office_grid()],
    ids=['random', 'random2', 'widely spread', 'office'],
)
def test_values_are_those_of_dijkstra(grid, charged):
    start = (5, 7)
    expected = exact_values(grid, start, charged)
    values = travel_cost(grid, start, OCC_MAX, charged=charged)
    seen = np.isfinite(expected)
    assert np.array_equal(np.isfinite(values), seen)
    assert seen.sum() > 100
    np.testing.assert_allclose(values[seen], expected[seen], rtol=1e-4, atol=1e-7)


def test_values_are_the_fixed_point_of_the_update_rule():
    grid = random_grid(4)
    values = travel_cost(grid, (5, 7), OCC_MAX).astype(np.float64)
    padded = np.pad(values, 1, constant_values=np.inf)
    best = np.full(grid.shape, np.inf)
    for dr in (-1, 0, 1):
        for dc in (-1, 0, 1):
            if dr or dc:
                moved = padded[1 + dr : 38 + dr, 1 + dc : 53 + dc]
                best = np.minimum(best, moved + math.hypot(dr, dc) * grid)
    best[5, 7] = 0.0
    best[grid > OCC_MAX] = np.inf
    seen = np.isfinite(values)
    np.testing.assert_allclose(best[seen], values[seen], rtol=1e-5)


def test_free_cells_of_probability_zero_cost_nothing():
    grid = np.zeros((20, 30), np.float32)
    grid[:, 15] = 0.9
    values = travel_cost(grid, (0, 0))
    assert (values[:, :15] == 0.0).all()
    assert np.isinf(values[:, 15:]).all()


def test_resolution_scales_the_values():
    grid = random_grid(5)
    coarse, fine = travel_cost(grid, (5, 7)), travel_cost(grid, (5, 7), resolution=0.05)
    seen = np.isfinite(coarse)
    np.testing.assert_allclose(fine[seen], 0.05 * coarse[seen], rtol=1e-6)


@pytest.mark.parametrize('seed', range(6))
def test_the_cost_of_a_path_is_the_value_of_its_goal(seed):
    grid = random_grid(seed)
    values = travel_cost(grid, (5, 7), OCC_MAX)
    generator = np.random.default_rng(seed)
    goals = np.argwhere(np.isfinite(values))
    for goal in generator.choice(goals, 10):
        cells, cost = plan_path(grid, (5, 7), tuple(goal), OCC_MAX)
        assert cost == pytest.approx(values[tuple(goal)], rel=1e-4)
        assert tuple(cells[0]) == (5, 7)
        assert tuple(cells[-1]) == tuple(goal)
        assert (np.abs(np.diff(cells, axis=0)).max(axis=1) == 1).all() or len(cells) == 1
        paid = np.hypot(*np.diff(cells, axis=0).T) @ grid[cells[1:, 0], cells[1:, 1]]
        assert cost == pytest.approx(paid, rel=1e-5)


@pytest.mark.parametrize('seed', range(3))
def test_paths_are_cheapest_where_the_lower_bound_is_tight(seed):
    """All free cells cost the same, so that a bound too high would lead astray."""
    grid = np.where(random_grid(seed) > OCC_MAX, 0.9, 0.1).astype(np.float32)
    start = (18, 26)
    grid[start] = 0.1
    values = travel_cost(grid, start, OCC_MAX)
    goals = np.argwhere(np.isfinite(values))
    for goal in goals[:: len(goals) // 60]:
        cells, cost = plan_path(grid, start, tuple(goal), OCC_MAX)
        assert cost == pytest.approx(values[tuple(goal)], rel=1e-5)
        assert tuple(cells[-1]) == tuple(goal)


def test_a_goal_behind_walls_has_no_path():
    grid = np.full((9, 9), 0.1, np.float32)
    grid[:, 4] = 0.9
    cells, cost = plan_path(grid, (1, 1), (1, 8))
    assert cells.shape == (0, 2)
    assert math.isinf(cost)


def test_shortcuts_are_straight_and_stay_clear():
    grid = np.full((40, 40), 1.0, np.float32)
    grid[10:30, 20] = np.inf
    cells, cost = plan_path(np.where(np.isinf(grid), 0.9, 0.1), (20, 5), (22, 35))
    corners = shortcut(grid, cells)
    assert tuple(corners[0]) == (20, 5)
    assert tuple(corners[-1]) == (22, 35)
    assert len(corners) <= 5
    length = np.hypot(*np.diff(corners, axis=0).T).sum()
    assert length <= cost / 0.1 * 1.001
    for a, b in itertools.pairwise(corners):
        at = np.linspace(a, b, 200)
        inner = np.floor(at + 0.5).astype(int)
        assert np.isfinite(grid[inner[:, 0], inner[:, 1]]).all()


@pytest.mark.parametrize(
    ('grid', 'start', 'message'),
    [
        (np.empty((0, 0)), (0, 0), 'shape'),
        (np.zeros(5), (0, 0), 'shape'),
        (np.full((3, 3), 0.1), (3, 0), 'outside'),
        (np.full((3, 3), 0.1), (0, -1), 'outside'),
        (np.full((3, 3), 0.9), (1, 1), 'occupied or unknown'),
        (np.full((3, 3), np.nan), (1, 1), 'occupied or unknown'),
        (np.full((3, 3), -0.1), (1, 1), 'negative'),
    ],
)
def test_bad_grids_and_starts_are_refused(grid, start, message):
    with pytest.raises(ExplorationError, match=message):
        travel_cost(grid, start)
    with pytest.raises(ExplorationError, match=message):
        plan_path(grid, start, (0, 0))


def test_other_bad_input_is_refused():
    grid = np.full((3, 3), 0.1)
    with pytest.raises(ExplorationError, match='goal cell'):
        plan_path(grid, (0, 0), (5, 5))
    with pytest.raises(ExplorationError, match='resolution'):
        travel_cost(grid, (0, 0), resolution=0.0)
    with pytest.raises(ExplorationError, match='charged'):
        travel_cost(grid, (0, 0), charged='both')


def test_a_search_that_uses_its_memory_again_finds_the_same_paths():
    generator = np.random.default_rng(3)
    memory = SearchMemory()
    for size in (20, 40, 30):
        cost = generator.uniform(0.1, 1.0, (size, size)).astype(np.float32)
        cost[generator.random((size, size)) < 0.2] = np.inf
        padded = padded_costs(cost, math.inf)
        free = np.flatnonzero(np.isfinite(padded))
        for start, goal in generator.choice(free, (5, 2)).tolist():
            fresh, expected = search_path(padded, start, goal)
            again, found = search_path(padded, start, goal, memory, 0.1)
            assert found == pytest.approx(expected, rel=1e-12)
            assert len(fresh) == 0 or (again[0], again[-1]) == (start, goal)
            assert math.isinf(expected) == (len(again) == 0)
