"""Ways that are blocked only by what may go away again."""

from dataclasses import replace

import numpy as np
import pytest
from exploration_maps import grid_of

from explore_slam.exploration.clearance import make_cost_map
from explore_slam.exploration.known_ways import KnownWays
from explore_slam.exploration.sections import PathConfig

CELL = 0.125
PATHS = PathConfig()
OPEN = """
##############
#............#
#............#
#............#
##############
"""
DOOR = OPEN.replace('#............#', '#.....#......#')
WINDOW = """
##############
#............#
#.....#......#
#............#
##############
"""


def costs_of(text, letters=4):
    grid = grid_of(text, resolution=CELL, cells_per_letter=letters)
    return grid, make_cost_map(grid, PATHS)


def blocked(before, after, people=False, forbidden=None):
    ways = KnownWays()
    for text in (before, after):
        grid, costs = costs_of(text)
        ways.update(grid, costs)
    return ways.blocked(costs, PATHS.planning_radius, forbidden, people=people), costs


def test_a_door_that_has_closed_is_a_blocked_way_and_the_walls_are_not():
    found, costs = blocked(OPEN, DOOR)
    row = found[10]
    assert row[6 * 4 : 7 * 4].all()  # the door
    assert not found[:4].any()
    assert not found[:, :4].any()
    assert not (found & np.isfinite(costs.cost)).any()


def test_what_was_closed_from_the_beginning_is_not_blocked():
    found, _ = blocked(DOOR, DOOR)
    assert not found.any()


def test_a_small_obstacle_may_be_a_person_that_was_never_seen_to_come():
    assert not blocked(WINDOW, WINDOW)[0].any()
    found, costs = blocked(WINDOW, WINDOW, people=True)
    assert found[10, 6 * 4 : 7 * 4].all()
    assert not (found & np.isfinite(costs.cost)).any()


def test_what_is_forbidden_stays_closed():
    grid, _ = costs_of(DOOR)
    forbidden = np.zeros(grid.shape, np.bool_)
    forbidden[:, 6 * 4 : 7 * 4] = True
    found, _ = blocked(OPEN, DOOR, forbidden=forbidden)
    assert not found[:, 6 * 4 : 7 * 4].any()


class Moved:
    """A grid that has grown by some rows and columns on every side."""

    def __init__(self, grid, rows, cols):
        self.resolution = grid.resolution
        x, y = grid.origin
        self.origin = (x - cols * CELL, y - rows * CELL)
        self.shape = (grid.shape[0] + 2 * rows, grid.shape[1] + 2 * cols)


@pytest.mark.parametrize(('rows', 'cols'), [(3, 5), (0, 2), (-2, -3)])
def test_the_memory_follows_a_grid_that_grows(rows, cols):
    ways = KnownWays()
    grid, costs = costs_of(OPEN)
    ways.update(grid, costs)
    moved = Moved(grid, rows, cols)
    nothing = replace(
        costs, cost=np.full(moved.shape, np.inf, np.float32), free=np.zeros(moved.shape, np.bool_)
    )
    ways.update(moved, nothing)
    passable = np.pad(np.isfinite(costs.cost), 5)
    expected = passable[5 - rows :, 5 - cols :][: moved.shape[0], : moved.shape[1]]
    np.testing.assert_array_equal(ways._passable(), expected)
