"""Vehicles whose battery is low drive home, those whose battery is critical stop; others go on."""

import math

import numpy as np
import pytest
from exploration_maps import grid_of, point_of

from explore_slam.data import BatteryLevel
from explore_slam.exploration import (
    ExplorationConfig,
    ExplorationStatus,
    Planner,
    PlanningMode,
    VehicleSnapshot,
)
from explore_slam.geometry import Pose2
from explore_slam.polyline import remaining_path, truncated
from explore_slam.settings import with_values

OK, LOW, CRITICAL = BatteryLevel
SCALE = {'resolution': 0.1, 'cells_per_letter': 8}  # one letter is 0.8 m
# one frontier, on the right
CORRIDOR = """
################?
#...............?
#...............?
################?
"""
HALL = """
#################????
#...............#????
#...............#????
#................????
#...............#????
#...............#????
#################????
"""
DOOR = """
#################????
#.......#.......#????
#.......#.......#????
#................????
#.......#.......#????
#.......#.......#????
#################????
"""
LANE = """
################?
#...............?
################?
"""
CLOSED = CORRIDOR.replace('?', '#')
CONFIG = with_values(ExplorationConfig(), {'empty_searches': 1})
HOME = (1, 1)


def at(row, col, battery=OK, *, text=CORRIDOR, home=HOME, **values):
    place = Pose2(*point_of(row, col, text, **SCALE), 0.0)
    start = Pose2(*point_of(*home, text, **SCALE), 0.0)
    return VehicleSnapshot(place, home=start, battery=battery, **values)


def plan(vehicles, text=CORRIDOR, *, planner=None, now=0.0, mode=PlanningMode.EXPLORE):
    planner = planner or Planner(CONFIG)
    return planner.plan(grid_of(text, **SCALE), now, vehicles, mode)


def drive(planner, vehicles, text, cycles, until):
    """Drive as planned for at most some cycles of 1 s, until a result meets the condition."""
    for cycle in range(cycles):
        result = plan(vehicles, text, planner=planner, now=float(cycle))
        if until(result):
            return result
        for name, order in result.plans.items():
            ahead = remaining_path(np.array(vehicles[name].pose[:2]), order.waypoints)
            x, y = truncated(ahead, 0.4)[-1].tolist()
            vehicles[name] = vehicles[name]._replace(pose=Pose2(x, y, 0.0))
    raise AssertionError(f'not within {cycles} cycles: {result.status}, {result.reason}')


def test_a_low_battery_hands_the_target_over_and_sends_the_vehicle_home():
    planner = Planner(CONFIG)
    vehicles = {'a': at(2, 10, text=HALL), 'b': at(4, 4, text=HALL)}
    first = plan(vehicles, HALL, planner=planner)
    target = first.plans['a'].goal
    assert 'b' not in first.plans  # one frontier, for the nearer one
    vehicles['a'] = vehicles['a']._replace(battery=LOW)
    second = plan(vehicles, HALL, planner=planner, now=1.0)
    assert second.vehicles == ('b',)
    assert math.dist(second.plans['b'].goal[:2], target[:2]) < 0.5
    assert math.dist(second.plans['a'].goal[:2], vehicles['a'].home[:2]) < 0.15
    vehicles['a'] = vehicles['a']._replace(battery=OK)  # charged
    third = plan(vehicles, HALL, planner=planner, now=2.0)
    assert third.vehicles == ('a', 'b')


def test_at_home_it_stays_and_takes_no_target_however_near():
    near = at(1, 14, LOW, text=HALL, home=(1, 14))
    result = plan({'a': near, 'b': at(4, 1, text=HALL)}, HALL)
    assert result.plans.keys() == {'b'}
    assert result.waiting['a'] == 'home: battery low'


def test_the_operator_may_send_it_elsewhere():
    goal = Pose2(*point_of(2, 12, CORRIDOR, **SCALE), 0.0)
    result = plan({'a': at(1, 8, LOW, goal=goal), 'b': at(2, 3)})
    assert math.dist(result.plans['a'].goal[:2], goal[:2]) < 0.15


def test_a_home_that_is_out_of_reach_is_said_so():
    text = CORRIDOR.replace('#...............?', '#....#..........?')
    result = plan({'a': at(1, 9, LOW), 'b': at(2, 10)}, text)
    assert result.waiting['a'] == 'battery low, and its home cannot be reached'
    assert result.plans.keys() == {'b'}


