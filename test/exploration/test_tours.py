"""Tours of a team: short, shared evenly, near stops first, those in force kept."""

import itertools

import numpy as np
import pytest

from explore_slam.exploration.tours import TourProblem, plan_tours

FREE = np.array([-1])


def problem(starts, between, work=None, urgency=None, longest_weight=0.0):
    zero = np.zeros(len(between))
    return TourProblem(
        np.asarray(starts, float),
        np.asarray(between, float),
        zero if work is None else np.asarray(work, float),
        zero if urgency is None else np.asarray(urgency, float),
        longest_weight,
    )


def on_a_line(*places, start=0.0, **values):
    at = np.array(places)
    return problem(np.abs(at - start)[None], np.abs(at[:, None] - at[None]), **values)


def team_cost(tours, given):
    """What the team pays, computed from the definition."""
    lengths, waiting = [], 0.0
    for vehicle, order in enumerate(tours):
        total = 0.0
        for at, stop in enumerate(order):
            total += given.starts[vehicle, stop] if at == 0 else given.between[order[at - 1], stop]
            waiting += given.urgency[stop] * total
            total += given.work[stop]
        lengths.append(total)
    return sum(lengths) + waiting + given.longest_weight * max(lengths)


def random_problem(seed, vehicles, stops):
    generator = np.random.default_rng(seed)
    places = generator.uniform(0.0, 10.0, (stops, 2))
    starts = generator.uniform(0.0, 10.0, (vehicles, 2))
    return problem(
        np.linalg.norm(starts[:, None] - places[None], axis=2),
        np.linalg.norm(places[:, None] - places[None], axis=2),
        generator.uniform(0.0, 3.0, stops),
        generator.uniform(0.0, 0.5, stops),
        2.0,
    )


@pytest.mark.parametrize('seed', range(5))
def test_the_tour_of_one_vehicle_is_nearly_the_shortest(seed):
    given = random_problem(seed, 1, 7)._replace(
        work=np.zeros(7), urgency=np.zeros(7), longest_weight=0.0
    )
    tours = plan_tours(given, FREE)
    assert sorted(tours.orders[0]) == list(range(7))
    own = team_cost(tours.orders, given)
    assert tours.cost == pytest.approx(own)
    best = min(team_cost([list(p)], given) for p in itertools.permutations(range(7)))
    assert own <= 1.15 * best


@pytest.mark.parametrize('seed', range(6))
def test_the_cost_is_that_of_the_definition_and_no_single_move_lowers_it(seed):
    given = random_problem(seed, 3, 8)
    tours = plan_tours(given, np.array([-1, -1, -1]))
    assert sorted(itertools.chain(*tours.orders)) == list(range(8))
    assert tours.cost == pytest.approx(team_cost(tours.orders, given))
    for vehicle, at in [(v, i) for v, order in enumerate(tours.orders) for i in range(len(order))]:
        rest = [list(order) for order in tours.orders]
        stop = rest[vehicle].pop(at)
        for other, where in [(v, i) for v, o in enumerate(rest) for i in range(len(o) + 1)]:
            moved = [list(order) for order in rest]
            moved[other].insert(where, stop)
            assert team_cost(moved, given) > tours.cost - 1e-5
    for vehicle, order in enumerate(tours.orders):
        for first, last in itertools.combinations(range(len(order) + 1), 2):
            turned = [list(o) for o in tours.orders]
            turned[vehicle][first:last] = turned[vehicle][first:last][::-1]
            assert team_cost(turned, given) > tours.cost - 1e-5


def test_a_segment_from_the_very_first_stop_on_is_reversed():
    """Pairs of stops: moving one of a pair never pays, only a reversal from the start does."""
    pairs = np.array([[4.0, 3.0], [1.0, 0.0], [5.0, 0.0]])
    places = np.concatenate([pairs, pairs + [0.0, 0.05]])[[0, 3, 1, 4, 2, 5]]
    given = problem(
        np.linalg.norm(places, axis=1)[None],
        np.linalg.norm(places[:, None] - places[None], axis=2),
    )
    tours = plan_tours(given, FREE, [[0, 1, 2, 3, 4, 5]])
    assert sorted(tours.orders[0][:2]) == [2, 3]
    assert tours.cost < 8.6


