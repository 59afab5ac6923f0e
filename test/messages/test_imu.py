"""IMU messages: over the wire, without a gyroscope, with a mount, and in the settings."""

import math

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message

from explore_slam.data import ImuReading
from explore_slam.errors import ConfigError, DataError
from explore_slam.messages.imu import IMU, imu_message, imu_record
from explore_slam.messages.measurement import VehicleReader
from explore_slam.messages.odometry import ODOMETRY
from explore_slam.messages.sensor_mounts import SensorMounts
from explore_slam.messages.topics import TopicKind
from explore_slam.messages.transforms import TransformTree
from explore_slam.messages.vehicle_settings import VehicleConfig
from explore_slam.nodes.ros_types import MESSAGES

READING = ImuReading(12.345678901, (0.1, -0.2, 0.3))


def message():
    made = imu_message(MESSAGES, READING, 'robot1/imu_link')
    return deserialize_message(serialize_message(made), type(made))


def test_an_angular_velocity_survives_the_wire():
    back = imu_record(message())
    assert back.stamp == pytest.approx(READING.stamp, abs=1e-9)
    assert back.angular_velocity == READING.angular_velocity
    assert back.yaw_rate == 0.3


def test_a_message_without_angular_velocity_is_refused():
    given = message()
    given.angular_velocity_covariance[0] = -1.0
    with pytest.raises(DataError, match='holds no angular velocity'):
        imu_record(given)


def test_a_velocity_that_is_not_finite_is_named():
    given = message()
    given.angular_velocity.z = math.nan
    with pytest.raises(DataError, match=r'angular_velocity is \(0.1, -0.2, nan\)'):
        imu_record(given, np.eye(3))


def test_the_mount_of_the_settings_turns_the_axes():
    config = VehicleConfig(imu_mount=(math.pi / 2, 0.0, 0.0))
    mounts = SensorMounts('robot1', TransformTree(), config)
    _, record = VehicleReader((IMU,), mounts).read(TopicKind.IMU, message())
    assert record.angular_velocity == pytest.approx((0.1, -0.3, -0.2))


def test_it_is_expected_where_it_is_used():
    plain, gyro = VehicleConfig(), VehicleConfig(odometry='wheels+gyro', imu='imu/data')
    scan = VehicleConfig(odometry='scan')
    assert not IMU.is_expected(plain)
    assert not IMU.is_accepted(plain)
    assert IMU.is_expected(gyro)
    assert [topic.name for topic in IMU.topics_of(gyro)] == ['imu/data']
    assert ODOMETRY.is_expected(plain)
    assert ODOMETRY.is_expected(gyro)
    assert not ODOMETRY.is_expected(scan)
    assert ODOMETRY.is_accepted(scan)  # its transforms are needed


@pytest.mark.parametrize(
    ('values', 'words'),
    [
        ({'odometry': 'gyro'}, 'odometry'),
        ({'imu': '/imu'}, "imu is '/imu'"),
        ({'imu_mount': (0.0, 0.0)}, 'expected 3 finite numbers'),
        ({'odometry': 'scan', 'use_laser': False}, 'use_laser false'),
    ],
)
def test_settings_that_cannot_be_are_named(values, words):
    with pytest.raises(ConfigError, match=words):
        VehicleConfig(**values)
