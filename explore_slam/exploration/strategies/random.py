"""Strategy random: a target drawn uniformly, kept until it is reached; a baseline."""

import numpy as np

from explore_slam.exploration.assignment import assign_random
from explore_slam.exploration.sections import AssignmentConfig
from explore_slam.exploration.strategies.strategy import Situation, StrategyKind


class RandomStrategy:
    """Draws a reachable frontier for each vehicle that has no target."""

    def __init__(self, config: AssignmentConfig, _sensor_range: float) -> None:
        self._random = np.random.default_rng(config.exploration_seed)

    def assign(self, situation: Situation) -> list[int]:
        """See Strategy.assign."""
        drawn = assign_random(situation.costs, self._random)
        return [
            current if current >= 0 else target
            for current, target in zip(situation.current, drawn, strict=True)
        ]


RANDOM = StrategyKind(RandomStrategy)
