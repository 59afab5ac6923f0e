"""Compilation of all kernels of exploration ahead of time."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from explore_slam.exploration.frontiers import find_frontiers
from explore_slam.exploration.paths import lowest_cost
from explore_slam.exploration.planner import Planner
from explore_slam.exploration.records import VehicleSnapshot
from explore_slam.exploration.regions import connected_region
from explore_slam.geometry import Array, Pose2


class _TinyGrid:
    """A grid of a few cells, known on one side: enough to run every kernel once."""

    resolution = 0.1
    origin = (0.0, 0.0)
    shape = (24, 24)

    def probability(self) -> NDArray[np.float32]:
        return np.full(self.shape, 0.1, np.float32)

    def known(self) -> NDArray[np.bool_]:
        seen = np.zeros(self.shape, np.bool_)
        seen[:, :14] = True
        return seen

    def levels(self) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
        table = np.full(65536, 0.1, np.float32)
        table[0] = np.nan
        return self.known().astype(np.int16), table

    def to_cell(self, points: ArrayLike) -> NDArray[np.int64]:
        cells = np.floor(np.asarray(points, np.float64).reshape(-1, 2) / self.resolution)
        return np.ascontiguousarray(cells[:, ::-1]).astype(np.int64)

    def to_point(self, cells: ArrayLike) -> Array:
        index = np.asarray(cells, np.int64).reshape(-1, 2)
        return np.asarray((index[:, ::-1] + 0.5) * self.resolution, np.float64)


def warm_up() -> None:
    """Compile every kernel of the package, so that no later call waits for the compiler."""
    grid, planner = _TinyGrid(), Planner()
    team = {'a': VehicleSnapshot(Pose2(0.4, 1.8, 0.0)), 'b': VehicleSnapshot(Pose2(0.4, 0.6, 0.0))}
    planner.plan(grid, 0.0, team)
    # what a cycle renews, and what few cycles need
    planner.plan(grid, 1.0, {**team, 'b': team['b']._replace(active=False)})
    find_frontiers(grid)
    cost = np.ones((3, 3), np.float32)
    connected_region(cost, 1, 1)
    lowest_cost(cost)
