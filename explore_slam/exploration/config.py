"""All settings of exploration in one tree."""

from dataclasses import dataclass

from explore_slam.exploration.sections import (
    AssignmentConfig,
    BlacklistConfig,
    FrontierConfig,
    LoopConfig,
    PathConfig,
    TrafficConfig,
)
from explore_slam.exploration.strategies import STRATEGIES
from explore_slam.settings import Section, section, setting


@dataclass(frozen=True)
class ExplorationConfig(Section):
    """Settings of exploration: what is worth visiting, who goes there, and by which path."""

    strategy: str = setting(
        'default',
        'How targets are assigned to vehicles',
        choices=tuple(STRATEGIES),
        tier='basic',
    )
    paths: PathConfig = section(PathConfig)
    frontiers: FrontierConfig = section(FrontierConfig)
    assignment: AssignmentConfig = section(AssignmentConfig)
    loops: LoopConfig = section(LoopConfig)
    blacklist: BlacklistConfig = section(BlacklistConfig)
    traffic: TrafficConfig = section(TrafficConfig)
    empty_searches: int = setting(
        3,
        'Number of consecutive searches without a target after which exploration is complete',
        low=1,
        high=1000,
    )
    obstruction_patience: float = setting(
        120.0,
        'Time for which a vehicle waits, before exploration ends, where a way to what is left has '
        'become blocked',
        unit='s',
        low=0.0,
        high=3600.0,
    )
    return_to_init: bool = setting(
        False, 'Drive home when nothing is left to explore', tier='basic'
    )
