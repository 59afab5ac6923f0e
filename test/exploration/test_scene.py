"""The map of one planning cycle: who can get where, obstacles that are vehicles, trails, zones."""

import itertools
import math

import numpy as np
import pytest
from exploration_maps import grid_of, point_of

from explore_slam.data import VehicleBody
from explore_slam.exploration import ExplorationConfig, VehicleSnapshot
from explore_slam.exploration.scene import Scene
from explore_slam.exploration.traffic import Traveler
from explore_slam.geometry import Pose2
from explore_slam.settings import with_values

CELL = 0.125
LETTER = 4  # cells: 0.5 m
HALL = """
####################
#..................#
#..................#
#..................#
#..................#
#..................#
####################
"""
ROOMS = """
####################
#.........#........#
#.........#........#
#..................#
#.........#........#
#.........#........#
####################
"""
EXACT = {
    'planning_radius': 0.375,
    'minimum_planning_radius': 0.125,
    'clearance_distance': 0.0,
    'vehicle_separation': 1.0,
}


def config(**values):
    return with_values(ExplorationConfig(), {**EXACT, **values})


def grid_from(text):
    return grid_of(text, resolution=CELL, cells_per_letter=LETTER)


def place(row, col, text=HALL):
    return point_of(row, col, text, resolution=CELL, cells_per_letter=LETTER)


def at(row, col, text=HALL, active=True):
    return VehicleSnapshot(Pose2(*place(row, col, text), 0.0), active)


def scene(vehicles, text=HALL, settings=None, **more):
    return Scene(grid_from(text), 0.0, settings or config(), vehicles, **more)


def gap(path, spot):
    """Distance (m) of a path from a place."""
    dense = np.vstack([np.linspace(p, q, 50) for p, q in itertools.pairwise(path)])
    return np.hypot(*(dense - spot).T).min()


def passable(made, row, col, text=HALL):
    return bool(np.isfinite(made.costs.cost[made.cell_of(place(row, col, text))]))


def test_vehicles_in_one_room_share_what_they_reach():
    made = scene({'a': at(3, 3), 'b': at(3, 12)})
    assert made.reach['a'] is made.reach['b']
    assert made.reachable() is made.reach['a']
    assert made.starts['a'] == made.cell_of(place(3, 3))


def test_rooms_without_a_way_between_them_are_reached_apart():
    vehicles = {'a': at(3, 3, ROOMS), 'b': at(3, 15, ROOMS)}
    made = scene(vehicles, ROOMS, config(minimum_planning_radius=0.375))
    assert not (made.reach['a'] & made.reach['b']).any()
    np.testing.assert_array_equal(made.reachable(), made.reach['a'] | made.reach['b'])
    assert not made.allow_tight('a')
    assert math.isinf(made.cost_to('a', np.array([made.starts['b']]))[0])
    assert made.path('a', made.starts['b']) is None


def test_a_trapped_vehicle_may_use_the_tight_door():
    slim = VehicleBody(radius=0.25 - 0.125)
    vehicles = {name: at(3, col, ROOMS)._replace(body=slim) for name, col in (('a', 3), ('b', 15))}
    made = scene(vehicles, ROOMS, config(planning_radius=0.5, minimum_planning_radius=0.25))
    assert not (made.reach['a'] & made.reach['b']).any()
    before = made.cost_to('a', np.array([made.starts['b']]))[0]
    assert made.allow_tight('a')
    assert made.tight == {'a'}
    assert not made.allow_tight('a')
    after = made.cost_to('a', np.array([made.starts['b']]))[0]
    assert math.isinf(before)
    assert math.isfinite(after)
    path = made.path('a', made.starts['b'])
    assert path[0].tolist() == list(place(3, 3, ROOMS))
    np.testing.assert_allclose(path[-1], place(3, 15, ROOMS), atol=CELL)
    assert gap(path, place(3, 10, ROOMS)) < 0.1
    made.forbid_tight('a')
    assert made.tight == set()
    assert math.isinf(made.cost_to('a', np.array([made.starts['b']]))[0])


def test_no_vehicle_passes_a_gap_that_its_follower_refuses():
    made = scene({'a': at(3, 3, ROOMS), 'b': at(3, 15, ROOMS)}, ROOMS)
    assert not made.allow_tight('a')  # 0.125 m are asked for, 0.27 m are its own


def test_a_vehicle_that_takes_no_part_is_an_obstacle_of_twice_its_radius():
    made = scene({'a': at(3, 3), 'b': at(3, 10, active=False)})
    assert 'b' not in made.vehicles
    x, y = place(3, 10)
    for distance, free in ((0.0, False), (0.7, False), (0.9, True)):
        for direction in ((1.0, 0.0), (-1.0, 0.0)):
            cell = made.cell_of((x + distance * direction[0], y + distance * direction[1]))
            assert np.isfinite(made.costs.cost[cell]) == free
            assert np.isfinite(made.costs.tight_cost[cell]) == free


def test_keep_out_zones_are_small_discs():
    spot = place(3, 10)
    made = scene({'a': at(3, 3)}, keep_out=[spot])
    for distance, free in ((0.0, False), (0.2, False), (0.38, True)):
        cell = made.cell_of((spot[0] + distance, spot[1]))
        assert np.isfinite(made.costs.cost[cell]) == free


