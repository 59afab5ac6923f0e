"""Views of obstacles as point clouds."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import HOLE_BIT, OBSTACLE_CELL, SLICE_HEIGHT, ObstacleView
from explore_slam.errors import DataError
from explore_slam.messages.base import MessageFactory, seconds
from explore_slam.messages.clouds import cloud_columns, cloud_message
from explore_slam.messages.measurement import MeasurementKind, MessageReader
from explore_slam.messages.topics import TopicKind

_FARTHEST = 32767  # cells, the limit of their numbers


def obstacles_message(factory: MessageFactory, view: ObstacleView, frame: str) -> Any:
    """Return a view as a sensor_msgs/PointCloud2 in the frame of the vehicle's base.

    Fields: x, y (m), centres of cells; z (m), the middle of the lowest slice of height that is
    occupied, half a slice below the floor at a step, NaN where none is, so that viewers show
    obstacles alone; occupied and free, two bytes each, the lower one first.
    """
    points = view.points
    columns: list[tuple[str, NDArray[Any]]] = [
        ('x', points[:, 0]),
        ('y', points[:, 1]),
        ('z', _lowest(view.occupied)),
        ('occupied', view.occupied.astype('<u2').view(np.uint8).reshape(-1, 2)),
        ('free', view.free.astype('<u2').view(np.uint8).reshape(-1, 2)),
    ]
    return cloud_message(factory, view.stamp, frame, columns)


def _lowest(occupied: NDArray[np.uint16]) -> NDArray[np.float32]:
    """Return the middle (N,) m of the lowest slice that is occupied."""
    heights = np.full(len(occupied), np.nan, np.float32)
    for piece in reversed(range(HOLE_BIT)):
        heights[(occupied >> piece & 1) > 0] = (piece + 0.5) * SLICE_HEIGHT
    heights[occupied >> HOLE_BIT > 0] = -0.5 * SLICE_HEIGHT
    return heights


def obstacles_record(message: Any) -> ObstacleView:
    """Return the view in a sensor_msgs/PointCloud2 with the fields of obstacles_message.

    DataError where a field is missing or has another length, and for points that are too far out.
    """
    columns = cloud_columns(message)
    for name, length in {'x': 1, 'y': 1, 'occupied': 2, 'free': 2}.items():
        found = columns[name].shape[1] if name in columns else 0
        if found != length:
            raise DataError(f'obstacles: field {name!r} has {found} values, expected {length}')
    places = np.concatenate([columns['x'], columns['y']], axis=1).astype(np.float64)
    cells = np.floor(places / OBSTACLE_CELL)
    if not np.isfinite(cells).all() or np.abs(cells).max(initial=0.0) > _FARTHEST:
        raise DataError(
            f'obstacles: x, y hold values that are not finite or farther than '
            f'{_FARTHEST * OBSTACLE_CELL:.0f} m'
        )
    bits: list[NDArray[np.uint16]] = []
    for name in ('occupied', 'free'):
        if columns[name].dtype != np.uint8:
            raise DataError(f'obstacles: field {name!r} is {columns[name].dtype}, expected uint8')
        pairs = np.ascontiguousarray(columns[name])
        bits.append(pairs.view('<u2')[:, 0].astype(np.uint16))
    stamp = seconds(message.header.stamp)
    occupied, free = bits
    return ObstacleView(stamp, cells.astype(np.int16), occupied, free & ~occupied)


OBSTACLES = MeasurementKind(
    name='obstacles',
    topics=(TopicKind.OBSTACLES,),
    reader=lambda _mounts, _sensor: MessageReader(obstacles_record),
    write=lambda factory, frames, view: [
        (TopicKind.OBSTACLES, obstacles_message(factory, view, frames.base))
    ],
    queue_limit=20,
    vision='vehicle',
    exclusive=True,
)
