"""Utility (equations 8 and 9), the greedy choice, and the joint ones."""

import itertools

import numpy as np
import pytest

from explore_slam.errors import ExplorationError
from explore_slam.exploration import (
    assign_jointly,
    assign_nearest,
    assign_random,
    assign_targets,
    coverage_probability,
    utilities,
)
from explore_slam.exploration.tours import plan_tours


def test_equation_9():
    assert coverage_probability([0.0, 2.0, 4.0, 9.0], 4.0).tolist() == [1.0, 0.5, 0.0, 0.0]


def test_equation_8():
    targets = [(0.0, 0.0), (1.0, 0.0), (10.0, 0.0)]
    assert utilities(targets, [], 4.0).tolist() == [1.0, 1.0, 1.0]
    assert utilities(targets, [(0.0, 0.0), (3.0, 0.0)], 4.0).tolist() == [-0.25, -0.25, 1.0]


def test_the_greedy_choice_takes_the_best_pair_and_lowers_the_others():
    targets = [(0.0, 0.0), (1.0, 0.0), (10.0, 0.0)]
    costs = [[0.1, 0.2, 0.9], [0.3, 0.35, 0.9]]
    # Vehicle 0 takes target 0; target 1 is worth 0.25 for the other one, target 2 still 1.
    assert assign_targets(costs, targets, 4.0) == [0, 2]
    assert assign_targets(costs, targets, 4.0, travel_weight=10.0) == [0, 1]


def test_unreachable_targets_are_not_given():
    costs = [[np.inf, np.inf], [1.0, np.inf]]
    targets = [(0.0, 0.0), (5.0, 0.0)]
    assert assign_targets(costs, targets, 4.0) == [-1, 0]
    assert assign_jointly(costs, targets, 4.0, 5.0) == [-1, 0]
    assert assign_nearest(costs) == [-1, 0]
    assert assign_random(costs, np.random.default_rng(0)) == [-1, 0]


def test_more_vehicles_than_targets():
    costs = np.ones((3, 1))
    assert sorted(assign_targets(costs, [(0.0, 0.0)], 4.0)) == [-1, -1, 0]
    assert sorted(assign_jointly(costs, [(0.0, 0.0)], 4.0, 1.0)) == [-1, -1, 0]


@pytest.mark.parametrize('seed', range(8))
def test_the_joint_choice_is_never_worse_than_the_greedy_one_in_travel_and_overlap(seed):
    generator = np.random.default_rng(seed)
    targets = generator.uniform(0.0, 20.0, (7, 2))
    vehicles = generator.uniform(0.0, 20.0, (3, 2))
    costs = np.linalg.norm(vehicles[:, None] - targets[None], axis=2)

    def paid(chosen):
        overlap = sum(
            coverage_probability(np.linalg.norm(targets[a] - targets[b]), 8.0)
            for a, b in itertools.combinations(chosen, 2)
        )
        return costs[range(3), chosen].sum() + 6.0 * overlap

    joint = assign_jointly(costs, targets, 8.0, 6.0)
    assert len(set(joint)) == 3
    assert paid(joint) <= paid(assign_targets(costs, targets, 8.0, 1 / 6.0)) + 1e-9
    best = min(paid(chosen) for chosen in itertools.permutations(range(7), 3))
    assert paid(joint) <= 1.5 * best


def test_bad_costs_are_refused():
    with pytest.raises(ExplorationError, match='costs have shape'):
        assign_targets(np.ones((2, 3)), [(0.0, 0.0)], 4.0)
    with pytest.raises(ExplorationError, match='NaN'):
        assign_jointly(np.full((1, 1), np.nan), [(0.0, 0.0)], 4.0, 1.0)


def tour_length(start, order, targets):
    points = np.vstack([start, targets[order]])
    return np.hypot(*np.diff(points, axis=0).T).sum()


