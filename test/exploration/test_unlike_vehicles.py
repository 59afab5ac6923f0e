"""Radius, speed, sensor range and field of view of each vehicle enter who goes where."""

import math

import numpy as np
import pytest
from exploration_maps import grid_of, point_of

from explore_slam.data import VehicleBody
from explore_slam.exploration import (
    ExplorationConfig,
    Frontier,
    Planner,
    VehicleSnapshot,
    assign_jointly,
    assign_targets,
)
from explore_slam.exploration.scene import Scene
from explore_slam.exploration.sections import AssignmentConfig
from explore_slam.exploration.strategies.default import DefaultStrategy
from explore_slam.exploration.strategies.paper import PaperStrategy
from explore_slam.exploration.strategies.strategy import Situation
from explore_slam.exploration.tours import TourProblem, plan_tours
from explore_slam.geometry import Pose2

USUAL = 8.0  # m
SLOW = VehicleBody(speed=0.1)
SHORT_SIGHTED = VehicleBody(sensor_range=0.5)
NARROW_VIEW = VehicleBody(field_of_view=0.1)
LARGE = VehicleBody(radius=0.45)
STANDARD = VehicleBody()
SCALE = {'resolution': 0.1, 'cells_per_letter': 8}  # one letter is 0.8 m


def test_how_far_to_the_side_a_vehicle_sees():
    assert STANDARD.side_range(USUAL) == USUAL
    assert SHORT_SIGHTED.side_range(USUAL) == 0.5
    assert VehicleBody(field_of_view=math.pi / 3).side_range(USUAL) == pytest.approx(4.0)
    assert VehicleBody(field_of_view=2.0 * math.pi).side_range(USUAL) == USUAL


class StraightLines:
    """Travel costs are distances on a line, for large vehicles twice as long among targets."""

    def routes(self, vehicle):
        return Lines(2.0 if vehicle == 'large' else 1.0)


class Lines:
    size = 1  # blocks

    def __init__(self, factor):
        self.factor = factor

    @staticmethod
    def blocks(cells):
        return cells

    def values_from(self, block):
        factor = self.factor

        class Distances:
            @staticmethod
            def at(blocks):
                return factor * np.hypot(*(blocks - block).T)

        return Distances()


def frontier(x, y, gain):
    return Frontier(np.zeros((1, 2), np.int64), (x, y), (x, y), (round(y), round(x)), 1.0, gain)


def situation(frontiers, vehicles):
    """vehicles: name -> (x, y, body)."""
    targets = np.array([one.target for one in frontiers])
    places = np.array([(x, y) for x, y, _ in vehicles.values()])
    costs = np.linalg.norm(places[:, None] - targets[None], axis=2)
    count = len(vehicles)
    bodies = tuple(body for _, _, body in vehicles.values())
    return Situation(
        StraightLines(), tuple(vehicles), frontiers, costs, [-1] * count, [0] * count, bodies
    )


def tours_of(frontiers, vehicles, **values):
    strategy = DefaultStrategy(AssignmentConfig(**values), USUAL)
    strategy.assign(situation(frontiers, vehicles))
    return {name: len(tour) for name, tour in strategy._tours.items()}


ROOMS = [frontier(5.0 * x, y, 20.0) for x in range(-4, 5) for y in (-3.0, 3.0)]


@pytest.mark.parametrize('body', [SLOW, SHORT_SIGHTED, NARROW_VIEW])
@pytest.mark.parametrize('name', ['a', 'z'])
def test_a_vehicle_that_explores_more_slowly_gets_less_to_do(body, name):
    alike = tours_of(ROOMS, {name: (-1.0, 0.0, STANDARD), 'm': (1.0, 0.0, STANDARD)})
    assert abs(alike[name] - alike['m']) <= 2
    unlike = tours_of(ROOMS, {name: (-1.0, 0.0, body), 'm': (1.0, 0.0, STANDARD)})
    assert unlike[name] <= alike[name] - 3
    assert unlike['m'] >= alike['m'] + 3


def test_teams_of_one_kind_do_the_same_whatever_kind_that_is():
    places = {'a': (-3.0, 1.0), 'b': (4.0, -1.0)}
    results = []
    for body in (STANDARD, SLOW, VehicleBody(sensor_range=USUAL)):
        strategy = DefaultStrategy(AssignmentConfig(), USUAL)
        given = situation(ROOMS, {name: (*place, body) for name, place in places.items()})
        results.append(strategy.assign(given))
    assert results[0] == results[1] == results[2]


def test_a_way_round_counts_for_the_large_vehicle_only():
    def problem(large):
        given = situation(ROOMS, {large: (-1.0, 0.0, LARGE), 'b': (1.0, 0.0, STANDARD)})
        strategy = DefaultStrategy(AssignmentConfig(), USUAL)
        return strategy._problem(given, list(range(len(ROOMS))), np.full(len(ROOMS), 20.0))

    between = problem('large').between
    assert between.shape == (2, len(ROOMS), len(ROOMS))
    np.testing.assert_allclose(between[0], 2.0 * between[1])
    unaware = problem('a').between
    np.testing.assert_allclose(unaware[0], unaware[1])


