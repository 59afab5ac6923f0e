"""Occupancy grids."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from explore_slam.errors import DataError
from explore_slam.geometry import Pose2
from explore_slam.messages.base import (
    MessageFactory,
    header,
    pose_message,
    time_message,
)


def grid_message(
    factory: MessageFactory,
    stamp: float,
    frame: str,
    occupancy: NDArray[np.int8],
    resolution: float,
    origin: tuple[float, float],
) -> Any:
    """Return a nav_msgs/OccupancyGrid.

    occupancy: cells (H, W): -1 unknown, 0 free to 100 occupied; AMCL and nav2's StaticLayer read
    0, 100 and -1 alone.
    resolution: side of a cell (m).
    origin: lower left corner (m) of cell [0, 0].
    """
    height, width = occupancy.shape
    return factory.make(
        'nav_msgs/OccupancyGrid',
        header=header(factory, stamp, frame),
        info=factory.make(
            'nav_msgs/MapMetaData',
            map_load_time=time_message(factory, stamp),
            resolution=float(resolution),
            width=int(width),
            height=int(height),
            origin=pose_message(factory, Pose2(origin[0], origin[1], 0.0)),
        ),
        data=factory.sequence(occupancy.astype(np.int8, copy=False).reshape(-1)),
    )


def changed_rectangle(
    before: NDArray[np.int8], after: NDArray[np.int8]
) -> tuple[slice, slice] | None:
    """Return rows and columns of the smallest rectangle that holds all changes; None without any.

    before, after: cells (H, W) of grids of the same extent.
    """
    changed = before != after
    rows, columns = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
    if not len(rows):
        return None
    return (
        slice(int(rows[0]), int(rows[-1]) + 1),
        slice(int(columns[0]), int(columns[-1]) + 1),
    )


def grid_update_message(
    factory: MessageFactory,
    stamp: float,
    frame: str,
    corner: tuple[int, int],
    occupancy: NDArray[np.int8],
) -> Any:
    """Return a map_msgs/OccupancyGridUpdate of the cells (H, W) of a rectangle.

    corner: column and row of its first cell in the grid that it updates.
    """
    height, width = occupancy.shape
    cells = np.ascontiguousarray(occupancy, np.int8).reshape(-1)
    return factory.make(
        'map_msgs/OccupancyGridUpdate',
        header=header(factory, stamp, frame),
        x=corner[0],
        y=corner[1],
        width=int(width),
        height=int(height),
        data=factory.sequence(cells),
    )


def grid_arrays(message: Any) -> tuple[NDArray[np.int8], float, tuple[float, float]]:
    """Return cells (H, W), resolution (m) and origin (x, y) m of a nav_msgs/OccupancyGrid."""
    info = message.info
    cells = np.frombuffer(message.data, np.int8)
    if cells.size != info.width * info.height:
        raise DataError(
            f'grid: {cells.size} cells, expected {info.width} x {info.height} by its info'
        )
    origin = (float(info.origin.position.x), float(info.origin.position.y))
    return cells.reshape(info.height, info.width), float(info.resolution), origin
