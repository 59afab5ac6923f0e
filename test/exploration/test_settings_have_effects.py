"""Every setting of paths, frontiers and traffic changes what comes out."""

import math

import numpy as np
import pytest
from exploration_maps import grid_of, point_of

from explore_slam.exploration import (
    ExplorationConfig,
    Planner,
    PlanningMode,
    VehicleSnapshot,
    find_frontiers,
    make_cost_map,
)
from explore_slam.exploration.scene import Scene
from explore_slam.exploration.traffic import Traffic, Traveler
from explore_slam.geometry import Pose2
from explore_slam.settings import with_values

HALL = """
????????????????????????
########...########....?
#......................?
#......................?
#.....#................#
#......................#
########################
"""
LETTER = 4


def config(**values):
    return with_values(ExplorationConfig(), values)


def hall():
    return grid_of(HALL, resolution=0.125, cells_per_letter=LETTER)


def place(row, col):
    return point_of(row, col, HALL, resolution=0.125, cells_per_letter=LETTER)


def vehicles(*columns):
    return {f'r{c}': VehicleSnapshot(Pose2(*place(3, c), 0.0)) for c in columns}


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('planning_radius', 0.5), ('minimum_planning_radius', 0.1), ('occ_max', 0.99),
        ('cost_floor', 0.1), ('clearance_distance', 0.0), ('clearance_weight', 0.0),
    ],
)  # fmt: skip
def test_cost_maps(name, value):
    plain = make_cost_map(hall(), config().paths)
    other = make_cost_map(hall(), config(**{name: value}).paths)
    if name == 'cost_floor':  # counts only where cells are less certain than that
        grid = hall()
        probability = np.where(grid.probability() > 0.5, 0.97, 0.3)
        unsure = type(grid).from_probability(probability, grid.known(), config=grid.config)
        plain = make_cost_map(unsure, config().paths)
        other = make_cost_map(unsure, config(cost_floor=0.1).paths)
    same = np.array_equal(plain.cost, other.cost)
    assert not (same and np.array_equal(plain.tight_cost, other.tight_cost))


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('min_frontier_size', 3.0), ('max_frontier_size', 0.6), ('min_frontier_gain', 50.0),
        ('sensor_range', 2.0),
    ],
)  # fmt: skip
def test_frontiers(name, value):
    def found(settings):
        return [(f.target, f.size, f.gain) for f in find_frontiers(hall(), settings)]

    assert found(config()) != found(config(**{name: value}))


def test_escape_distance():
    stuck = {'a': VehicleSnapshot(Pose2(0.3, place(3, 1)[1], 0.0))}
    assert Scene(hall(), 0.0, config(), stuck).starts
    assert not Scene(hall(), 0.0, config(escape_distance=0.1), stuck).starts


def test_arrival_distance_decides_who_is_home():
    x, y = place(3, 5)
    away = {'a': VehicleSnapshot(Pose2(x + 0.5, y, 0.0), True, Pose2(x, y, 0.0))}
    near, wide = Planner(config()), Planner(config(arrival_distance=0.6))
    assert near.plan(hall(), 0.0, away, PlanningMode.RETURN_HOME).plans
    assert not wide.plan(hall(), 0.0, away, PlanningMode.RETURN_HOME).plans


def test_route_resolution_changes_the_blocks():
    fine = Scene(hall(), 0.0, config(route_resolution=0.125), vehicles(3)).routes()
    coarse = Scene(hall(), 0.0, config(), vehicles(3)).routes()
    assert fine.block < coarse.block


def straight(name, y, x0, x1):
    path = np.array([[x0, y], [x1, y]])
    return Traveler(name, path[0], path)


class NoWayOut:
    def retreat(self, _one, _winners):
        return None, math.inf


def rights(settings, *travelers):
    grants = Traffic(settings.traffic).grant({t.name: t for t in travelers}, NoWayOut())
    return [(g.right, g.limit) for g in grants.values()]


@pytest.mark.parametrize(
    ('name', 'value', 'gap', 'lead'),
    [
        ('vehicle_separation', 0.3, 0.6, 0.0),
        ('traffic_horizon', 3.0, 0.2, 0.0),
        ('traffic_margin', 0.0, 0.2, 2.2),
        ('nominal_speed', 0.05, 0.2, 0.0),
    ],
)
def test_traffic(name, value, gap, lead):
    crossing = np.array([[4.0 + lead, -4.0], [4.0 + lead, 4.0]])
    pairs = {
        True: (straight('a', 0.0, 0.0, 9.0), straight('b', gap, 9.0, 0.0)),
        False: (straight('a', 0.0, 0.0, 9.0), Traveler('b', crossing[0], crossing)),
    }
    pair = pairs[lead == 0.0]
    assert rights(config(), *pair) != rights(config(**{name: value}), *pair)