def test_the_first_stop_stays_where_it_is_fixed_when_segments_are_reversed():
    given = on_a_line(9.0, 8.9, 1.1, 1.0)
    tours = plan_tours(given, np.array([0]), [[0, 1, 2, 3]])
    assert tours.orders[0][0] == 0


def test_the_longest_tour_counts_again_so_work_is_shared():
    places = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    between = np.abs(places[:, None] - places[None])
    starts = np.vstack([places, places + 0.5])
    free = np.array([-1, -1])
    alone = plan_tours(problem(starts, between), free)
    assert sorted(map(len, alone.orders)) == [0, 6]
    shared = plan_tours(problem(starts, between, np.full(6, 5.0), longest_weight=10.0), free)
    assert sorted(map(len, shared.orders)) == [3, 3]


def test_fixed_stops_come_first():
    given = on_a_line(1.0, 2.0, -1.5)
    assert plan_tours(given, FREE).orders == [[2, 0, 1]]
    assert plan_tours(given, np.array([0])).orders == [[0, 1, 2]]


def test_stops_that_no_vehicle_reaches_are_in_no_tour():
    given = problem([[1.0, np.inf], [np.inf, np.inf]], np.zeros((2, 2)), longest_weight=1.0)
    assert plan_tours(given, np.array([-1, -1])).orders == [[0], []]


def test_a_stop_that_one_vehicle_cannot_reach_is_visited_by_the_other():
    given = problem([[1.0, np.inf], [1.0, 3.0]], [[0.0, 8.0], [8.0, 0.0]])
    assert plan_tours(given, np.array([-1, -1])).orders == [[0], [1]]


def test_waiting_draws_what_is_near_to_the_front():
    # The shortest open tour turns to the near side first and ends far away on the other.
    calm = on_a_line(-2.0, -2.5, 2.2, 9.0)
    assert plan_tours(calm, FREE).orders[0][2:] == [2, 3]
    urgent = on_a_line(-2.0, -2.5, 2.2, 9.0, urgency=[0.0, 0.0, 1.0, 9.0])
    assert plan_tours(urgent, FREE).orders[0] == [2, 3, 0, 1]


def test_tours_in_force_are_improved_upon_and_else_kept():
    given = problem([[1.0, 1.0]], [[0.0, 2.0], [2.0, 0.0]])  # either order is as good
    for prior in ([0, 1], [1, 0]):
        assert plan_tours(given, FREE, [prior]).orders == [prior]
    far = given._replace(starts=np.array([[1.0, 50.0]]))
    assert plan_tours(far, FREE, [[1, 0]]).orders == [[0, 1]]
    two = plan_tours(given._replace(starts=np.ones((2, 2))), np.array([1, -1]), [[0], [1]])
    assert two.orders[0][0] == 1
    assert sorted(two.orders[0] + two.orders[1]) == [0, 1]


def test_two_vehicles_cannot_be_bound_to_one_stop():
    given = problem(np.ones((2, 2)), [[0.0, 5.0], [5.0, 0.0]])
    tours = plan_tours(given, np.array([0, 0]))
    assert tours.orders == [[0], [1]]


@pytest.mark.parametrize('prior', [[[0, 1], [2]], [[1, 0], [2]], [[0], [2, 3, 1]]])
def test_every_stop_of_a_tour_may_move_to_the_other_vehicle(prior):
    places = np.array([1.0, 19.0, 18.0] if len(prior[1]) == 1 else [1.0, 2.0, 18.0, 19.0])
    starts = np.abs(np.array([[0.0], [20.0]]) - places)
    given = problem(starts, np.abs(places[:, None] - places[None]))
    tours = plan_tours(given, np.array([-1, -1]), prior)
    near = [sorted(np.flatnonzero(places < 10.0)), sorted(np.flatnonzero(places > 10.0))]
    assert [sorted(order) for order in tours.orders] == near
