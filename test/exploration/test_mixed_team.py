"""Vehicles of different size and speed in one team, and vehicles with a goal of the operator."""

import math

import numpy as np
import pytest
from exploration_maps import grid_of, point_of

from explore_slam.data import VehicleBody
from explore_slam.exploration import (
    ExplorationConfig,
    ExplorationStatus,
    Planner,
    PlanningMode,
    VehicleSnapshot,
)
from explore_slam.exploration.traffic import RightOfWay, Traffic, Traveler
from explore_slam.geometry import Pose2
from explore_slam.polyline import remaining_path, sample, truncated
from explore_slam.settings import with_values

# one letter is 0.8 m: a door for a body of 0.25 m (paths keep 0.3 m clear), not for one of 0.45 m
SCALE = {'resolution': 0.1, 'cells_per_letter': 8}
ROOMS = """
?????????????????
##...############
#......#........#
#......#........?
#...............?
#......#........?
#......#........#
#################
"""
BEYOND = ROOMS.replace('##...##', '#######')  # only the far room has a frontier
DOOR = 7  # letters from the left
NARROW, WIDE = VehicleBody(0.25), VehicleBody(0.45)
CONFIG = ExplorationConfig()


def place(row, col, text=ROOMS):
    return point_of(row, col, text, **SCALE)


DOOR_X = place(4, DOOR)[0]


def at(row, col, body, goal=None):
    pose = Pose2(*place(row, col), 0.0)
    aim = None if goal is None else Pose2(*place(*goal), 1.0)
    return VehicleSnapshot(pose, True, None, body, aim)


def explore(vehicles, text, cycles=60):
    """Drive as planned on a map that does not change; return the largest x of each plan."""
    planner, grid = Planner(CONFIG), grid_of(text, **SCALE)
    farthest = dict.fromkeys(vehicles, -math.inf)
    for cycle in range(cycles):
        result = planner.plan(grid, float(cycle), vehicles)
        for name, plan in result.plans.items():
            farthest[name] = max(farthest[name], plan.waypoints[:, 0].max())
            here = np.array(vehicles[name].pose[:2])
            ahead = truncated(remaining_path(here, plan.waypoints), vehicles[name].body.speed)
            pose = Pose2(float(ahead[-1, 0]), float(ahead[-1, 1]), 0.0)
            vehicles[name] = vehicles[name]._replace(pose=pose)
    return farthest, result


@pytest.mark.parametrize('names', [('a', 'b'), ('b', 'a')])
@pytest.mark.parametrize('text', [ROOMS, BEYOND])
def test_only_the_narrow_vehicle_is_sent_through_a_door(text, names):
    wide, narrow = names
    farthest, _ = explore({wide: at(5, 5, WIDE), narrow: at(3, 3, NARROW)}, text)
    assert farthest[narrow] > DOOR_X + 1.0
    assert farthest[wide] < DOOR_X - 0.4


def test_a_wide_vehicle_alone_gets_no_target_behind_a_door():
    farthest, result = explore({'a': at(5, 5, WIDE)}, BEYOND, cycles=5)
    assert farthest['a'] < DOOR_X - 0.4  # it looks whether the way is really blocked
    assert result.status is not ExplorationStatus.COMPLETE
    farthest, _ = explore({'a': at(5, 5, NARROW)}, BEYOND, cycles=5)
    assert farthest['a'] > DOOR_X


def test_the_trail_of_a_narrow_vehicle_is_no_way_for_a_wide_one():
    planner, grid = Planner(CONFIG), grid_of(BEYOND, **SCALE)
    for cycle, col in enumerate(np.arange(3.0, 12.0, 0.05)):  # through the door
        vehicles = {'a': at(5, 5, WIDE), 'b': at(4, col, NARROW)}
        result = planner.plan(grid, 0.1 * cycle, vehicles, PlanningMode.EXPLORE)
        assert 'a' not in result.plans or result.plans['a'].waypoints[:, 0].max() < DOOR_X


def clearance(points, text):
    grid = grid_of(text, **SCALE)
    walls = grid.to_point(np.argwhere(grid.known() & (grid.probability() > 0.5)))
    path = sample(points, 0.05)
    return np.hypot(*(path[:, None] - walls[None]).transpose(2, 0, 1)).min()


@pytest.mark.parametrize('radius', [0.15, 0.25, 0.35, 0.6])
def test_paths_keep_the_same_clearance_beside_every_body(radius):
    vehicles = {'a': at(5, 2, VehicleBody(radius))}
    result = Planner(CONFIG).plan(grid_of(ROOMS, **SCALE), 0.0, vehicles)
    kept = CONFIG.paths.planning_radius - 0.25
    assert clearance(result.plans['a'].waypoints, ROOMS) >= radius + kept - 0.05  # half a cell


def test_a_body_beyond_all_bounds_leads_to_no_error():
    vehicles = {'a': at(5, 2, VehicleBody(2.0))}
    huge = with_values(CONFIG, {'planning_radius': 5.0})
    assert Planner(huge).plan(grid_of(ROOMS, **SCALE), 0.0, vehicles).plans == {}


