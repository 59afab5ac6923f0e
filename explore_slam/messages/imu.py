"""Angular velocities of an IMU."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from explore_slam.data import ImuReading
from explore_slam.errors import DataError
from explore_slam.geometry import Array
from explore_slam.messages.base import MessageFactory, header, seconds
from explore_slam.messages.measurement import MeasurementKind
from explore_slam.messages.sensor_mounts import SensorMounts
from explore_slam.messages.topics import TopicKind


def imu_record(message: Any, rotation: Array | None = None) -> ImuReading:
    """Return the angular velocity in a sensor_msgs/Imu, in the vehicle frame.

    rotation (3, 3): of the IMU in the vehicle frame. DataError if there is no angular velocity.
    """
    if float(message.angular_velocity_covariance[0]) == -1.0:
        raise DataError(
            'Imu: angular_velocity_covariance[0] is -1: the message holds no angular velocity'
        )
    given = message.angular_velocity
    rates = np.array([float(given.x), float(given.y), float(given.z)])
    if rotation is not None and np.isfinite(rates).all():
        rates = rotation @ rates
    x, y, z = rates.tolist()
    return ImuReading(seconds(message.header.stamp), (x, y, z))


def imu_message(factory: MessageFactory, reading: ImuReading, frame: str) -> Any:
    """Return a sensor_msgs/Imu with an angular velocity alone."""
    unknown = np.zeros(9)
    unknown[0] = -1.0  # no orientation, no acceleration
    x, y, z = map(float, reading.angular_velocity)
    zero = {'x': 0.0, 'y': 0.0, 'z': 0.0}
    return factory.make(
        'sensor_msgs/Imu',
        header=header(factory, reading.stamp, frame),
        orientation=factory.make('geometry_msgs/Quaternion', x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=unknown,
        angular_velocity=factory.make('geometry_msgs/Vector3', x=x, y=y, z=z),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=factory.make('geometry_msgs/Vector3', **zero),
        linear_acceleration_covariance=unknown.copy(),
    )


class ImuReader:
    """Converts the messages of a vehicle's IMU, whose mount turns its axes."""

    def __init__(self, mounts: SensorMounts | None, _sensor: str = '') -> None:
        self._mounts = mounts

    def read(self, _topic: TopicKind, message: Any) -> ImuReading:
        """Return the angular velocity; DataError if the message is malformed."""
        if self._mounts is None:
            return imu_record(message)
        return imu_record(message, self._mounts.imu_rotation(message.header.frame_id))

    def losses(self) -> Mapping[str, int]:
        """Return nothing: no message waits for another."""
        return {}

    def explanations(self) -> Mapping[str, str]:
        """Return nothing: there are no losses."""
        return {}


IMU = MeasurementKind(
    name='imu',
    topics=(TopicKind.IMU,),
    reader=ImuReader,
    write=lambda factory, frames, reading: [
        (TopicKind.IMU, imu_message(factory, reading, frames.imu))
    ],
    queue_limit=4000,  # 20 s at 200 Hz
    expected=(TopicKind.IMU,),
    sources=('wheels+gyro',),
    high_bandwidth=True,
    clock='imu_time_offset',
)
