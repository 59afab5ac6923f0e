"""Strategy nearest: each vehicle takes its nearest frontier (Yamauchi, 1998); a baseline.

B. Yamauchi, "Frontier-based exploration using multiple robots", Autonomous Agents 1998.
"""

from explore_slam.exploration.assignment import assign_nearest
from explore_slam.exploration.sections import AssignmentConfig
from explore_slam.exploration.strategies.strategy import Situation, StrategyKind


class NearestStrategy:
    """Assigns the cheapest frontier to each vehicle, whatever the others do."""

    def __init__(self, config: AssignmentConfig, _sensor_range: float) -> None:
        self._hysteresis = config.hysteresis

    def assign(self, situation: Situation) -> list[int]:
        """See Strategy.assign."""
        return assign_nearest(situation.costs_with_hysteresis(self._hysteresis))


NEAREST = StrategyKind(NearestStrategy)
