"""Publishers of the occupancy grid: `map`, `map_probability` and `map_updates`.

`map` has the values of map_server (0, 100, -1), which nav2 compares with. What has changed since
then is published on `map_updates`, where map_msgs is installed and the topic has subscribers. Each
update covers all changes since the last `map`: a subscriber that has just received the latched
`map` is up to date with the next update.
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
    """All publishers of the grid; remembers what it published last, as `map` and as update."""

    def __init__(self, node: Node) -> None:
        self._map = publisher(node, TeamTopic.MAP)
        self._probability = publisher(node, TeamTopic.MAP_PROBABILITY)
        self._updates: Publisher | None = None
        with contextlib.suppress(ImportError):  # map_msgs is not part of every installation
            self._updates = publisher(node, TeamTopic.MAP_UPDATES)
        self._geometry: _Geometry | None = None
        self._cells: NDArray[np.int8] = np.empty((0, 0), np.int8)  # of the last `map`
        self._updated = self._cells  # of the last `map` or update
        self._rectangle: tuple[slice, slice] | None = None  # updated since the last `map`

    def publish(self, stamp: float, frame: str, grid: OccupancyGrid) -> None:
        """Publish the whole map; nothing before there is one."""
        if 0 in grid.shape:
            return
        self._cells, self._geometry = grid.to_trinary(), _geometry_of(grid)
        self._updated, self._rectangle = self._cells, None
        self._map.publish(_message(stamp, frame, grid, self._cells))
        self._probability.publish(_message(stamp, frame, grid, grid.to_percent()))

    @property
    def wants_updates(self) -> bool:
        """Whether `map_updates` has subscribers."""
        return self._updates is not None and self._updates.get_subscription_count() > 0

    def publish_update(self, stamp: float, frame: str, grid: OccupancyGrid) -> None:
        """Publish the rectangle that has changed since `publish`, if anything is new in it.

        A map of another extent waits for `publish`.
        """
        if self._updates is None or _geometry_of(grid) != self._geometry:
            return
        cells = grid.to_trinary()
        if np.array_equal(cells, self._updated):
            return
        # a cell that is again as in `map` must be sent to those who received an update of it
        self._rectangle = _hull(self._rectangle, changed_rectangle(self._cells, cells))
        self._updated = cells
        rows, columns = self._rectangle
        self._updates.publish(
            grid_update_message(
                MESSAGES, stamp, frame, (columns.start, rows.start), cells[rows, columns]
            )
        )


def _hull(
    before: tuple[slice, slice] | None, after: tuple[slice, slice] | None
) -> tuple[slice, slice]:
    """Return the smallest rectangle of rows and columns that holds both; None: an empty one."""
    known = [rectangle for rectangle in (before, after) if rectangle is not None]
    rows, columns = zip(*known, strict=True)
    return _span(rows), _span(columns)


def _span(parts: tuple[slice, ...]) -> slice:
    return slice(min(part.start for part in parts), max(part.stop for part in parts))


def map_message(stamp: float, frame: str, grid: OccupancyGrid) -> Any:
    """Return a nav_msgs/OccupancyGrid with the values that `map` has."""
    return _message(stamp, frame, grid, grid.to_trinary())


def _message(stamp: float, frame: str, grid: OccupancyGrid, cells: NDArray[np.int8]) -> Any:
    return grid_message(MESSAGES, stamp, frame, cells, grid.resolution, grid.origin)


def _geometry_of(grid: OccupancyGrid) -> _Geometry:
    return grid.resolution, grid.origin, grid.shape
