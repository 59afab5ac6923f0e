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
