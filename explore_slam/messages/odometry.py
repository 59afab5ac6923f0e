"""Wheel odometry."""

from typing import Any

import numpy as np

from explore_slam.data import OdometryReading
from explore_slam.messages.base import (
    MessageFactory,
    covariance_message,
    header,
    planar_covariance,
    planar_pose,
    pose_message,
    seconds,
)
from explore_slam.messages.measurement import MeasurementKind, MessageReader
from explore_slam.messages.motion import twist_message
from explore_slam.messages.topics import TopicKind


def odometry_record(message: Any) -> OdometryReading:
    """Return the pose in a nav_msgs/Odometry; an all-zero covariance counts as unknown."""
    covariance = planar_covariance(message.pose.covariance)
    return OdometryReading(
        seconds(message.header.stamp),
        planar_pose(message.pose.pose),
        covariance if covariance.any() else None,
    )


def odometry_message(
    factory: MessageFactory,
    reading: OdometryReading,
    frame: str,
    child_frame: str,
    velocity: tuple[float, float] = (0.0, 0.0),
) -> Any:
    """Return a nav_msgs/Odometry.

    velocity: m/s forward, rad/s to the left.
    """
    return factory.make(
        'nav_msgs/Odometry',
        header=header(factory, reading.stamp, frame),
        child_frame_id=child_frame,
        pose=factory.make(
            'geometry_msgs/PoseWithCovariance',
            pose=pose_message(factory, reading.pose),
            covariance=covariance_message(reading.covariance),
        ),
        twist=factory.make(
            'geometry_msgs/TwistWithCovariance',
            twist=twist_message(factory, *velocity),
            covariance=np.zeros(36),
        ),
    )


ODOMETRY = MeasurementKind(
    name='odometry',
    topics=(TopicKind.ODOMETRY,),
    reader=lambda _mounts, _sensor: MessageReader(odometry_record),
    write=lambda factory, frames, reading: [
        (TopicKind.ODOMETRY, odometry_message(factory, reading, frames.odom, frames.base))
    ],
    queue_limit=2000,  # 20 s at 100 Hz
    expected=(TopicKind.ODOMETRY,),
    sources=('wheels', 'wheels+gyro'),
    clock='odom_time_offset',
)
