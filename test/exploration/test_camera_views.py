"""Areas that a laser has seen but no depth camera: which ones, by whom, and when that ends."""

import math

import numpy as np
import pytest
from exploration_maps import grid_of, point_of

from explore_slam.exploration import (
    ExplorationConfig,
    ExplorationStatus,
    Planner,
    VehicleSnapshot,
)
from explore_slam.exploration.camera_views import find_unviewed
from explore_slam.exploration.clearance import make_cost_map
from explore_slam.geometry import Pose2
from explore_slam.settings import with_values

# two rooms of 5 x 4 m; one letter is 0.5 m
ROOMS = """
######################
#..........#.........#
#..........#.........#
#..........#.........#
#....................#
#....................#
#..........#.........#
#..........#.........#
#..........#.........#
######################
"""
SIDE = 2  # cells of 0.25 m per letter


def rooms():
    return grid_of(ROOMS, cells_per_letter=SIDE)


def config(**values):
    return with_values(ExplorationConfig(), {'planning_radius': 0.3, **values})


def at(row, col, theta=0.0, *, has_camera=True):
    x, y = point_of(row, col, ROOMS, cells_per_letter=SIDE)
    return VehicleSnapshot(Pose2(x, y, theta), True, has_camera=has_camera)


def left_room(grid, up_to=5.5):
    """Return the cells of a grid whose centre lies left of a coordinate (m)."""
    cells = np.argwhere(np.ones(grid.shape, np.bool_))
    return (grid.to_point(cells)[:, 0] < up_to).reshape(grid.shape)


def found(grid, looked_at, **values):
    settings = config(**values)
    costs = make_cost_map(grid, settings.paths)
    reach = np.isfinite(costs.cost)
    return costs, find_unviewed(grid, costs, looked_at, reach, settings.frontiers)


def test_what_no_camera_has_looked_at_is_visited_in_pieces_with_their_middle_in_reach():
    grid = rooms()
    looked_at = left_room(grid)
    costs, areas = found(grid, looked_at)
    whole = np.count_nonzero(costs.free & ~looked_at) * grid.resolution**2
    assert 0.9 * whole <= sum(area.gain for area in areas) <= whole
    for area in areas:
        sides = np.ptp(area.cells, axis=0) * grid.resolution
        assert sides.max() < 3.2  # the room is 5 m long and 4 m wide
        assert np.isfinite(costs.cost[area.target_cell])
        assert not looked_at[area.target_cell]
        assert math.dist(area.target, area.look_at) < 0.5


def test_strips_and_small_areas_are_left_out():
    grid = rooms()
    everything = np.ones(grid.shape, np.bool_)
    strip = everything & ~(left_room(grid, 6.25) & ~left_room(grid, 6.0))  # 0.25 m wide
    assert not found(grid, strip)[1]
    small = everything.copy()
    small[6:10, 30:35] = False  # 1.0 x 1.25 m
    assert not found(grid, small)[1]
    assert len(found(grid, small, min_unviewed_area=1.0)[1]) == 1


def explore(vehicles, looked_at, turns=400, **values):
    """Plan with vehicles that jump to their goals; return statuses and who had plans."""
    planner, grid = Planner(config(return_to_init=False, **values)), rooms()
    sent = set()
    for turn in range(turns):
        result = planner.plan(grid, float(turn), vehicles, looked_at=lambda: looked_at(grid))
        if result.status.explored:
            return turn, result.status, sent
        for name, plan in result.plans.items():
            sent.add(name)
            vehicles[name] = vehicles[name]._replace(pose=plan.goal)
    return turns, result.status, sent


def test_exploration_ends_once_cameras_have_looked_everywhere():
    """A camera looks at all within 2 m of where its vehicle was."""
    seen = left_room(rooms())
    vehicles = {'robot1': at(2, 2), 'robot2': at(7, 2, has_camera=False)}

    def looked_at(grid):
        cells = np.argwhere(np.ones(grid.shape, np.bool_))
        near = np.hypot(*(grid.to_point(cells) - vehicles['robot1'].pose[:2]).T) < 2.0
        seen[near.reshape(seen.shape)] = True
        return seen

    turn, status, sent = explore(vehicles, looked_at)
    assert status is ExplorationStatus.COMPLETE
    assert sent == {'robot1'}  # the other one has no camera
    assert turn > 3
    assert not found(rooms(), seen)[1]


@pytest.mark.parametrize(
    ('cameras', 'values'),
    [(False, {}), (True, {'min_unviewed_area': 0.0})],
    ids=['no camera', 'not asked for'],
)
def test_without_cameras_or_when_not_asked_for_nothing_is_looked_at(cameras, values):
    vehicles = {'robot1': at(2, 2, has_camera=cameras)}
    turn, status, sent = explore(vehicles, left_room, **values)
    assert status is ExplorationStatus.COMPLETE
    assert not sent
    assert turn < 5


def test_a_camera_that_shows_nothing_does_not_keep_exploration_from_ending():
    """The areas are given up after some attempts."""
    vehicles = {'robot1': at(2, 2)}
    _, status, sent = explore(vehicles, left_room)
    assert status is ExplorationStatus.COMPLETE
    assert sent == {'robot1'}


def test_what_vehicles_with_a_camera_have_given_up_is_not_kept_open_by_one_without():
    grid = rooms()
    seen = np.ones(grid.shape, np.bool_)
    seen[4:12, 32:42] = False
    planner = Planner(config(return_to_init=False, maximum_attempts=1))
    vehicles = {'robot1': at(5, 13), 'robot2': at(7, 2, has_camera=False)}
    blocked = 0
    for turn in range(100):
        result = planner.plan(grid, 0.1 * turn, vehicles, looked_at=lambda: seen)
        if result.status.explored:
            break
        for name, plan in result.plans.items():  # each is blocked where it stands
            short_of = plan.goal.compose(Pose2(-1.5, 0.0, 0.0))  # where it faces the area
            vehicles[name] = vehicles[name]._replace(pose=short_of)
            planner.report_blocked(name, plan.goal, 0.1 * turn)
            blocked += 1
    assert result.status.explored
    assert blocked
