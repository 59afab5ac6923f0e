"""Right of way on known maps: vehicles drive as planned, home is where the other one is."""

import itertools
import math

import numpy as np
import pytest
from exploration_maps import grid_of, point_of

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

SPEED, STEP = 0.4, 0.5
CELLS = 2  # of 0.25 m per letter: a corridor one letter wide is 0.5 m wide

CORRIDOR = """
########################
#......##########......#
#......##########......#
#......................#
#......##########......#
#......##########......#
########################
"""
NICHE = """
##################################
#...########################....##
#...########..##############....##
#...............................##
#...########################....##
##################################
"""
DEAD_END = """
#########################
#....####################
#....####################
#.......................#
#....####################
#....####################
#########################
"""


def drive(text, starts, homes, limit=400.0, radius=0.2):
    """Let vehicles follow their plans; return seconds until all are home, and the least gap."""
    grid = grid_of(text, cells_per_letter=CELLS)
    config = with_values(
        ExplorationConfig(),
        {'planning_radius': radius, 'minimum_planning_radius': 0.1, 'vehicle_separation': 0.6,
         'clearance_distance': 0.1},
    )  # fmt: skip
    planner = Planner(config)
    poses = {
        name: Pose2(*point_of(*cell, text, cells_per_letter=CELLS), 0.0)
        for name, cell in starts.items()
    }
    targets = {
        name: Pose2(*point_of(*cell, text, cells_per_letter=CELLS), 0.0)
        for name, cell in homes.items()
    }
    least, time = math.inf, 0.0
    while time < limit:
        vehicles = {n: VehicleSnapshot(p, True, targets[n]) for n, p in poses.items()}
        result = planner.plan(grid, time, vehicles, PlanningMode.RETURN_HOME)
        if result.status is ExplorationStatus.RETURNED:
            break
        for name, plan in result.plans.items():
            place = np.array(poses[name][:2])
            ahead = truncated(remaining_path(place, plan.waypoints), SPEED * STEP)
            poses[name] = Pose2(float(ahead[-1, 0]), float(ahead[-1, 1]), 0.0)
        for one, other in itertools.combinations(poses.values(), 2):
            least = min(least, math.dist(one[:2], other[:2]))
        time += STEP
    return time, least, result


def test_two_vehicles_swap_sides_through_a_corridor():
    time, least, result = drive(CORRIDOR, {'a': (3, 2), 'b': (3, 21)}, {'a': (3, 21), 'b': (3, 2)})
    assert result.status is ExplorationStatus.RETURNED
    assert time < 150.0
    assert least >= 0.4


def test_a_deadlock_in_a_corridor_resolves_at_a_niche():
    time, least, result = drive(NICHE, {'a': (3, 9), 'b': (3, 20)}, {'a': (3, 29), 'b': (3, 2)})
    assert result.status is ExplorationStatus.RETURNED
    assert time < 250.0
    assert least >= 0.4


def test_the_vehicle_in_a_dead_end_comes_out_first():
    time, least, result = drive(DEAD_END, {'a': (3, 7), 'b': (3, 20)}, {'a': (3, 23), 'b': (1, 1)})
    assert result.status is ExplorationStatus.RETURNED
    assert time < 200.0
    assert least >= 0.4


def test_an_idle_vehicle_makes_way_and_goes_back():
    time, least, result = drive(NICHE, {'a': (3, 2), 'b': (3, 20)}, {'a': (3, 29), 'b': (3, 20)})
    assert result.status is ExplorationStatus.RETURNED
    assert time < 250.0
    assert least >= 0.4


def test_four_vehicles_through_one_corridor():
    starts = {'a': (2, 2), 'b': (4, 2), 'c': (2, 20), 'd': (4, 20)}
    homes = {'a': (2, 20), 'b': (4, 20), 'c': (2, 2), 'd': (4, 2)}
    _time, least, result = drive(CORRIDOR, starts, homes)
    assert result.status is ExplorationStatus.RETURNED
    assert least >= 0.4


def test_vehicles_that_cross_in_the_open_keep_apart():
    hall = '\n'.join(['#' * 30, *['#' + '.' * 28 + '#'] * 20, '#' * 30])
    time, least, result = drive(hall, {'a': (10, 2), 'b': (2, 14)}, {'a': (10, 27), 'b': (19, 14)})
    assert result.status is ExplorationStatus.RETURNED
    assert time < 80.0
    assert least >= 0.55


@pytest.mark.parametrize('active', [True, False])
def test_no_plan_leads_through_the_body_of_a_standing_vehicle(active):
    grid = grid_of(CORRIDOR, cells_per_letter=CELLS)
    config = with_values(ExplorationConfig(), {'planning_radius': 0.2})
    poses = {n: point_of(*cell, CORRIDOR, cells_per_letter=CELLS)
             for n, cell in {'a': (3, 2), 'b': (3, 12), 'home': (3, 21)}.items()}  # fmt: skip
    vehicles = {
        'a': VehicleSnapshot(Pose2(*poses['a'], 0.0), True, Pose2(*poses['home'], 0.0)),
        'b': VehicleSnapshot(Pose2(*poses['b'], 0.0), active, Pose2(*poses['b'], 0.0)),
    }
    result = Planner(config).plan(grid, 0.0, vehicles, PlanningMode.RETURN_HOME)
    if 'a' in result.plans:
        at = np.concatenate([
            np.linspace(p, q, 50) for p, q in itertools.pairwise(result.plans['a'].waypoints)
        ])  # fmt: skip
        assert np.hypot(*(at - poses['b']).T).min() >= 0.4
    assert ('b' in result.plans) is active