def test_strategy_paper_weighs_the_time_of_each_vehicle_and_what_it_sees():
    targets = [frontier(0.0, 0.0, 5.0), frontier(0.0, 2.0, 5.0), frontier(0.0, 40.0, 5.0)]
    config = AssignmentConfig(travel_weight=0.01, hysteresis=0.0)

    def chosen(first, second):
        vehicles = {'a': (1.0, 0.0, first), 'b': (-1.5, 0.0, second)}
        return PaperStrategy(config, USUAL).assign(situation(targets, vehicles))

    # what is seen from the first target leaves little to see at the second one
    assert chosen(STANDARD, STANDARD) == [0, 2]
    for body in (SHORT_SIGHTED, NARROW_VIEW):
        assert chosen(body, STANDARD) == [0, 1]
    # four times as slow, it is not nearest to the first target in time
    assert chosen(SLOW, STANDARD)[1] == 0


def test_assignments_take_the_ranges_of_the_vehicles():
    targets = np.array([[0.0, 0.0], [3.0, 0.0], [40.0, 0.0]])
    costs = np.array([[1.0, 4.0, 41.0], [2.0, 5.0, 42.0]])
    assert assign_targets(costs, targets, 8.0, 0.01) == [0, 2]
    assert assign_targets(costs, targets, [1.0, 8.0], 0.01) == [0, 1]
    assert assign_jointly(costs, targets, 8.0, 100.0) == assign_jointly(
        costs, targets, [8.0, 8.0], 100.0
    )
    assert 2 in assign_jointly(costs, targets, 8.0, 100.0)
    assert 2 not in assign_jointly(costs, targets, [1.0, 1.0], 100.0)


def test_tours_by_vehicle():
    starts = np.array([[1.0, 2.0], [1.0, 2.0]])
    between = np.array([[[0.0, 1.0], [1.0, 0.0]], [[0.0, 9.0], [9.0, 0.0]]])
    zero = np.zeros(2)
    given = TourProblem(starts, between, zero, zero, 0.0)
    free = np.array([-1, -1])
    assert plan_tours(given, free).orders == [[0, 1], []]
    assert plan_tours(given._replace(between=between[::-1]), free).orders == [[], [0, 1]]
    work = np.array([[9.0, 9.0], [0.0, 0.0]])
    busy = given._replace(between=between[0], work=work)
    assert plan_tours(busy, free).orders == [[], [0, 1]]


HALL = """
#########################????????????
#.......................?????????????
#.......................?????????????
#.......................?????????????
#########################????????????
"""


def test_what_lies_behind_is_estimated_for_the_explorer_that_sees_farthest():
    grid = grid_of(HALL, **SCALE)

    def gain(*bodies):
        vehicles = {
            f'robot{i}': VehicleSnapshot(
                Pose2(*point_of(2, 3 + 3 * i, HALL, **SCALE), 0.0), body=body
            )
            for i, body in enumerate(bodies)
        }
        result = Planner(ExplorationConfig()).plan(grid, 0.0, vehicles)
        return sum(one.gain for one in result.frontiers)

    near, usual, far = (VehicleBody(sensor_range=reach) for reach in (2.0, 8.0, 12.0))
    assert gain(STANDARD) == gain(usual)
    assert len({gain(near), gain(usual), gain(far)}) == 3
    assert gain(near, far) == gain(far)
    assert gain(near, near) == gain(near)


def test_the_routes_of_a_large_vehicle_avoid_a_door():
    text = """
#################
#.......#.......#
#.......#.......#
#...............#
#.......#.......#
##...#######...##
##...#######...##
#...............#
#...............#
#...............#
#################
"""
    grid = grid_of(text, **SCALE)
    config = ExplorationConfig()
    vehicles = {
        'wide': VehicleSnapshot(Pose2(*point_of(3, 2, text, **SCALE), 0.0), body=LARGE),
        'usual': VehicleSnapshot(Pose2(*point_of(2, 4, text, **SCALE), 0.0)),
    }
    scene = Scene(grid, 0.0, config, vehicles)
    beyond = np.array([scene.cell_of(point_of(3, 12, text, **SCALE))])
    left = np.array([scene.cell_of(point_of(3, 4, text, **SCALE))])
    costs = {
        name: scene.routes(name).values_from(scene.routes(name).blocks(left)[0]).at(
            scene.routes(name).blocks(beyond)
        )[0]
        for name in vehicles
    }  # fmt: skip
    assert costs['usual'] < 12.0
    assert costs['wide'] > costs['usual'] + 4.0
    assert math.isfinite(costs['wide'])


def test_reach_and_paths_are_those_of_each_body():
    text = """
#################
#.......#.......#
#.......#.......#
#...............#
#.......#.......#
#.......#.......#
#################
"""
    vehicles = {
        'wide': VehicleSnapshot(Pose2(*point_of(5, 2, text, **SCALE), 0.0), body=LARGE),
        'usual': VehicleSnapshot(Pose2(*point_of(1, 2, text, **SCALE), 0.0)),
    }
    grid = grid_of(text, **SCALE)
    scene = Scene(grid, 0.0, ExplorationConfig(), vehicles)
    beyond = scene.cell_of(point_of(3, 12, text, **SCALE))
    beside = scene.cell_of((point_of(3, 1, text, **SCALE)[0], 1.2))  # 0.4 m from the wall below
    reached = {name: (mask[beyond], mask[beside]) for name, mask in scene.reach.items()}
    assert reached == {'usual': (True, True), 'wide': (False, False)}
    assert scene.path('usual', beyond) is not None
    assert scene.path('wide', beyond) is None
