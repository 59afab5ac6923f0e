"""Landmark observations as point clouds."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import LandmarkObservations
from explore_slam.errors import DataError
from explore_slam.messages.base import MessageFactory, seconds
from explore_slam.messages.clouds import cloud_columns, cloud_message
from explore_slam.messages.measurement import MeasurementKind, MessageReader
from explore_slam.messages.topics import TopicKind

# the factor by which OpenCV scales SIFT descriptors of unit length to bytes
DESCRIPTOR_SCALE = 512.0
FIELD, BINARY_FIELD = 'descriptor', 'binary_descriptor'
DELAY_FIELD = 'delay'  # s, optional
TRIANGLE = np.triu_indices(3)  # the six elements of a covariance that are sent


def landmarks_message(
    factory: MessageFactory, observations: LandmarkObservations, frame: str, compact: bool = False
) -> Any:
    """Return observations as a sensor_msgs/PointCloud2.

    Where delays are known, they are the field `delay` (s). Descriptors of numbers (unit vectors)
    are the field `descriptor`, those of bits (uint8) the field `binary_descriptor`.

    compact: store descriptors of numbers as bytes instead of float32 values.
    """
    descriptors: NDArray[Any] = observations.descriptors
    binary = descriptors.dtype == np.uint8
    if compact and not binary:
        scaled = np.rint(descriptors * DESCRIPTOR_SCALE)
        descriptors = np.clip(scaled, 0, 255).astype(np.uint8)
    rows, columns = TRIANGLE
    axes = [(name, observations.positions[:, axis]) for axis, name in enumerate('xyz')]
    covariance = ('covariance', observations.covariances[:, rows, columns])
    described = (BINARY_FIELD if binary else FIELD, descriptors)
    delays = [] if observations.delays is None else [(DELAY_FIELD, observations.delays)]
    fields = [*axes, covariance, described, *delays]
    return cloud_message(factory, observations.stamp, frame, fields)


def landmarks_record(message: Any) -> LandmarkObservations:
    """Return the observations in a sensor_msgs/PointCloud2 with the fields of landmarks_message.

    Fields: x, y, z (m), covariance (6, upper triangle, m²), and descriptor or binary_descriptor
    of any length; the filter checks that it fits its kind of descriptors. Optional: delay (s).
    DataError where a field is missing or has another length.
    """
    columns = cloud_columns(message)
    for name, length in {'x': 1, 'y': 1, 'z': 1, 'covariance': 6}.items():
        found = columns[name].shape[1] if name in columns else 0
        if found != length:
            raise DataError(f'landmarks: field {name!r} has {found} values, expected {length}')
    count = len(columns['x'])
    covariances = np.zeros((count, 3, 3))
    rows, cols = TRIANGLE
    covariances[:, rows, cols] = columns['covariance']
    covariances[:, cols, rows] = columns['covariance']
    positions = np.concatenate([columns[axis] for axis in 'xyz'], axis=1).astype(np.float64)
    return LandmarkObservations(
        seconds(message.header.stamp),
        positions,
        covariances,
        _descriptors(columns),
        _delays(columns),
    )


def _delays(columns: dict[str, NDArray[Any]]) -> NDArray[np.float64] | None:
    if DELAY_FIELD not in columns:
        return None
    delays = columns[DELAY_FIELD]
    if delays.shape[1] != 1:
        raise DataError(
            f'landmarks: field {DELAY_FIELD!r} has {delays.shape[1]} values, expected 1'
        )
    return delays[:, 0].astype(np.float64)


def _descriptors(columns: dict[str, NDArray[Any]]) -> NDArray[Any]:
    if BINARY_FIELD in columns:
        bits = columns[BINARY_FIELD]
        if bits.dtype != np.uint8:
            raise DataError(f'landmarks: field {BINARY_FIELD!r} is {bits.dtype}, expected uint8')
        return bits
    if FIELD not in columns:
        raise DataError(
            f'landmarks: neither field {FIELD!r} nor {BINARY_FIELD!r}, expected one of them'
        )
    descriptors = columns[FIELD].astype(np.float32)
    norms = np.linalg.norm(descriptors, axis=1, keepdims=True)
    if (norms == 0).any():
        raise DataError('landmarks: a descriptor is all zero, expected unit length')
    return descriptors / norms


LANDMARKS = MeasurementKind(
    name='landmarks',
    topics=(TopicKind.LANDMARKS,),
    reader=lambda _mounts, _sensor: MessageReader(landmarks_record),
    write=lambda factory, frames, observations: [
        (TopicKind.LANDMARKS, landmarks_message(factory, observations, frames.base))
    ],
    queue_limit=20,
    expected=(TopicKind.LANDMARKS,),
    vision='vehicle',
)
