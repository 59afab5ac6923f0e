"""What planning keeps between cycles equals what is computed anew, however the grid changes."""

import numpy as np
import pytest
from exploration_maps import grid_of
from scipy import ndimage

from explore_slam.data import VehicleBody
from explore_slam.exploration import ExplorationConfig, VehicleSnapshot
from explore_slam.exploration.clearance import make_cost_map, paths_of
from explore_slam.exploration.frontier_kernels import frontier_cells
from explore_slam.exploration.frontiers import find_frontiers
from explore_slam.exploration.planning_map import Overlay, PlanningMap
from explore_slam.exploration.regions import set_disc
from explore_slam.exploration.routes import RouteGrid
from explore_slam.exploration.scene import Scene
from explore_slam.exploration.tiles import moved
from explore_slam.geometry import Pose2
from explore_slam.mapping import GridConfig, OccupancyGrid

CELL = 0.1  # m
WORLD = 400  # cells
CONFIG = ExplorationConfig()
BODIES = {body.envelope: body for body in (VehicleBody(), VehicleBody(radius=0.45))}
PATHS = {envelope: paths_of(CONFIG.paths, body) for envelope, body in BODIES.items()}


class RandomMap:
    """A building whose map grows, shrinks, moves and changes at random."""

    def __init__(self, seed):
        self.random = np.random.default_rng(seed)
        self.probability = self.random.choice([0.05, 0.3, 0.45, 0.55], (WORLD, WORLD))
        solid = np.zeros((WORLD, WORLD), bool)
        for _ in range(60):
            row, col = self.random.integers(0, WORLD, 2)
            height, width = self.random.permutation([2, int(self.random.integers(5, 120))])
            solid[row : row + height, col : col + width] = True
        self.probability[solid] = 0.9
        self.known = np.zeros((WORLD, WORLD), bool)
        self.box = np.array([128, 256, 128, 256])  # first and last row, first and last column
        for _ in range(6):
            self.change()

    def change(self):
        """Change some cells within the box."""
        low_row, high_row, low_col, high_col = self.box
        for _ in range(int(self.random.integers(0, 4))):
            row, col = (
                self.random.integers(low_row, high_row),
                self.random.integers(low_col, high_col),
            )
            part = np.s_[
                row : row + self.random.integers(1, 50), col : col + self.random.integers(1, 50)
            ]
            kind = self.random.integers(4)
            if kind == 0:
                self.probability[part] = self.random.choice([0.05, 0.45, 0.9])
            elif kind == 1:
                self.probability[row, col] = 0.9
            self.known[part] = kind < 3

    def step(self):
        """Change cells, and now and then the extent: by whole tiles as a rule."""
        self.change()
        if self.random.random() < 0.4:
            side = int(self.random.integers(4))
            by = int(self.random.choice([64, 64, 10]))
            self.box[side] += by * self.random.choice([-1, 1])
            self.box = np.clip(self.box, 0, WORLD)
            if self.box[1] - self.box[0] < 40 or self.box[3] - self.box[2] < 40:
                self.box = np.array([64, 200, 64, 210])

    def grid(self):
        low_row, high_row, low_col, high_col = self.box.tolist()
        part = np.s_[low_row:high_row, low_col:high_col]
        origin = (low_col - 150) * CELL, (low_row - 130) * CELL
        config = GridConfig(resolution=CELL)
        return OccupancyGrid.from_probability(
            self.probability[part], self.known[part], origin, config
        )

    def overlay(self, grid):
        """Discs and a trail that stay at their place in the map for some cycles."""
        if self.random.random() < 0.4:
            self.discs = self.random.uniform(2.0, 25.0, (4, 3)) * [1.0, 1.0, 0.05]
            self.trail = self.random.uniform(2.0, 20.0, (1, 2)) + np.cumsum(
                self.random.uniform(-0.1, 0.1, (60, 2)), axis=0
            )
        discs = [
            (*grid.to_cell([(x, y)])[0].tolist(), radius / CELL) for x, y, radius in self.discs
        ]
        prices = np.linspace(40.0, 20.0, 10).astype(np.float32)
        return Overlay(tuple(discs[:2]), grid.to_cell(self.trail), 1, prices, tuple(discs[2:]))

    discs = np.array([[5.0, 6.0, 0.5]] * 4)
    trail = np.array([[4.0, 4.0]])


