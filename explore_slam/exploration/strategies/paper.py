"""Strategy paper: greedy assignment by utility and cost (paper, sections V-B and V-C).

The method is that of W. Burgard, M. Moors, C. Stachniss and F. Schneider, "Coordinated multi-robot
exploration", IEEE Transactions on Robotics 21(3), 2005.
"""

from explore_slam.exploration.assignment import assign_targets
from explore_slam.exploration.sections import AssignmentConfig
from explore_slam.exploration.strategies.strategy import Situation, StrategyKind


class PaperStrategy:
    """Assigns the pair of vehicle and frontier with the best utility minus cost, repeatedly."""

    def __init__(self, config: AssignmentConfig, sensor_range: float) -> None:
        self._config = config
        self._sensor_range = sensor_range

    def assign(self, situation: Situation) -> list[int]:
        """See Strategy.assign."""
        return assign_targets(
            situation.costs_with_hysteresis(self._config.hysteresis),
            situation.targets,
            situation.side_ranges(self._sensor_range),
            self._config.travel_weight,
        )


PAPER = StrategyKind(PaperStrategy, probability_costs=True)
