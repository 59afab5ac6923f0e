"""Exploration strategies by name; a new strategy is a module and a line here."""

from explore_slam.exploration.strategies.default import DEFAULT
from explore_slam.exploration.strategies.nearest import NEAREST
from explore_slam.exploration.strategies.paper import PAPER
from explore_slam.exploration.strategies.random import RANDOM
from explore_slam.exploration.strategies.strategy import Situation, Strategy, StrategyKind

__all__ = ['STRATEGIES', 'Situation', 'Strategy', 'StrategyKind']

STRATEGIES: dict[str, StrategyKind] = {
    'default': DEFAULT,
    'paper': PAPER,
    'nearest': NEAREST,
    'random': RANDOM,
}
