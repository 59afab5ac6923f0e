"""Landmarks as point clouds, and vehicles that see each other."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import DESCRIPTOR_LENGTH, InterRobotObservation, LandmarkObservations
from explore_slam.errors import DataError
from explore_slam.geometry import Pose2
from explore_slam.messages.base import MessageFactory, header, seconds
from explore_slam.messages.motion import estimate_message

FLOAT32, UINT8 = 7, 2
DESCRIPTOR_SCALE = 512.0
TRIANGLE = np.triu_indices(3)


def cloud_message(
    factory: MessageFactory,
    stamp: float,
    frame: str,
    columns: list[tuple[str, NDArray[Any]]],
) -> Any:
    """Return a sensor_msgs/PointCloud2 of named columns (N,) or (N, C), float32 or uint8."""
    count = len(columns[0][1])
    fields, parts, offset = [], [], 0
    for name, values in columns:
        width = int(np.prod(np.shape(values)[1:]))
        block = np.ascontiguousarray(values).reshape(count, width)
        kind = UINT8 if block.dtype == np.uint8 else FLOAT32
        if kind == FLOAT32:
            block = block.astype('<f4')
        fields.append(
            factory.make(
                'sensor_msgs/PointField',
                name=name,
                offset=offset,
                datatype=kind,
                count=block.shape[1],
            )
        )
        parts.append(block.view(np.uint8).reshape(count, block.itemsize * block.shape[1]))
        offset += block.itemsize * block.shape[1]
    data = np.concatenate(parts, axis=1) if count else np.empty(0, np.uint8)
    return factory.make(
        'sensor_msgs/PointCloud2',
        header=header(factory, stamp, frame),
        height=1,
        width=count,
        fields=fields,
        is_bigendian=False,
        point_step=offset,
        row_step=offset * count,
        data=factory.sequence(data.reshape(-1)),
        is_dense=True,
    )


def cloud_columns(message: Any) -> dict[str, NDArray[Any]]:
    """Return the float32 and uint8 fields of a PointCloud2, each as (N, count)."""
    count, step = int(message.width) * int(message.height), int(message.point_step)
    data = np.frombuffer(message.data, np.uint8)
    if data.size < count * step:
        raise DataError(f'point cloud: {data.size} bytes, expected {count} points of {step} bytes')
    rows = data[: count * step].reshape(count, step)
    order = '>' if message.is_bigendian else '<'
    columns: dict[str, NDArray[Any]] = {}
    for item in message.fields:
        dtype = {FLOAT32: np.dtype(order + 'f4'), UINT8: np.dtype('u1')}.get(int(item.datatype))
        if dtype is None:
            continue
        size = dtype.itemsize * int(item.count)
        block = np.ascontiguousarray(rows[:, item.offset : item.offset + size])
        if block.shape[1] != size:
            raise DataError(f'point cloud: field {item.name!r} lies outside of the point step')
        columns[item.name] = block.view(dtype).reshape(count, int(item.count))
    return columns


def landmarks_message(
    factory: MessageFactory, observations: LandmarkObservations, frame: str, compact: bool = False
) -> Any:
    """Return observations as a PointCloud2; compact sends descriptors as 128 bytes."""
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
    """Return a PointCloud2 with x, y, z, covariance (6), descriptor (128) as observations."""
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


def sighting_record(message: Any) -> InterRobotObservation:
    """Return a PoseWithCovarianceStamped whose frame names the vehicle seen, '<seen>/base_link'.

    The pose is that of the seen vehicle in the frame of the vehicle that sees (its namespace).
    """
    position = message.pose.pose.position
    covariance = np.asarray(message.pose.covariance, dtype=np.float64).reshape(6, 6)[:2, :2]
    return InterRobotObservation(
        seconds(message.header.stamp),
        message.header.frame_id.split('/')[0],
        np.array([position.x, position.y], dtype=np.float64),
        covariance.copy(),
    )


def sighting_message(factory: MessageFactory, sighting: InterRobotObservation) -> Any:
    """Return a sighting as a PoseWithCovarianceStamped; see sighting_record."""
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = sighting.covariance
    pose = Pose2(float(sighting.position[0]), float(sighting.position[1]), 0.0)
    frame = f'{sighting.vehicle}/base_link'
    return estimate_message(factory, sighting.stamp, frame, pose, covariance)
