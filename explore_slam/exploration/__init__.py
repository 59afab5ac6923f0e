"""Grid -> frontiers -> cost (value iteration) -> utility -> assignment -> paths for a team."""

import numpy as np

from explore_slam.exploration.assignment import (
    assign_jointly,
    assign_nearest,
    assign_random,
    assign_targets,
    coverage_probability,
    utilities,
)
from explore_slam.exploration.clearance import CostMap, make_cost_map
from explore_slam.exploration.config import ExplorationConfig
from explore_slam.exploration.frontiers import find_frontiers
from explore_slam.exploration.paths import plan_path, shortcut
from explore_slam.exploration.planner import Planner
from explore_slam.exploration.records import (
    ExplorationStatus,
    Frontier,
    Grid,
    PlanningMode,
    PlanningResult,
    VehicleSnapshot,
)
from explore_slam.exploration.value_iteration import travel_cost

__all__ = [
    'CostMap',
    'ExplorationConfig',
    'ExplorationStatus',
    'Frontier',
    'Grid',
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
    'plan_path',
    'shortcut',
    'travel_cost',
    'utilities',
    'warm_up',
]


class _TinyGrid:
    """A grid of a few cells, known on one side: enough to run every kernel once."""

    resolution = 0.1
    origin = (0.0, 0.0)
    shape = (24, 24)

    def probability(self) -> 'np.typing.NDArray[np.float32]':
        return np.full(self.shape, 0.1, np.float32)

    def known(self) -> 'np.typing.NDArray[np.bool_]':
        seen = np.zeros(self.shape, np.bool_)
        seen[:, :14] = True
        return seen

    def to_cell(self, points: 'np.typing.ArrayLike') -> 'np.typing.NDArray[np.int64]':
        cells = np.floor(np.asarray(points, np.float64).reshape(-1, 2) / self.resolution)
        return np.ascontiguousarray(cells[:, ::-1]).astype(np.int64)

    def to_point(self, cells: 'np.typing.ArrayLike') -> 'np.typing.NDArray[np.float64]':
        index = np.asarray(cells, np.int64).reshape(-1, 2)
        return np.asarray((index[:, ::-1] + 0.5) * self.resolution, np.float64)


def warm_up() -> None:
    """Compile every kernel of the room, so that no later call waits for the compiler."""
    from explore_slam.geometry import Pose2

    planner = Planner()
    team = {'a': VehicleSnapshot(Pose2(0.4, 1.8, 0.0)), 'b': VehicleSnapshot(Pose2(0.4, 0.6, 0.0))}
    planner.plan(_TinyGrid(), 0.0, team)
