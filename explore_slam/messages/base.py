"""Time, poses, transforms and covariances; the factory through which all messages are made."""

import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from explore_slam.errors import DataError
from explore_slam.geometry import (
    Array,
    Pose2,
    Quaternion,
    multiply_quaternions,
    quaternion_from_rotation,
    quaternion_from_yaw,
    rotation_matrix,
    yaw_from_quaternion,
)
from explore_slam.mounts import CameraMountConfig

# body frame (x forward, y left, z up) -> optical frame (x right, y down, z forward), REP-103
OPTICAL: Quaternion = (-0.5, 0.5, -0.5, 0.5)
# rows and columns of x, y and yaw in a 6 x 6 covariance (x, y, z, roll, pitch, yaw)
PLANAR = np.ix_([0, 1, 5], [0, 1, 5])
NANOSECONDS = 10**9  # in a second
# Lengths of quaternions that are taken as rotations: wide enough for any rounding, and narrow
# enough that the squares of what damaged messages hold do not overflow.
_SHORTEST_ROTATION, _LONGEST_ROTATION = 1e-6, 1e6


class MessageFactory(Protocol):
    """Makes messages of one middleware (rclpy or rosbags)."""

    def make(self, name: str, /, **fields: Any) -> Any:
        """Return a message of a type, e.g. 'sensor_msgs/LaserScan', with all its fields."""

    def sequence(self, values: NDArray[Any]) -> Any:
        """Return a numeric sequence in the type that this middleware stores."""


def seconds(stamp: Any) -> float:
    """Return a builtin_interfaces/Time in seconds."""
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def time_message(factory: MessageFactory, stamp: float) -> Any:
    """Return a time (s) as a builtin_interfaces/Time, rounded to the nanosecond."""
    nanoseconds = round(stamp * NANOSECONDS)
    return factory.make(
        'builtin_interfaces/Time',
        sec=nanoseconds // NANOSECONDS,
        nanosec=nanoseconds % NANOSECONDS,
    )


def header(factory: MessageFactory, stamp: float, frame: str) -> Any:
    """Return a std_msgs/Header."""
    return factory.make('std_msgs/Header', stamp=time_message(factory, stamp), frame_id=frame)


def planar_pose(pose: Any) -> Pose2:
    """Return the projection of a geometry_msgs/Pose onto the plane.

    The quaternion need not be of unit length; DataError if it is not a rotation.
    """
    q = pose.orientation
    values = (q.x, q.y, q.z, q.w)
    if not _SHORTEST_ROTATION < math.hypot(*values) < _LONGEST_ROTATION:  # nor NaN
        raise DataError(f'pose: orientation {values} is not a rotation')
    return Pose2(float(pose.position.x), float(pose.position.y), yaw_from_quaternion(*values))


def quaternion_message(factory: MessageFactory, quaternion: Quaternion) -> Any:
    """Return a geometry_msgs/Quaternion."""
    x, y, z, w = map(float, quaternion)
    return factory.make('geometry_msgs/Quaternion', x=x, y=y, z=z, w=w)


def pose_message(factory: MessageFactory, pose: Pose2, z: float = 0.0) -> Any:
    """Return a geometry_msgs/Pose."""
    return factory.make(
        'geometry_msgs/Pose',
        position=factory.make('geometry_msgs/Point', x=float(pose.x), y=float(pose.y), z=float(z)),
        orientation=quaternion_message(factory, quaternion_from_yaw(pose.theta)),
    )


def transform_message(
    factory: MessageFactory,
    stamp: float,
    frame: str,
    child: str,
    translation: tuple[float, float, float],
    rotation: Quaternion,
) -> Any:
    """Return a geometry_msgs/TransformStamped: the pose of the child frame in its parent."""
    x, y, z = map(float, translation)
    return factory.make(
        'geometry_msgs/TransformStamped',
        header=header(factory, stamp, frame),
        child_frame_id=child,
        transform=factory.make(
            'geometry_msgs/Transform',
            translation=factory.make('geometry_msgs/Vector3', x=x, y=y, z=z),
            rotation=quaternion_message(factory, rotation),
        ),
    )


def planar_transform_message(
    factory: MessageFactory, stamp: float, frame: str, child: str, pose: Pose2
) -> Any:
    """Return a geometry_msgs/TransformStamped of a pose in the plane."""
    rotation = quaternion_from_yaw(pose.theta)
    return transform_message(factory, stamp, frame, child, (pose.x, pose.y, 0.0), rotation)


def camera_transform_message(
    factory: MessageFactory, stamp: float, frame: str, child: str, mount: CameraMountConfig
) -> Any:
    """Return a geometry_msgs/TransformStamped of a camera's optical frame on a vehicle."""
    body = rotation_matrix(mount.camera_roll, mount.camera_pitch, mount.camera_yaw)
    rotation = multiply_quaternions(quaternion_from_rotation(body), OPTICAL)
    place = (mount.camera_x, mount.camera_y, mount.camera_z)
    return transform_message(factory, stamp, frame, child, place, rotation)


def planar_covariance(values: Any) -> Array:
    """Return the (3, 3) covariance of x, y, yaw of a 36 element covariance."""
    planar: Array = np.asarray(values, dtype=np.float64).reshape(6, 6)[PLANAR]
    return planar


def covariance_message(covariance: Array | None) -> Array:
    """Return a (3, 3) covariance of x, y, yaw as 36 values; None gives zeros (unknown)."""
    full = np.zeros((6, 6))
    if covariance is not None:
        full[PLANAR] = covariance
    return full.reshape(36)