def laid_over(cost, overlay, free, squared):
    """The same as the overlay of a layer, cell by cell."""
    cost = cost.copy()
    for discs in (overlay.before, overlay.after):
        if discs is overlay.after:
            for row, col in overlay.trails.tolist():
                near = np.zeros(cost.shape, bool)
                near[max(0, row - 1) : max(0, row + 2), max(0, col - 1) : max(0, col + 2)] = True
                opened = near & free & np.isinf(cost)
                index = np.minimum(squared[opened], len(overlay.prices) - 1)
                cost[opened] = overlay.prices[index]
        for row, col, radius in discs:
            mask = np.zeros(cost.shape, bool)
            set_disc(mask, row, col, radius)
            cost[mask] = np.inf
    return cost


def check_layer(kept, grid, paths, overlay, limited):
    layer, costs = kept
    fresh = make_cost_map(grid, paths)
    np.testing.assert_array_equal(costs.free, fresh.free)
    np.testing.assert_array_equal(costs.unknown, fresh.unknown)
    # layers of unlike sizes share the distances, exact as far as the largest of them needs
    np.testing.assert_array_equal(
        np.minimum(costs.squared, limited), np.minimum(fresh.squared, limited)
    )
    assert costs.roomy == fresh.roomy
    expected = laid_over(fresh.cost, overlay, fresh.free, costs.squared)
    np.testing.assert_array_equal(costs.cost, expected)
    padded = np.pad(expected, 1, constant_values=np.inf)
    np.testing.assert_array_equal(layer.padded, padded)
    tight = laid_over(fresh.tight_cost, overlay, fresh.free, costs.squared)
    np.testing.assert_array_equal(costs.tight_cost, tight)
    assert layer.passable_cells == np.isfinite(expected).sum()
    if fresh.free.any():
        base = np.maximum(grid.probability()[fresh.free], 0.4).min() / 0.4
        assert layer.least == pytest.approx(base)
    mask, counts = costs.frontiers
    again = frontier_cells(fresh.free, fresh.unknown)
    np.testing.assert_array_equal(mask, again.mask)
    np.testing.assert_array_equal(counts, again.counts)
    return expected


def check_regions(layer, costs, expected, grid, random):
    labels, count = ndimage.label(np.isfinite(expected), np.ones((3, 3)))
    chosen = random.permutation(count)[:2] + 1
    masks = []
    for label in chosen:
        cells = np.argwhere(labels == label)
        first, second = (tuple(cells[random.integers(len(cells))].tolist()) for _ in range(2))
        mask = layer.region(first)
        np.testing.assert_array_equal(mask, labels == label)
        assert layer.region(second) is mask
        masks.append(mask)
    if masks:
        x, y = grid.origin
        first = round(y / CELL), round(x / CELL)
        reach = np.logical_or.reduce(masks)
        routes = layer.routes(masks, reach, 3, first)
        anew = RouteGrid(expected, reach, first, 3, CELL)
        np.testing.assert_array_equal(routes.padded, anew.padded)
        assert routes.first == anew.first
        check_frontiers(layer, costs, masks[0], grid)


def check_frontiers(layer, costs, mask, grid):
    cache = layer.frontier_cache(mask)
    found = find_frontiers(grid, CONFIG, costs, mask, cache)
    anew = find_frontiers(grid, CONFIG, costs, mask.copy())
    assert [f.target_cell for f in found] == [f.target_cell for f in anew]
    for one, other in zip(found, anew, strict=True):
        np.testing.assert_array_equal(one.cells, other.cells)
        assert (one.gain, one.showing, one.look_at) == (other.gain, other.showing, other.look_at)


