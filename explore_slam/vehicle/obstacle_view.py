"""What the cameras of a vehicle see around it: obstacles in their newest views, now.

A camera sees nothing close by, and nothing of what it has passed. The view therefore remembers
what the camera saw until it looks through there again.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from explore_slam.data import OBSTACLE_CELL, ObstacleView
from explore_slam.geometry import Array, Pose2, to_world
from explore_slam.vehicle.dead_reckoning import DeadReckoning

# s for which an obstacle out of sight is remembered; plans keep clear of what is in the map
_MEMORY = 10.0
# s by which views of several cameras may arrive in another order than they were taken
_DISORDER = 0.5
_NEAR = 2.0  # m from the vehicle; it stops within much less
_SAME = 0.1  # m from a return of the laser: one and the same wall, which the laser measures better
_SPAN = 65536  # more than the cells of a view across


class CameraView:
    """The obstacles that a vehicle has seen lately, in the vehicle frame at any time.

    reckoning: odometry of the vehicle, which grows while views arrive.
    """

    def __init__(self, reckoning: DeadReckoning) -> None:
        self._reckoning = reckoning
        self._points: Array = np.empty((0, 2))  # in the odometry frame
        self._stamps: Array = np.empty(0)
        self._newest = -np.inf
        self._recent: list[ObstacleView] = []

    def add(self, view: ObstacleView) -> None:
        """Take a view; an old one, or one known, changes nothing, unless the clock has gone back.

        Several cameras may have taken views at one moment.
        """
        if view.stamp <= self._newest - _MEMORY:
            self._newest, self._recent = -np.inf, []
            self._points, self._stamps = np.empty((0, 2)), np.empty(0)
        if view.stamp < self._newest - _DISORDER or self._knows(view):
            return
        self._newest = max(self._newest, view.stamp)
        self._recent = [one for one in self._recent if one.stamp >= self._newest - _DISORDER]
        self._recent.append(view)
        pose = self._reckoning.odometry_at(view.stamp)
        free = view.cells[(view.free != 0) & (view.occupied == 0)]
        kept = (self._newest - self._stamps < _MEMORY) & ~_in_cells(pose, self._points, free)
        new = to_world(pose, view.points[view.occupied != 0])
        self._points = np.concatenate([self._points[kept], new])
        self._stamps = np.append(self._stamps[kept], np.full(len(new), view.stamp))

    def _knows(self, view: ObstacleView) -> bool:
        return any(
            one.stamp == view.stamp
            and np.array_equal(one.cells, view.cells)
            and np.array_equal(one.occupied, view.occupied)
            for one in self._recent
        )

    def points(self, now: float, returns: Array) -> Array:
        """Return the obstacles nearby (N, 2) m, in the vehicle frame at a time (s).

        returns (R, 2) m: of the laser; obstacles that it sees as well are left out.
        """
        points = to_world(self._reckoning.odometry_at(now).inverse(), self._points)
        near: Array = points[np.hypot(points[:, 0], points[:, 1]) < _NEAR]
        if not len(near) or not len(returns):
            return near
        cells = np.floor(near / OBSTACLE_CELL).astype(np.int64)
        _, first = np.unique(cells[:, 0] * _SPAN + cells[:, 1], return_index=True)
        distinct: Array = OBSTACLE_CELL * cells[first].astype(np.float64) + 0.5 * OBSTACLE_CELL
        close = returns[np.hypot(returns[:, 0], returns[:, 1]) < _NEAR + _SAME]
        if not len(close):
            return distinct
        apart, _ = cKDTree(close).query(distinct, distance_upper_bound=2.0 * _SAME)
        beyond: Array = distinct[apart > _SAME]
        return beyond


def _in_cells(pose: Pose2, points: Array, cells: NDArray[np.int16]) -> NDArray[np.bool_]:
    """Return which points (N, 2) lie in cells (M, 2) of the frame of a pose."""
    own = np.floor(to_world(pose.inverse(), points) / OBSTACLE_CELL).astype(np.int64)
    wide = cells.astype(np.int64)
    return np.isin(own[:, 0] * _SPAN + own[:, 1], wide[:, 0] * _SPAN + wide[:, 1])
