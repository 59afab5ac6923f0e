"""The area that vehicles can reach, and the fraction of it that a map covers."""

import copy
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from explore_slam.agent import OperatorAreas
from explore_slam.errors import EvaluationError
from explore_slam.geometry import Array, Pose2
from explore_slam.simulation.config import SimulatedBaseConfig
from explore_slam.simulation.worlds.grid_world import GridWorld
from explore_slam.simulation.worlds.loading import load_grid_world


class ReachableArea:
    """Free cells of a world that a disc of this radius (m) can cover from the start poses.

    A map compared with it must be in the frame of the world: start poses are known.
    """

    def __init__(self, world: GridWorld, starts: Iterable[Pose2], radius: float) -> None:
        points = np.array([[pose.x, pose.y] for pose in starts])
        if points.size == 0:
            raise EvaluationError('reachable area: no start pose, expected at least one')
        mask = world.reachable(points, radius)
        if not mask.any():
            raise EvaluationError(
                f'reachable area: no free space around the start poses {points.tolist()}'
            )
        self.cells: Array = world.to_point(np.argwhere(mask))
        self._cell_area = world.resolution**2

    @classmethod
    def of_file(cls, path: Path, starts: Iterable[Pose2], radius: float) -> 'ReachableArea':
        """Read a world file or a map_server map; no vehicle gets below low boards or into pits."""
        height = SimulatedBaseConfig().simulated_height
        return cls(load_grid_world(path, height=height), starts, radius)

    @property
    def area(self) -> float:
        """Size (m²)."""
        return len(self.cells) * self._cell_area

    def without(self, areas: OperatorAreas) -> 'ReachableArea':
        """Return what is left of the area where the operator wants vehicles to be."""
        left = copy.copy(self)
        left.cells = self.cells[~areas.exclude(self.cells)]
        return left

    def explored_fraction(
        self, known: NDArray[np.bool_], resolution: float, origin: tuple[float, float]
    ) -> float:
        """Return the fraction (0 to 1) of the reachable cells that are known in a map.

        known (H, W): cells whose occupancy is known; resolution (m); origin: corner (m) of cell
        [0, 0]. Of an area without cells all is explored.
        """
        if not len(self.cells):
            return 1.0
        index = np.floor((self.cells - np.asarray(origin)) / resolution).astype(np.int64)
        columns, rows = index[:, 0], index[:, 1]
        height, width = known.shape
        inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        found = np.zeros(len(index), np.bool_)
        found[inside] = known[rows[inside], columns[inside]]
        return float(found.mean())
