"""Kernels of the search for frontiers, on grids small enough to be done by hand."""

import math

import numpy as np
import pytest

from explore_slam.exploration.frontier_kernels import (
    Viewpoints,
    find_viewpoint,
    frontier_cells,
    frontier_clusters,
    pocket_size,
    visible_unknown,
)


def masks(text):
    letters = np.array([list(line.strip()) for line in text.strip().splitlines()])
    return letters == '.', letters == '?'


def viewpoint_of(free, viewpoints, cells, reach, roomy=0, squared=None):
    distances = np.zeros(free.shape, np.uint16) if squared is None else squared
    kinds = Viewpoints(viewpoints, distances)
    return find_viewpoint(free, kinds, roomy, marks(free.shape), 1, cells, reach)


def clusters(text):
    cells, lengths = frontier_clusters(frontier_cells(*masks(text)))
    parts = np.split(cells, np.cumsum(lengths)[:-1]) if len(lengths) else []
    return [sorted(map(tuple, part.tolist())) for part in parts]


def marks(shape):
    return np.zeros(shape, np.int32)


def test_a_frontier_cell_is_free_with_an_unknown_neighbour_beside_it():
    assert clusters(
        """
        ....??
        ....??
        .##.??
        ......
        """
    ) == [[(0, 3), (1, 3), (2, 3), (3, 4), (3, 5)]]


def test_diagonal_neighbours_do_not_make_a_frontier():
    assert (
        clusters(
            """
        ...
        .##
        .#?
        """
        )
        == []
    )


def test_clusters_that_do_not_touch_are_apart():
    found = clusters(
        """
        ???????
        ???????
        .#.#...
        .......
        """
    )
    assert found == [[(2, 0)], [(2, 2)], [(2, 4), (2, 5), (2, 6)]]


@pytest.mark.parametrize(
    ('unknown', 'counts'),
    [
        ([(2, 2)], False),
        ([(2, 2), (2, 3)], False),
        ([(2, 2), (2, 3), (3, 2)], True),  # three in one window of 3 x 3
        ([(2, 2), (1, 1), (3, 3)], True),  # corners count, on both sides
        ([(2, 2), (1, 3), (3, 1)], True),
        ([(2, 2), (2, 4), (4, 2)], False),  # two cells away: another window
        ([(2, 2), (0, 2), (2, 0)], False),
        ([(2, 2), (2, 4), (1, 4)], False),
        ([(2, 3), (2, 1), (1, 1)], False),
        ([(2, 2), (4, 2), (4, 1)], False),
        ([(3, 2), (1, 2), (1, 1)], False),
    ],
)
def test_isolated_unknown_cells_are_no_frontier(unknown, counts):
    free = np.ones((6, 6), np.bool_)
    gaps = np.zeros((6, 6), np.bool_)
    for cell in unknown:
        free[cell], gaps[cell] = False, True
    _, lengths = frontier_clusters(frontier_cells(free, gaps))
    assert (len(lengths) > 0) is counts


def test_unknown_cells_at_the_edge_of_the_grid_count_too():
    assert clusters(
        """
        ??.
        ?..
        ...
        """
    ) == [[(0, 2), (1, 1), (2, 0)]]


def test_the_viewpoint_is_the_cell_of_the_cluster_nearest_to_its_centre():
    free, _ = masks('\n'.join(['.' * 9] * 3))
    cells = np.array([[1, c] for c in range(9)])
    viewpoints = np.ones((3, 9), np.bool_)
    assert viewpoint_of(free, viewpoints, cells, 0) == (1, 4)
    viewpoints[:, 3:6] = False
    assert viewpoint_of(free, viewpoints, cells, 0) == (1, 2)
    squared = np.full((3, 9), 5, np.uint16)
    squared[:, 2] = 4
    assert viewpoint_of(free, viewpoints, cells, 0, 5, squared) == (1, 6)
    assert viewpoint_of(free, viewpoints, cells, 0, 6, squared) == (-1, -1)


