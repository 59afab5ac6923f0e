"""Tags that a vehicle has seen, as point clouds."""

from typing import Any

import numpy as np

from explore_slam.data import TagObservations
from explore_slam.errors import DataError
from explore_slam.messages.base import MessageFactory, seconds
from explore_slam.messages.clouds import cloud_columns, cloud_message
from explore_slam.messages.measurement import MeasurementKind, MessageReader
from explore_slam.messages.topics import TopicKind

TRIANGLE = np.triu_indices(3)  # the six elements of a covariance that are sent
_LENGTHS = {'x': 1, 'y': 1, 'yaw': 1, 'covariance': 6, 'id': 1}


def tags_message(factory: MessageFactory, observations: TagObservations, frame: str) -> Any:
    """Return tags as a sensor_msgs/PointCloud2, a point for each.

    Fields, all float32: x, y (m), yaw (rad), covariance (6, upper triangle), id. Numbers of tags
    are below 2²⁴ and thus exact.
    """
    rows, columns = TRIANGLE
    axes = [(name, observations.poses[:, axis]) for axis, name in enumerate(('x', 'y', 'yaw'))]
    covariance = ('covariance', observations.covariances[:, rows, columns])
    named = [*axes, covariance, ('id', observations.ids)]
    return cloud_message(factory, observations.stamp, frame, named)


def tags_record(message: Any) -> TagObservations:
    """Return the tags in a sensor_msgs/PointCloud2 with the fields of tags_message.

    DataError where a field is missing or has another length, and for a tag that is there twice.
    """
    columns = cloud_columns(message)
    for name, length in _LENGTHS.items():
        found = columns[name].shape[1] if name in columns else 0
        if found != length:
            raise DataError(f'tags: field {name!r} has {found} values, expected {length}')
    numbers = columns['id'].ravel().astype(np.float64)
    if not (np.isfinite(numbers) & (numbers >= 0.0) & (numbers == np.rint(numbers))).all():
        raise DataError(f'tags: ids are {numbers.tolist()}, expected whole numbers from 0')
    count = len(numbers)
    covariances = np.zeros((count, 3, 3))
    rows, cols = TRIANGLE
    covariances[:, rows, cols] = columns['covariance']
    covariances[:, cols, rows] = columns['covariance']
    poses = np.concatenate([columns[axis] for axis in ('x', 'y', 'yaw')], axis=1)
    return TagObservations(
        seconds(message.header.stamp),
        numbers.astype(np.int64),
        poses.astype(np.float64),
        covariances,
    )


TAGS = MeasurementKind(
    name='tags',
    topics=(TopicKind.TAGS,),
    reader=lambda _mounts, _sensor: MessageReader(tags_record),
    write=lambda factory, frames, observations: [
        (TopicKind.TAGS, tags_message(factory, observations, frames.base))
    ],
    queue_limit=20,
)