@pytest.mark.parametrize('seed', range(6))
def test_what_is_kept_equals_what_is_computed_anew(seed):
    world, ground = RandomMap(seed), PlanningMap(CONFIG.paths)
    limited = min(int(make_cost_map(world.grid(), one).squared.max()) for one in PATHS.values())
    for cycle in range(40):
        grid = world.grid()
        overlay = world.overlay(grid)
        # now and then a large vehicle takes part
        sizes = list(PATHS) if (cycle // 5) % 2 else list(PATHS)[:1]
        ground.update(grid, {size: PATHS[size] for size in sizes})
        for size in sizes:
            layer, costs = ground.layer(size, overlay)
            expected = check_layer((layer, costs), grid, PATHS[size], overlay, limited)
            check_regions(layer, costs, expected, grid, world.random)
        world.step()


def test_the_tiles_that_have_changed_are_told_once():
    world, ground = RandomMap(7), PlanningMap(CONFIG.paths)
    size = next(iter(PATHS))
    before, seen = None, np.zeros((0, 0), bool)
    for cycle in range(12):
        grid = world.grid()
        ground.update(grid, {size: PATHS[size]})
        layer, costs = ground.layer(size, world.overlay(grid))
        now = costs.cost.copy()
        if cycle % 3 == 0:
            changed = layer.take_changed()
            if before is not None and before.shape == now.shape and grid.origin == seen:
                rows, cols = np.nonzero(before != now)
                assert changed[rows // 64, cols // 64].all()
            assert not layer.take_changed().any()
            before, seen = now, grid.origin
        world.change()


def test_nothing_is_renewed_where_nothing_has_changed():
    world, ground = RandomMap(3), PlanningMap(CONFIG.paths)
    size = next(iter(PATHS))
    grid = world.grid()
    overlay = world.overlay(grid)
    for _ in range(2):
        ground.update(grid, {size: PATHS[size]})
        layer, _ = ground.layer(size, overlay)
        first = layer.take_changed()
    assert not first.any()
    world.probability[200, 200], world.known[200, 200] = 0.9, True
    ground.update(world.grid(), {size: PATHS[size]})
    layer, _ = ground.layer(size, overlay)
    rows, cols = np.nonzero(layer.take_changed())
    assert set(zip(rows.tolist(), cols.tolist(), strict=True)) <= {(1, 1), (0, 1), (1, 0), (0, 0)}


def test_another_meaning_of_the_levels_counts_everywhere():
    ground = PlanningMap(CONFIG.paths)
    size = next(iter(PATHS))
    grid = RandomMap(1).grid()

    class Doubtful:
        def __getattr__(self, name):
            return getattr(grid, name)

        def levels(self):
            cells, table = grid.levels()
            return cells, np.where(table < 0.2, np.float32(0.5), table)

    for one in (grid, Doubtful()):
        ground.update(one, {size: PATHS[size]})
        _, costs = ground.layer(size, Overlay())
    sure = make_cost_map(grid, PATHS[size])
    np.testing.assert_array_equal(costs.squared, sure.squared)
    raised = np.isfinite(sure.cost) & (grid.probability() < 0.2)
    np.testing.assert_allclose(costs.cost[raised], 1.25 * sure.cost[raised], rtol=1e-6)


def test_arrays_move_with_the_grid():
    array = np.arange(6).reshape(2, 3)
    assert moved(array, (1, -1), (3, 4), 9).tolist() == [[9] * 4, [1, 2, 9, 9], [4, 5, 9, 9]]
    assert moved(array, (-1, 2), (2, 3), 9).tolist() == [[9, 9, 3], [9, 9, 9]]
    assert moved(array, (5, 0), (2, 2), 9).tolist() == [[9, 9], [9, 9]]


HALL = """
####################
#..................#
#..................#
#..................#
#.........#........#
####################
"""


def test_a_scene_of_kept_arrays_is_the_same_scene():
    ground = PlanningMap(CONFIG.paths)
    grid = grid_of(HALL, resolution=CELL, cells_per_letter=8)
    for x in (2.0, 3.0, 5.0):
        vehicles = {
            'a': VehicleSnapshot(Pose2(x, 2.0, 0.0)),
            'b': VehicleSnapshot(Pose2(13.0, 2.0, 0.0), active=x < 3.0),
        }
        kept = Scene(grid, 0.0, CONFIG, vehicles, keep_out=[(x, 3.0)], ground=ground)
        fresh = Scene(grid, 0.0, CONFIG, vehicles, keep_out=[(x, 3.0)])
        np.testing.assert_array_equal(kept.costs.cost, fresh.costs.cost)
        np.testing.assert_array_equal(kept.reach['a'], fresh.reach['a'])
        assert kept.free_area() == fresh.free_area()
        cell = kept.cell_of((9.0, 2.0))
        np.testing.assert_array_equal(kept.path('a', cell), fresh.path('a', cell))