def test_a_viewpoint_beside_the_cluster_is_reached_over_free_cells_only():
    free, _ = masks(
        """
        .......
        ####.##
        .......
        """
    )
    cells = np.array([[0, 0], [0, 1]])
    viewpoints = np.zeros(free.shape, np.bool_)
    viewpoints[2, 0] = True
    # around the wall: 4 cells along, 2 through the gap, 4 back; straight down it would be 2
    assert viewpoint_of(free, viewpoints, cells, 9) == (2, 0)
    assert viewpoint_of(free, viewpoints, cells, 8) == (-1, -1)


def test_of_viewpoints_at_one_distance_the_one_nearest_to_the_centre_is_taken():
    free = np.ones((5, 9), np.bool_)
    cells = np.array([[0, c] for c in range(9)])
    viewpoints = np.zeros((5, 9), np.bool_)
    viewpoints[2, 1] = viewpoints[2, 5] = viewpoints[3, 4] = True
    assert viewpoint_of(free, viewpoints, cells, 4) == (2, 5)


def test_a_pocket_is_counted_up_to_the_limit_and_has_a_centre():
    _, unknown = masks(
        """
        ........
        .???....
        .???..??
        ......??
        """
    )
    cells = np.array([[1, 4], [2, 4]])
    assert pocket_size(unknown, marks(unknown.shape), 1, cells, 100)[:3] == (6, 1.5, 2.0)
    size, row, col, _ = pocket_size(unknown, marks(unknown.shape), 1, cells, 4)
    assert size == 4
    assert 1.0 <= row <= 2.0
    assert 1.0 < col <= 3.0
    alone = np.array([[0, 6]])
    assert pocket_size(unknown, marks(unknown.shape), 1, alone, 100)[:3] == (0, 0, 6)


@pytest.mark.parametrize('reach', [5, 12])
def test_all_of_a_disc_is_visible_where_nothing_is_in_the_way(reach):
    unknown = np.ones((41, 41), np.bool_)
    seen = visible_unknown(~unknown, unknown, 20, 20, reach, 40)
    assert seen == pytest.approx(math.pi * reach * (reach + 1))


def test_what_lies_behind_obstacles_is_not_visible_and_known_cells_do_not_count():
    free = np.zeros((41, 61), np.bool_)
    unknown = np.zeros((41, 61), np.bool_)
    free[:, :31] = True
    unknown[:, 40:] = True  # behind the wall of columns 31 to 39
    assert visible_unknown(free, unknown, 20, 25, 20, 40) == 0.0
    free[:, 31:40] = True
    half = visible_unknown(free, unknown, 20, 25, 20, 360)
    radius, distance = 20.5, 14.5  # of whole cells that a ray enters
    sector = radius**2 * math.acos(distance / radius)
    sector -= distance * math.sqrt(radius**2 - distance**2)
    assert half == pytest.approx(sector, rel=0.03)


def test_beyond_the_edge_of_the_grid_everything_is_unknown():
    known = np.ones((9, 9), np.bool_)
    seen = visible_unknown(known, ~known, 4, 4, 20, 720)
    assert seen == pytest.approx(math.pi * 20.0**2 - 81.0, rel=0.03)


@pytest.mark.parametrize('turns', range(4))
@pytest.mark.parametrize('flipped', [False, True])
def test_a_pocket_is_found_on_every_side(turns, flipped):
    unknown = np.zeros((7, 7), np.bool_)
    unknown[1:3, 2:4] = True  # above cell (3, 3), and to the left of that
    if flipped:
        unknown = unknown[:, ::-1]
    turned = np.ascontiguousarray(np.rot90(unknown, turns))
    size, row, col, _ = pocket_size(turned, marks((7, 7)), 1, np.array([[3, 3]]), 100)
    assert size == 4
    assert (row, col) == tuple(np.argwhere(turned).mean(axis=0))
