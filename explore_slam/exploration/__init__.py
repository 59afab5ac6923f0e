"""Grid -> frontiers -> travel costs (value iteration) -> assignment -> paths for a team."""

from explore_slam.exploration.assignment import (
    assign_jointly,
    assign_nearest,
    assign_random,
    assign_targets,
    coverage_probability,
    utilities,
)
from explore_slam.exploration.clearance import CostMap, make_cost_map, paths_of
from explore_slam.exploration.compilation import warm_up
from explore_slam.exploration.config import ExplorationConfig
from explore_slam.exploration.frontiers import find_frontiers
from explore_slam.exploration.paths import plan_path, shortcut
from explore_slam.exploration.planner import Planner
from explore_slam.exploration.records import (
    ExplorationStatus,
    Frontier,
    Grid,
    KnownPlace,
    PlanningMode,
    PlanningResult,
    VehicleSnapshot,
    unreached_text,
)
from explore_slam.exploration.strategies import STRATEGIES
from explore_slam.exploration.value_iteration import travel_cost

__all__ = [
    'STRATEGIES',
    'CostMap',
    'ExplorationConfig',
    'ExplorationStatus',
    'Frontier',
    'Grid',
    'KnownPlace',
    'Planner',
    'PlanningMode',
    'PlanningResult',
    'VehicleSnapshot',
    'assign_jointly',
    'assign_nearest',
    'assign_random',
    'assign_targets',
    'coverage_probability',
    'find_frontiers',
    'make_cost_map',
    'paths_of',
    'plan_path',
    'shortcut',
    'travel_cost',
    'unreached_text',
    'utilities',
    'warm_up',
]
