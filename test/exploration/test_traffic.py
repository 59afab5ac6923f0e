"""Right of way between travelers: who goes, who stops where, who retreats, who gets priority."""

import math

import numpy as np
import pytest

from explore_slam.data import VehicleBody
from explore_slam.exploration.sections import TrafficConfig
from explore_slam.exploration.traffic import RightOfWay, Traffic, Traveler, paths_conflict

CONFIG = TrafficConfig(vehicle_separation=1.0, traffic_margin=4.0, traffic_horizon=40.0)


class Retreats:
    """Retreats of given costs (m) by name; a missing one is impossible."""

    def __init__(self, **costs):
        self.costs = costs

    def retreat(self, one, _others):
        cost = self.costs.get(one.name, math.inf)
        if not math.isfinite(cost):
            return None, math.inf
        return np.array([one.position, one.position + [0.0, cost]]), cost


def traveler(name, *points):
    path = np.array(points, float)
    return Traveler(name, path[0], path if len(path) > 1 else None, VehicleBody(speed=0.5))


def grants(*travelers, terrain=None, traffic=None):
    traffic = traffic or Traffic(CONFIG)
    return traffic.grant({t.name: t for t in travelers}, terrain or Retreats())


def test_vehicles_far_apart_all_go():
    found = grants(traveler('a', (0, 0), (9, 0)), traveler('b', (0, 5), (9, 5)))
    assert [grant.right for grant in found.values()] == [RightOfWay.GO, RightOfWay.GO]


def test_at_a_crossing_the_second_one_stops_before_the_path_of_the_first():
    found = grants(traveler('a', (0, 0), (9, 0)), traveler('b', (4.5, -4.5), (4.5, 4.5)))
    assert found['a'].right is RightOfWay.GO
    assert found['b'].right is RightOfWay.STOP
    assert found['b'].yields_to == 'a'
    assert found['b'].limit == pytest.approx(3.5, abs=0.11)


def test_a_vehicle_that_passes_a_crossing_much_later_goes():
    near = traveler('b', (4.5, -4.5), (4.5, 4.5))
    late = traveler('b', (4.5, -11.0), (4.5, 4.5))
    first = traveler('a', (0, 0), (9, 0))
    assert grants(first, near)['b'].right is RightOfWay.STOP
    assert grants(first, late)['b'].right is RightOfWay.GO


def test_followers_in_one_direction_need_no_margin():
    found = grants(traveler('a', (1.5, 0), (40, 0)), traveler('b', (0, 0), (40, 0)))
    assert found['b'].right is RightOfWay.GO
    opposite = grants(traveler('a', (2, 0), (20, 0)), traveler('b', (19, 0), (0, 0)))
    assert opposite['b'].right is RightOfWay.RETREAT or opposite['b'].right is RightOfWay.STOP


def test_an_idle_vehicle_retreats_from_the_path_of_another():
    found = grants(traveler('a', (0, 0), (9, 0)), traveler('b', (5, 0.3)), terrain=Retreats(b=1.5))
    assert found['a'].right is RightOfWay.STOP
    assert found['a'].limit == pytest.approx(4.0, abs=0.11)
    assert found['b'].right is RightOfWay.RETREAT
    assert found['b'].yields_to == 'a'
    np.testing.assert_allclose(found['b'].retreat[-1], (5, 1.8))


def test_a_vehicle_that_cannot_retreat_stands_and_the_other_one_stops_before_it():
    found = grants(traveler('a', (0, 0), (9, 0)), traveler('b', (5, 0.3)))
    assert (found['b'].right, found['b'].limit) == (RightOfWay.STOP, 0.0)
    assert found['a'].right is RightOfWay.STOP
    assert found['a'].limit < 4.2


@pytest.mark.parametrize(
    ('own', 'other', 'order'),
    [(5.0, 2.9, ['b', 'a']), (5.0, 3.1, ['a', 'b']), (math.inf, 9.0, ['b', 'a'])],
)
def test_the_one_that_retreats_more_easily_loses_its_priority_for_good(own, other, order):
    traffic = Traffic(CONFIG)
    pair = (traveler('a', (0, 0), (9, 0)), traveler('b', (6, 0), (-3, 0)))
    found = grants(*pair, terrain=Retreats(a=other, b=own), traffic=traffic)
    assert traffic.order == order
    assert found[order[1]].right is RightOfWay.RETREAT
    assert found[order[1]].yields_to == order[0]
    again = grants(*pair, terrain=Retreats(a=5.0, b=5.0), traffic=traffic)
    assert traffic.order == order
    assert again[order[1]].right is RightOfWay.RETREAT