def test_a_goal_behind_a_door_is_refused_to_the_wide_one_only():
    grid = grid_of(ROOMS, **SCALE)
    goal = (4, 12)
    refused = Planner(CONFIG).plan(grid, 0.0, {'a': at(5, 5, WIDE, goal)})
    assert refused.refused == ('a',)
    assert 'a' not in refused.plans
    sent = Planner(CONFIG).plan(grid, 0.0, {'a': at(5, 5, NARROW, goal)})
    assert sent.refused == ()
    plan = sent.plans['a']
    assert math.dist(plan.goal[:2], place(*goal)) < 0.15
    assert plan.goal.theta == pytest.approx(1.0, abs=0.01)  # as the operator wants it


def test_others_explore_while_one_drives_to_its_goal():
    grid = grid_of(ROOMS, **SCALE)
    vehicles = {'a': at(5, 2, NARROW, (4, 12)), 'b': at(3, 3, NARROW)}
    result = Planner(CONFIG).plan(grid, 0.0, vehicles)
    assert math.dist(result.plans['a'].goal[:2], place(4, 12)) < 0.15
    assert result.vehicles == ('b',)
    assert result.plans['b'].waypoints[-1][1] > place(2, 3)[1]


# -- right of way ---------------------------------------------------------------------------------


class Aside:
    """Everybody may step aside, at a cost (m) by name."""

    def __init__(self, **costs):
        self.costs = costs

    def retreat(self, one, _others):
        cost = self.costs.get(one.name, math.inf)
        if math.isinf(cost):
            return None, cost
        return np.array([one.position, one.position + [0.0, cost]]), cost


def traveler(name, *points, urgent=False, body=NARROW):
    path = np.array(points, float)
    return Traveler(name, path[0], path, body, urgent)


def grants(*travelers, terrain=None):
    traffic = Traffic(CONFIG.traffic)
    return traffic.grant({one.name: one for one in travelers}, terrain or Aside())


@pytest.mark.parametrize('urgent', ['a', 'b'])
def test_a_vehicle_that_drives_to_a_goal_has_right_of_way_at_a_crossing(urgent):
    found = grants(
        traveler('a', (0, 0), (9, 0), urgent=urgent == 'a'),
        traveler('b', (4.5, -4.5), (4.5, 4.5), urgent=urgent == 'b'),
    )
    other = {'a': 'b', 'b': 'a'}[urgent]
    assert found[urgent].right is RightOfWay.GO
    assert found[other].right is RightOfWay.STOP
    assert found[other].yields_to == urgent


def test_who_explores_retreats_though_it_has_the_longer_way_unless_it_cannot():
    one = traveler('a', (0, 0), (9, 0))
    other = traveler('b', (2, 0), (-9, 0), urgent=True)
    found = grants(one, other, terrain=Aside(a=8.0, b=1.0))
    assert found['a'].right is RightOfWay.RETREAT
    assert found['b'].right is not RightOfWay.RETREAT
    usual = grants(one, traveler('b', (2, 0), (-9, 0)), terrain=Aside(a=8.0, b=1.0))
    cornered = grants(one, other, terrain=Aside(b=1.0))
    for found in (usual, cornered):
        assert found['a'].right is not RightOfWay.RETREAT
        assert found['b'].right is RightOfWay.RETREAT


def test_an_exploring_vehicle_gives_way_on_the_map():
    hall = '\n'.join(['?' * 30, *['#' + '.' * 28 + '#'] * 20, '#' * 30])
    grid = grid_of(hall, resolution=0.25, cells_per_letter=2)

    def vehicle(row, col, goal=None):
        where = point_of(row, col, hall, resolution=0.25, cells_per_letter=2)
        aim = point_of(*goal, hall, resolution=0.25, cells_per_letter=2) if goal else None
        return VehicleSnapshot(Pose2(*where, 0.0), True, None, NARROW, aim and Pose2(*aim, 0.0))

    vehicles = {'a': vehicle(8, 14), 'b': vehicle(4, 4, (4, 25))}
    result = Planner(CONFIG).plan(grid, 0.0, vehicles)
    assert math.dist(result.plans['b'].goal[:2], point_of(4, 25, hall, 0.25, 2)) < 0.3
    crossing = remaining_path(np.array(vehicles['a'].pose[:2]), result.plans['a'].waypoints)
    assert crossing[:, 1].max() < vehicles['b'].pose.y - 0.5 or result.waiting.get('a')


def test_larger_bodies_keep_farther_apart():
    settings = CONFIG.traffic
    near = [
        traveler('a', (0, 0), (9, 0), body=body)
        for body in (VehicleBody(0.15), NARROW, VehicleBody(0.5))
    ]
    other = traveler('b', (4.5, -4.5), (4.5, 4.5))
    traffic = Traffic(settings)
    distances = [traffic.threshold(one, other) for one in near]
    assert distances == pytest.approx(
        [settings.vehicle_separation - 0.1, settings.vehicle_separation,
         settings.vehicle_separation + 0.25]
    )  # fmt: skip


def test_a_slow_vehicle_is_expected_to_come_later():
    first = traveler('a', (0, 0), (9, 0))
    quick = traveler('b', (4.5, -4.5), (4.5, 4.5), body=VehicleBody(0.25, 0.4))
    slow = traveler('b', (4.5, -4.5), (4.5, 4.5), body=VehicleBody(0.25, 0.1))
    assert grants(first, quick)['b'].right is RightOfWay.STOP
    assert grants(first, slow)['b'].right is RightOfWay.GO
