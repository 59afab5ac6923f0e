"""The registry of strategies, and what all of them have in common."""

import numpy as np
import pytest

from explore_slam.errors import ConfigError
from explore_slam.exploration import STRATEGIES, ExplorationConfig, Frontier
from explore_slam.exploration.sections import AssignmentConfig
from explore_slam.exploration.strategies.strategy import Situation

SIMPLE = ('paper', 'nearest', 'random')


def situation(costs, current=None, switches=None):
    costs = np.array(costs, float)
    vehicles, count = costs.shape
    frontiers = [
        Frontier(np.zeros((1, 2), np.int64), (9.0 * i, 0.0), (9.0 * i, 0.0), (0, i), 1.0)
        for i in range(count)
    ]
    names = tuple(f'robot{number + 1}' for number in range(vehicles))
    return Situation(
        None, names, frontiers, costs, current or [-1] * vehicles, switches or [0] * vehicles
    )


def create(name, **values):
    return STRATEGIES[name].create(AssignmentConfig(**values), 8.0)


def test_the_setting_offers_what_is_registered():
    for name in STRATEGIES:
        assert ExplorationConfig(strategy=name).strategy == name
    with pytest.raises(ConfigError, match=r"strategy is 'clever', expected one of .*'paper'"):
        ExplorationConfig(strategy='clever')


@pytest.mark.parametrize('name', SIMPLE)
def test_unreachable_frontiers_are_not_assigned(name):
    chosen = create(name).assign(situation([[np.inf, np.inf], [np.inf, 3.0]]))
    assert chosen == [-1, 1]


@pytest.mark.parametrize('name', ['paper', 'nearest'])
def test_hysteresis_keeps_the_current_target_and_doubles_with_every_switch(name):
    costs = [[5.0, 2.0]]
    given = {'hysteresis': 2.0}
    assert create(name, **given).assign(situation(costs)) == [1]
    assert create(name, **given).assign(situation(costs, [0])) == [1]
    assert create(name, hysteresis=4.0).assign(situation(costs, [0])) == [0]
    assert create(name, **given).assign(situation(costs, [0], [1])) == [0]


def test_the_random_strategy_keeps_a_target_until_it_is_reached():
    planner = create('random', exploration_seed=3)
    costs = np.ones((1, 9))
    for current in (4, 7):
        assert planner.assign(situation(costs, [current])) == [current]
    drawn = {planner.assign(situation(costs))[0] for _ in range(60)}
    assert drawn == set(range(9))


def test_only_the_paper_charges_probabilities():
    assert [name for name, kind in STRATEGIES.items() if kind.probability_costs] == ['paper']
