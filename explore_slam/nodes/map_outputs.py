"""Publishers of the occupancy grid: `map`, `map_probability` and `map_updates`.

`map` has the values of map_server (0, 100, -1), which nav2 compares with. What has changed since
then is published on `map_updates`, where map_msgs is installed and the topic has subscribers.
"""

import contextlib
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.publisher import Publisher

from explore_slam.mapping import OccupancyGrid
from explore_slam.messages.maps import changed_rectangle, grid_message, grid_update_message
from explore_slam.messages.topics import TeamTopic
from explore_slam.nodes.endpoints import publisher
from explore_slam.nodes.ros_types import MESSAGES

_Geometry = tuple[float, tuple[float, float], tuple[int, int]]  # resolution, origin, shape


class MapOutputs:
    """All publishers of the grid; remembers what receivers of `map` and `map_updates` have."""

    def __init__(self, node: Node) -> None:
        self._map = publisher(node, TeamTopic.MAP)
        self._probability = publisher(node, TeamTopic.MAP_PROBABILITY)
        self._updates: Publisher | None = None
        with contextlib.suppress(ImportError):  # map_msgs is not part of every installation
            self._updates = publisher(node, TeamTopic.MAP_UPDATES)
        self._geometry: _Geometry | None = None
        self._cells: NDArray[np.int8] = np.empty((0, 0), np.int8)

    def publish(self, stamp: float, frame: str, grid: OccupancyGrid) -> None:
        """Publish the whole map."""
        self._cells, self._geometry = grid.to_trinary(), _geometry_of(grid)
        self._map.publish(_message(stamp, frame, grid, self._cells))
        self._probability.publish(_message(stamp, frame, grid, grid.to_percent()))

    @property
    def wants_updates(self) -> bool:
        """Whether `map_updates` has subscribers."""
        return self._updates is not None and self._updates.get_subscription_count() > 0

    def publish_update(self, stamp: float, frame: str, grid: OccupancyGrid) -> None:
        """Publish the rectangle that has changed; a map of another extent waits for `publish`."""
        if self._updates is None or _geometry_of(grid) != self._geometry:
            return
        cells = grid.to_trinary()
        changed = changed_rectangle(self._cells, cells)
        if changed is None:
            return
        self._cells = cells
        rows, columns = changed
        self._updates.publish(
            grid_update_message(
                MESSAGES, stamp, frame, (columns.start, rows.start), cells[rows, columns]
            )
        )


def map_message(stamp: float, frame: str, grid: OccupancyGrid) -> Any:
    """Return a nav_msgs/OccupancyGrid with the values that `map` has."""
    return _message(stamp, frame, grid, grid.to_trinary())


def _message(stamp: float, frame: str, grid: OccupancyGrid, cells: NDArray[np.int8]) -> Any:
    return grid_message(MESSAGES, stamp, frame, cells, grid.resolution, grid.origin)


def _geometry_of(grid: OccupancyGrid) -> _Geometry:
    return grid.resolution, grid.origin, grid.shape
