"""Landmark observations as point clouds."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import DESCRIPTOR_LENGTH, LandmarkObservations
from explore_slam.errors import DataError
from explore_slam.messages.base import MessageFactory, seconds
from explore_slam.messages.clouds import cloud_columns, cloud_message
from explore_slam.messages.measurement import MeasurementKind, MessageReader
from explore_slam.messages.topics import TopicKind

# the factor by which OpenCV scales SIFT descriptors of unit length to bytes
DESCRIPTOR_SCALE = 512.0
TRIANGLE = np.triu_indices(3)  # the six elements of a covariance that are sent


def landmarks_message(
    factory: MessageFactory, observations: LandmarkObservations, frame: str, compact: bool = False
) -> Any:
    """Return observations as a sensor_msgs/PointCloud2.

    compact: store descriptors as 128 bytes instead of 128 float32 values.
    """
    descriptors: NDArray[Any] = observations.descriptors
    if compact:
        scaled = np.rint(descriptors * DESCRIPTOR_SCALE)
        descriptors = np.clip(scaled, 0, 255).astype(np.uint8)
    rows, columns = TRIANGLE
    axes = [(name, observations.positions[:, axis]) for axis, name in enumerate('xyz')]
    covariance = ('covariance', observations.covariances[:, rows, columns])
    return cloud_message(
        factory, observations.stamp, frame, [*axes, covariance, ('descriptor', descriptors)]
    )


def landmarks_record(message: Any) -> LandmarkObservations:
    """Return the observations in a sensor_msgs/PointCloud2 with the fields of landmarks_message.

    Fields: x, y, z (m), covariance (6, upper triangle, m²), descriptor (128). DataError where one
    is missing or has another length.
    """
    columns = cloud_columns(message)
    wanted = {'x': 1, 'y': 1, 'z': 1, 'covariance': 6, 'descriptor': DESCRIPTOR_LENGTH}
    for name, length in wanted.items():
        found = columns[name].shape[1] if name in columns else 0
        if found != length:
            raise DataError(f'landmarks: field {name!r} has {found} values, expected {length}')
    count = len(columns['x'])
    covariances = np.zeros((count, 3, 3))
    rows, cols = TRIANGLE
    covariances[:, rows, cols] = columns['covariance']
    covariances[:, cols, rows] = columns['covariance']
    descriptors = columns['descriptor'].astype(np.float32)
    norms = np.linalg.norm(descriptors, axis=1, keepdims=True)
    if (norms == 0).any():
        raise DataError('landmarks: a descriptor is all zero, expected unit length')
    positions = np.concatenate([columns[axis] for axis in 'xyz'], axis=1).astype(np.float64)
    return LandmarkObservations(
        seconds(message.header.stamp), positions, covariances, descriptors / norms
    )


LANDMARKS = MeasurementKind(
    name='landmarks',
    topics=(TopicKind.LANDMARKS,),
    reader=lambda: MessageReader(landmarks_record),
    write=lambda factory, frames, observations: [
        (TopicKind.LANDMARKS, landmarks_message(factory, observations, frames.base))
    ],
    queue_limit=20,
    expected=(TopicKind.LANDMARKS,),
    vision='vehicle',
)
