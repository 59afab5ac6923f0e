"""Strategy default: stops, detours, urgency, hysteresis of tours, idle vehicles."""

import numpy as np
import pytest

from explore_slam.exploration import Frontier
from explore_slam.exploration.sections import AssignmentConfig
from explore_slam.exploration.strategies.default import (
    DefaultStrategy,
    defer_low_gain_stops,
    improve_or_replace,
    merge_frontiers,
    urgencies,
)
from explore_slam.exploration.strategies.strategy import Situation
from explore_slam.exploration.tours import TourProblem

GAINS = np.array([0.5, 4.0, 50.0])


def frontier(x, y=0.0, gain=10.0):
    return Frontier(np.zeros((1, 2), np.int64), (x, y), (x, y), (round(y), round(x)), 1.0, gain)


class StraightLines:
    """Travel costs are distances: the cells of frontiers are their targets in whole metres."""

    size = 1  # blocks

    def routes(self, _vehicle):
        return self

    @staticmethod
    def blocks(cells):
        return cells

    @staticmethod
    def values_from(block):
        class Distances:
            @staticmethod
            def at(blocks):
                return np.hypot(*(blocks - block).T)

        return Distances()


def situation(vehicles, frontiers, current=None, switches=None):
    targets = np.array([f.target for f in frontiers])
    costs = np.linalg.norm(np.array(vehicles)[:, None] - targets[None], axis=2)
    count = len(vehicles)
    names = tuple(f'robot{number + 1}' for number in range(count))
    return Situation(
        StraightLines(), names, frontiers, costs, current or [-1] * count, switches or [0] * count
    )


def strategy(**values):
    return DefaultStrategy(AssignmentConfig(**values), 8.0)


def test_waiting_costs_its_weight_for_each_vehicle_whatever_there_is_to_gain():
    for vehicles in (1, 3):
        paid = urgencies(GAINS, vehicles, 0.7)
        assert paid.sum() == pytest.approx(0.7 * vehicles)
        assert (np.diff(paid) > 0.0).all()


def test_small_stops_keep_some_urgency_and_large_gains_are_cut():
    none, cut, more = urgencies(np.array([0.0, 20.0, 500.0]), 1, 1.0)
    assert none == pytest.approx(2.0 / 46.0)
    assert cut == more == pytest.approx(22.0 / 46.0)


def line(*places, starts=(0.0,)):
    at = np.array(places)
    zero = np.zeros(len(at))
    return TourProblem(
        np.abs(np.array(starts)[:, None] - at), np.abs(at[:, None] - at), zero, zero, 0.0
    )


def test_tours_in_force_are_dropped_for_much_better_ones_only():
    # The vehicle is on its way to 0, and 1 lies a little aside of where it is now.
    zero = np.zeros(2)
    between = np.array([[0.0, 6.5], [6.5, 0.0]])
    given = TourProblem(np.array([[6.0, 1.0]]), between, zero, zero, 0.0)
    for margin, first in ((10.0, 0), (5.1, 0), (4.9, 1), (1.0, 1)):
        tours = improve_or_replace(given, np.array([0]), [[0, 1]], margin)
        assert tours.orders[0][0] == first
        assert sorted(tours.orders[0]) == [0, 1]


def test_a_stop_that_gains_less_than_its_detour_is_worth_waits():
    given, free = line(2.0, -3.0, 4.0), np.array([-1])
    gains = np.array([5.0, 0.5, 5.0])
    later = defer_low_gain_stops(given, gains, free, 0.3)
    assert np.isinf(later.starts[0]).tolist() == [False, True, False]
    assert (later.between == given.between).all()
    bound = defer_low_gain_stops(given, gains, np.array([1]), 0.3)
    assert np.isfinite(bound.starts).all()
    rich = defer_low_gain_stops(given, np.array([5.0, 50.0, 5.0]), free, 0.3)
    assert np.isfinite(rich.starts).all()


def test_a_stop_on_the_way_costs_no_detour():
    given = line(2.0, 4.0)
    kept = defer_low_gain_stops(given, np.array([0.05, 9.0]), np.array([-1]), 0.3)
    assert np.isfinite(kept.starts).all()


def test_where_nothing_is_worth_its_detour_everything_is_visited():
    given = line(20.0, 30.0)
    assert defer_low_gain_stops(given, np.array([0.1, 0.1]), np.array([-1]), 0.3) is given


def test_frontiers_that_lie_together_are_one_stop_and_far_ones_more_coarsely():
    frontiers = [frontier(3.0), frontier(4.0), frontier(5.2), frontier(20.0), frontier(22.5)]
    costs = np.array([[f.target[0] for f in frontiers]])
    stops = merge_frontiers(frontiers, costs, [-1], 1.5)
    assert [(stop.target, stop.members) for stop in stops] == [(0, [0, 1]), (2, [2]), (3, [3, 4])]
    assert [stop.target for stop in merge_frontiers(frontiers, costs, [1], 1.5)] == [1, 3]
    costs[0, 3:] = np.inf
    assert [stop.target for stop in merge_frontiers(frontiers, costs, [-1], 1.5)] == [0, 2]


def test_there_are_never_more_stops_than_the_planning_time_allows():
    frontiers = [frontier(2.0 * i) for i in range(80)]
    costs = np.ones((1, 80))
    stops = merge_frontiers(frontiers, costs, [-1], 0.5)
    assert len(stops) == 60
    assert sorted(index for stop in stops for index in stop.members) == list(range(80))


def test_vehicles_share_the_frontiers():
    given = situation([(0.0, 0.0), (0.0, 1.0)], [frontier(8.0), frontier(-8.0)])
    assert sorted(strategy().assign(given)) == [0, 1]


def test_a_vehicle_without_a_tour_goes_along_to_what_is_left():
    # Two frontiers are one stop: one tour, and the vehicle that has none gets the other frontier.
    given = situation([(0.0, 0.0), (-9.0, 0.0)], [frontier(5.0), frontier(6.0)])
    chosen = strategy(longest_weight=0.0, waiting_weight=0.0).assign(given)
    assert chosen == [0, 1]


def test_more_vehicles_than_frontiers_leave_one_without():
    given = situation([(0.0, 0.0), (-9.0, 0.0)], [frontier(5.0)])
    assert sorted(strategy().assign(given)) == [-1, 0]


def test_a_better_tour_replaces_the_current_one_and_switches_make_that_harder():
    def second_choice(switches):
        planner = strategy(tour_hysteresis=5.0, waiting_weight=0.0, gain_per_detour=0.0)
        frontiers = [frontier(6.0), frontier(-6.0)]
        assert planner.assign(situation([(1.0, 0.0)], frontiers)) == [0]
        return planner.assign(situation([(-4.0, 0.0)], frontiers, [0], [switches]))

    assert second_choice(0) == [1]
    assert second_choice(3) == [0]


def test_the_tours_of_the_last_cycle_are_recognized_by_place_and_not_by_number():
    planner = strategy()
    planner.assign(situation([(0.0, 0.0)], [frontier(4.0), frontier(9.0)]))
    points = np.array([[30.0, 0.0], [9.5, 0.0], [4.2, 0.0]])
    assert planner._prior_tours(('robot1', 'robot2'), points) == [[2, 1], []]
    assert planner._prior_tours(('robot1',), points + 5.5) == [[]]