@pytest.mark.parametrize('seed', range(5))
def test_the_tour_of_one_vehicle_is_nearly_the_shortest(seed):
    generator = np.random.default_rng(seed)
    targets, start = generator.uniform(0.0, 10.0, (7, 2)), generator.uniform(0.0, 10.0, 2)
    between = np.linalg.norm(targets[:, None] - targets[None], axis=2)
    first = np.linalg.norm(targets - start, axis=1)[None]
    zero = np.zeros(7)
    tours = plan_tours(first, between, zero, zero, zero, np.array([-1]), 0.0)
    assert sorted(tours.orders[0]) == list(range(7))
    own = tour_length(start, tours.orders[0], targets)
    assert tours.cost == pytest.approx(own)
    best = min(tour_length(start, list(p), targets) for p in itertools.permutations(range(7)))
    assert own <= 1.15 * best


def test_the_longest_tour_counts_again_so_work_is_shared():
    targets = np.array([[x, 0.0] for x in (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)])
    between = np.abs(targets[:, :1] - targets[None, :, 0])
    starts = np.vstack([targets[:, 0], targets[:, 0] + 0.5])
    zero, work = np.zeros(6), np.full(6, 5.0)
    free = np.array([-1, -1])
    alone = plan_tours(starts, between, zero, zero, zero, free, 0.0)
    assert sorted(map(len, alone.orders)) == [0, 6]
    shared = plan_tours(starts, between, work, zero, zero, free, 10.0)
    assert sorted(map(len, shared.orders)) == [3, 3]


def test_fixed_targets_come_first_and_the_bonus_draws_the_end():
    targets = np.array([[1.0, 0.0], [2.0, 0.0], [-1.5, 0.0]])
    between = np.linalg.norm(targets[:, None] - targets[None], axis=2)
    starts = np.linalg.norm(targets, axis=1)[None]
    zero = np.zeros(3)
    bound = plan_tours(starts, between, zero, zero, zero, np.array([1]), 0.0)
    assert bound.orders[0][0] == 1
    last = plan_tours(starts, between, zero, zero, np.array([0.0, 9.0, 0.0]), np.array([-1]), 0.0)
    assert last.orders[0] == [2, 0, 1]


def test_targets_that_nobody_reaches_are_in_no_tour():
    starts = np.array([[1.0, np.inf], [np.inf, np.inf]])
    tours = plan_tours(
        starts, np.zeros((2, 2)), np.zeros(2), np.zeros(2), np.zeros(2), np.array([-1, -1]), 1.0
    )
    assert tours.orders == [[0], []]


def test_waiting_draws_what_is_near_to_the_front():
    # The shortest open tour turns to the near side first and ends far away on the other.
    targets = np.array([[-2.0, 0.0], [-2.5, 0.0], [2.2, 0.0], [9.0, 0.0]])
    between = np.linalg.norm(targets[:, None] - targets[None], axis=2)
    starts = np.abs(targets[:, 0])[None]
    zero, free = np.zeros(4), np.array([-1])
    calm = plan_tours(starts, between, zero, zero, zero, free, 0.0)
    assert calm.orders[0][2:] == [2, 3]
    pressing = np.array([0.0, 0.0, 1.0, 9.0])
    assert plan_tours(starts, between, zero, pressing, zero, free, 0.0).orders[0] == [2, 3, 0, 1]


def test_tours_in_force_are_improved_upon_and_else_kept():
    targets = np.array([[1.0, 0.0], [-1.0, 0.0]])
    between = np.linalg.norm(targets[:, None] - targets[None], axis=2)
    starts = np.ones((1, 2))  # either order is as good
    zero, free = np.zeros(2), np.array([-1])
    for prior in ([0, 1], [1, 0]):
        tours = plan_tours(starts, between, zero, zero, zero, free, 0.0, [prior])
        assert tours.orders == [prior]
    far = np.array([[1.0, 50.0]])
    assert plan_tours(far, between, zero, zero, zero, free, 0.0, [[1, 0]]).orders == [[0, 1]]
    two = plan_tours(
        np.ones((2, 2)), between, zero, zero, zero, np.array([1, -1]), 0.0, [[0], [1]]
    )
    assert two.orders[0][0] == 1
    assert sorted(two.orders[0] + two.orders[1]) == [0, 1]
