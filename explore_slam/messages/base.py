"""Time, poses and covariances; the factory that all writing goes through."""

import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from explore_slam.errors import DataError
from explore_slam.geometry import Array, Pose2

# rows and columns of x, y and yaw in a 6 x 6 covariance (x, y, z, roll, pitch, yaw)
PLANAR = np.ix_([0, 1, 5], [0, 1, 5])


class MessageFactory(Protocol):
    """Makes messages of one middleware (rclpy or rosbags)."""

    def make(self, name: str, /, **fields: Any) -> Any:
        """Return a message of the type, e.g. 'sensor_msgs/LaserScan', with all its fields."""

    def sequence(self, values: NDArray[Any]) -> Any:
        """Return a numeric sequence as this middleware wants it."""


def seconds(stamp: Any) -> float:
    """Return a builtin_interfaces/Time as seconds."""
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def time_message(factory: MessageFactory, stamp: float) -> Any:
    """Return seconds as a builtin_interfaces/Time, rounded to the nanosecond."""
    nanoseconds = round(stamp * 1e9)
    return factory.make(
        'builtin_interfaces/Time', sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9
    )


def header(factory: MessageFactory, stamp: float, frame: str) -> Any:
    """Return a std_msgs/Header."""
    return factory.make('std_msgs/Header', stamp=time_message(factory, stamp), frame_id=frame)


def planar_pose(pose: Any) -> Pose2:
    """Return a geometry_msgs/Pose seen from above; the quaternion need not be of unit length."""
    q = pose.orientation
    if not all(map(math.isfinite, (q.x, q.y, q.z, q.w))) or q.x**2 + q.y**2 + q.z**2 + q.w**2 == 0:
        raise DataError(f'pose: orientation ({q.x}, {q.y}, {q.z}, {q.w}) is no rotation')
    yaw = math.atan2(2 * (q.w * q.z + q.x * q.y), q.w**2 + q.x**2 - q.y**2 - q.z**2)
    return Pose2(float(pose.position.x), float(pose.position.y), yaw)


def pose_message(factory: MessageFactory, pose: Pose2, z: float = 0.0) -> Any:
    """Return a geometry_msgs/Pose."""
    half = 0.5 * float(pose.theta)
    return factory.make(
        'geometry_msgs/Pose',
        position=factory.make('geometry_msgs/Point', x=float(pose.x), y=float(pose.y), z=float(z)),
        orientation=factory.make(
            'geometry_msgs/Quaternion', x=0.0, y=0.0, z=math.sin(half), w=math.cos(half)
        ),
    )


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