def test_a_trail_through_a_gap_that_is_too_narrow_is_open():
    trail = [place(3, 8, ROOMS), place(3, 12, ROOMS)]
    narrow = config(minimum_planning_radius=0.375)
    closed = scene({'a': at(3, 3, ROOMS)}, ROOMS, narrow)
    opened = scene({'a': at(3, 3, ROOMS)}, ROOMS, narrow, trails={'a': trail})
    assert not passable(closed, 3, 10, ROOMS)
    assert passable(opened, 3, 10, ROOMS)
    assert opened.reach['a'][opened.cell_of(place(3, 15, ROOMS))]
    cell = opened.cell_of(place(3, 10, ROOMS))
    assert opened.costs.cost[cell] > 20.0


def test_no_vehicle_starts_far_from_free_cells():
    made = scene({'a': at(0, 0), 'b': VehicleSnapshot(Pose2(-9.0, -9.0, 0.0))})
    assert list(made.starts) == ['a']
    assert np.isfinite(made.costs.cost[made.starts['a']])


def test_travel_costs_are_lengths_and_paper_costs_probabilities():
    ends = {'a': at(3, 3)}
    made = scene(ends)
    cells = np.array([made.cell_of(place(3, 13))])
    assert made.cost_to('a', cells)[0] == pytest.approx(5.0, abs=0.3)
    paper = scene(ends, settings=config(strategy='paper'))
    assert paper.cost_to('a', cells)[0] == pytest.approx(0.03 * 5.0, rel=1e-3)


def test_a_path_leads_straight_where_nothing_is_in_the_way():
    made = scene({'a': at(3, 3)})
    goal = made.cell_of(place(4, 16))
    path = made.path('a', goal)
    assert path.shape == (2, 2)
    assert path[0].tolist() == list(place(3, 3))
    np.testing.assert_allclose(path[1], made.grid.to_point([goal])[0])


def test_a_path_from_a_blocked_cell_begins_at_the_vehicle_and_goes_over_the_nearest_free_one():
    beside = VehicleSnapshot(Pose2(0.55, place(3, 3)[1], 0.0))
    made = scene({'a': beside})
    path = made.path('a', made.cell_of(place(3, 10)))
    assert path[0].tolist() == [0.55, beside.pose.y]
    np.testing.assert_allclose(path[1], made.grid.to_point([made.starts['a']])[0])


def test_paths_bypass_vehicles_that_stand():
    made = scene({'a': at(3, 3), 'b': at(3, 9)})
    goal = made.cell_of(place(3, 16))
    straight = made.path('a', goal)
    around = made.path('a', goal, ['b'])
    np.testing.assert_array_equal(made.path('a', goal), straight)

    assert gap(straight, place(3, 9)) < 0.1
    assert gap(around, place(3, 9)) > 0.55


@pytest.mark.parametrize(
    ('points', 'free'),
    [
        ([(3, 3), (3, 15)], True),
        ([(3, 3), (3, 20)], False),
        ([(3, 3), (-3, 3)], False),
        ([(1, 1), (3, 3)], True),  # begins beside the wall
        ([(3, 3), (3, 6), (3, 12), (0, 12), (3, 12)], False),  # into the wall and back
    ],
)
def test_whether_a_path_is_still_free(points, free):
    made = scene({'a': at(3, 3)})
    assert made.is_passable('a', np.array([place(*p) for p in points])) is free


def test_a_path_that_begins_in_a_zone_is_free_up_to_the_escape_distance():
    spot = place(3, 6)
    path = np.array([spot, place(3, 15)])
    assert scene({'a': at(3, 3)}, keep_out=[spot]).is_passable('a', path)
    near = config(escape_distance=0.1)
    assert not scene({'a': at(3, 3)}, keep_out=[spot], settings=near).is_passable('a', path)
    behind = np.array([place(3, 3), place(3, 15)])
    assert not scene({'a': at(3, 3)}, keep_out=[spot]).is_passable('a', behind)


def traveler(name, *cells):
    points = np.array([place(*cell) for cell in cells])
    return Traveler(name, points[0], points if len(points) > 1 else None)


def test_a_retreat_leads_off_the_path_of_the_other():
    wide = HALL.replace('#..................#', '\n'.join(['#..................#'] * 2))
    position = place(5, 10, wide)
    made = scene({'a': at(5, 10, wide), 'b': at(5, 3, wide)}, wide)

    def moving(name, *cells):
        points = np.array([place(*cell, wide) for cell in cells])
        return Traveler(name, points[0], points)

    along = moving('b', (5, 3), (5, 17))
    path, cost = made.retreat(moving('a', (5, 10)), [along])
    away = abs(path[-1][1] - position[1])
    assert path[0].tolist() == list(position)
    assert 1.2 < away < 1.6
    assert cost == pytest.approx(away, abs=0.2)
    walls = [moving('c', (row, 3), (row, 17)) for row in (2, 8)]
    farther, cost = made.retreat(moving('a', (5, 10)), [along, *walls])
    assert farther is None
    assert math.isinf(cost)


def test_a_vehicle_that_is_not_on_the_map_has_no_retreat():
    made = scene({'a': at(3, 10)})
    assert made.retreat(traveler('x', (3, 10)), [traveler('a', (3, 10))])[0] is None