def test_a_vehicle_whose_goal_lies_on_the_path_of_the_other_gets_no_priority():
    traffic = Traffic(CONFIG)
    pair = (traveler('a', (0, 0), (9, 0)), traveler('b', (6, 0), (3, 0)))
    grants(*pair, terrain=Retreats(a=1.0, b=9.0), traffic=traffic)
    assert traffic.order == ['a', 'b']


def test_vehicles_that_are_near_already_may_stay_so_but_come_no_nearer():
    traffic = Traffic(CONFIG)
    one, other = traveler('a', (0, 0)), traveler('b', (0.6, 0))
    assert traffic.threshold(one, other) == pytest.approx(0.57)
    assert traffic.threshold(one, traveler('b', (3, 0))) == 1.0
    leaving = grants(traveler('a', (0, 0), (-5, 0)), traveler('b', (0.6, 0), (6, 0)))
    assert [grant.right for grant in leaving.values()] == [RightOfWay.GO, RightOfWay.GO]


def test_vehicles_without_a_path_come_last_and_leave_the_order_when_they_are_gone():
    traffic = Traffic(CONFIG)
    found = grants(
        traveler('a', (5, 0)), traveler('b', (0, 0), (9, 0)), terrain=Retreats(a=1.0),
        traffic=traffic,
    )  # fmt: skip
    assert found['a'].right is RightOfWay.RETREAT
    grants(traveler('c', (0, 0)), traveler('b', (9, 9)), traffic=traffic)
    assert traffic.order == ['b', 'c']


def test_a_vehicle_at_its_goal_is_in_the_way_for_a_moment_only():
    """b crosses the goal of a 6.5 s after a has arrived there: too late to meet it."""
    parked = traveler('a', (0, 0), (1, 0))
    soon = traveler('b', (1, -2.5), (1, 2.5))
    later = traveler('b', (1, -7.0), (1, 2.5))
    assert grants(parked, soon)['b'].right is RightOfWay.STOP
    assert grants(parked, later)['b'].right is RightOfWay.GO


def positions(*x):
    return np.array([[value, 0.0] for value in x])


def test_conflicts_by_distance_and_time():
    away = np.tile([-1.0, 0.0], (3, 1))
    still = np.zeros((3, 2))
    own = positions(0.0, 1.0, 2.0)
    assert paths_conflict(own, positions(9.0, 9.0, 2.5), np.ones((3, 2)), still, 0.6, 0.0)
    assert not paths_conflict(own, positions(9.0, 9.0, 2.5), np.ones((3, 2)), still, 0.5, 0.0)
    # the other one passes where this one is two steps (1 s) later
    crossing = positions(2.0, 9.0, 9.0)
    assert paths_conflict(own, crossing, np.ones((3, 2)), away, 0.6, 1.0)
    assert not paths_conflict(own, crossing, np.ones((3, 2)), away, 0.6, 0.9)
    # in the same direction that is no conflict
    assert not paths_conflict(own, crossing, np.ones((3, 2)), -away, 0.6, 1.0)
    assert not paths_conflict(own, np.full((3, 2), np.nan), np.ones((3, 2)), still, 9.0, 9.0)


@pytest.mark.parametrize(('distance', 'right'), [(25.0, RightOfWay.GO), (15.0, RightOfWay.STOP)])
def test_what_lies_beyond_the_horizon_does_not_matter(distance, right):
    """Within 40 s at 0.5 m/s a vehicle drives 20 m."""
    found = grants(traveler('a', (0, 0), (40, 0)), traveler('b', (distance, 0.3)))
    assert found['a'].right is right


def test_of_two_that_wait_for_each_other_and_cannot_retreat_the_first_goes():
    one = traveler('a', (0.0, 0.0), (5.0, 0.0))
    other = traveler('b', (0.96, 0.0), (-5.0, 0.0))
    found = grants(one, other)
    assert found['a'].right is RightOfWay.GO
    assert found['b'].right is RightOfWay.STOP
    assert found['b'].yields_to == 'a'


def test_an_idle_vehicle_in_the_way_that_cannot_retreat_holds_nobody_for_ever():
    found = grants(traveler('a', (0.0, 0.0), (5.0, 0.0)), traveler('b', (0.96, 0.0)))
    assert found['a'].right is RightOfWay.GO


def test_in_a_circle_of_three_one_goes():
    found = grants(
        traveler('a', (0.0, 0.0), (3.0, 0.0)),
        traveler('b', (0.9, 0.0), (-1.0, 2.0)),
        traveler('c', (0.4, 0.8), (0.6, -4.0)),
    )
    assert RightOfWay.GO in {grant.right for grant in found.values()}