def test_a_critical_battery_stops_the_vehicle_which_is_an_obstacle_to_the_others():
    vehicles = {'a': at(1, 8, CRITICAL, text=LANE), 'b': at(1, 3, text=LANE)}
    result = plan(vehicles, LANE)
    assert result.waiting['a'] == 'has stopped: its battery is nearly empty'
    assert 'a' not in result.plans
    assert all(order.waypoints[-1, 0] < vehicles['a'].pose.x for order in result.plans.values())


@pytest.mark.parametrize(('low', 'other'), [('a', 'b'), ('b', 'a')])
def test_a_vehicle_that_must_go_home_goes_through_a_door_first(low, other):
    vehicles = {low: at(3, 12, LOW, text=DOOR, home=(3, 1)), other: at(3, 4, text=DOOR)}
    result = plan(vehicles, DOOR)
    door = point_of(3, 8, DOOR, **SCALE)[0]
    assert result.plans[low].waypoints[-1, 0] < door - 1.0
    assert other not in result.plans or result.plans[other].waypoints[-1, 0] < door


@pytest.mark.parametrize(
    ('text', 'status', 'left'),
    [
        (CORRIDOR, ExplorationStatus.INCOMPLETE, 1),
        (CLOSED, ExplorationStatus.COMPLETE, 0),
    ],
)
def test_a_team_without_battery_ends_at_home_with_what_is_left(text, status, left):
    planner = Planner(CONFIG)
    vehicles = {'a': at(1, 9, LOW), 'b': at(2, 7, LOW, home=(2, 3))}
    first = plan(vehicles, text, planner=planner)
    assert first.status is ExplorationStatus.IN_PROGRESS
    assert first.reason == 'a, b on the way home: battery low'
    last = drive(planner, vehicles, text, 60, lambda result: result.status.explored)
    assert last.status is status
    assert (last.unreachable, last.unreached_m2 > 0.0) == (left, left > 0)
    for one in vehicles.values():
        assert math.dist(one.pose[:2], one.home[:2]) <= CONFIG.paths.arrival_distance


def test_the_end_waits_for_a_vehicle_on_its_way_home():
    planner = Planner(CONFIG)
    vehicles = {'a': at(1, 12, LOW), 'b': at(2, 5)}
    assert plan(vehicles, CLOSED, planner=planner).status is ExplorationStatus.IN_PROGRESS
    drive(planner, vehicles, CLOSED, 60, lambda result: result.status.explored)
    assert math.dist(vehicles['a'].pose[:2], vehicles['a'].home[:2]) <= 0.3


def test_with_return_to_init_it_ends_as_returned():
    planner = Planner(with_values(CONFIG, {'return_to_init': True}))
    vehicles = {'a': at(1, 9, LOW)}
    assert plan(vehicles, planner=planner).status is ExplorationStatus.RETURNING
    returned = drive(
        planner, vehicles, CORRIDOR, 60, lambda r: r.status is ExplorationStatus.RETURNED
    )
    assert returned.unreachable == 1


def test_a_team_that_has_stopped_ends_at_once():
    for mode in (PlanningMode.EXPLORE, PlanningMode.RETURN_HOME):
        result = plan({'a': at(1, 9, CRITICAL), 'b': at(2, 5, CRITICAL)}, mode=mode)
        assert result.status is ExplorationStatus.INCOMPLETE
        assert result.plans == {}
        assert 'no vehicle with enough battery' in result.reason
        assert result.waiting.keys() == {'a', 'b'}


def test_a_vehicle_that_may_come_back_keeps_the_run_open():
    result = plan({'a': at(1, 1, LOW), 'b': at(2, 5, active=False)})
    assert result.status is ExplorationStatus.IN_PROGRESS
    assert result.reason == 'no vehicle can explore now; b may later'


def test_frontiers_that_only_a_low_vehicle_can_reach_are_out_of_reach():
    text = CORRIDOR.replace('#...............?', '#....#..........?')
    vehicles = {'a': at(1, 9, LOW, home=(1, 9)), 'b': at(2, 2, home=(2, 2))}
    result = drive(Planner(CONFIG), vehicles, text, 400, lambda result: result.status.explored)
    assert result.status is ExplorationStatus.INCOMPLETE
    assert result.unreachable == 1
    assert 'a' not in result.plans
