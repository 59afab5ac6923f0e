"""Odometry, velocities, scans, paths and estimates."""

import math
from typing import Any

import numpy as np

from explore_slam.data import LaserScan, OdometryReading, Plan
from explore_slam.geometry import Array, Pose2
from explore_slam.messages.base import (
    MessageFactory,
    covariance_message,
    header,
    planar_covariance,
    planar_pose,
    pose_message,
    seconds,
)


def odometry_record(message: Any) -> OdometryReading:
    """Return a nav_msgs/Odometry as a record; an all-zero covariance counts as none."""
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
    """Return a nav_msgs/Odometry; velocity is (m/s forward, rad/s)."""
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


def twist_message(factory: MessageFactory, linear: float, angular: float) -> Any:
    """Return a geometry_msgs/Twist: m/s forward, rad/s to the left."""
    return factory.make(
        'geometry_msgs/Twist',
        linear=factory.make('geometry_msgs/Vector3', x=float(linear), y=0.0, z=0.0),
        angular=factory.make('geometry_msgs/Vector3', x=0.0, y=0.0, z=float(angular)),
    )


def scan_record(message: Any) -> LaserScan:
    """Return a sensor_msgs/LaserScan as a record."""
    return LaserScan(
        seconds(message.header.stamp),
        float(message.angle_min),
        float(message.angle_increment),
        np.array(message.ranges, dtype=np.float32),
        float(message.range_min),
        float(message.range_max),
    )


def scan_message(
    factory: MessageFactory, scan: LaserScan, frame: str, scan_time: float = 0.0
) -> Any:
    """Return a sensor_msgs/LaserScan (REP-117 values are kept as they are)."""
    count = scan.ranges.size
    return factory.make(
        'sensor_msgs/LaserScan',
        header=header(factory, scan.stamp, frame),
        angle_min=float(scan.angle_min),
        angle_max=float(scan.angle_min + scan.angle_increment * (count - 1)),
        angle_increment=float(scan.angle_increment),
        time_increment=0.0,
        scan_time=float(scan_time),
        range_min=float(scan.range_min),
        range_max=float(scan.range_max),
        ranges=factory.sequence(scan.ranges.astype(np.float32, copy=False)),
        intensities=factory.sequence(np.empty(0, np.float32)),
    )


def plan_record(message: Any, vehicle: str) -> Plan:
    """Return a nav_msgs/Path as the plan of a vehicle; an empty path means stop."""
    poses = [planar_pose(stamped.pose) for stamped in message.poses]
    points = np.array([[pose.x, pose.y] for pose in poses], dtype=np.float64).reshape(-1, 2)
    goal = poses[-1] if poses else Pose2(math.nan, math.nan, 0.0)
    return Plan(seconds(message.header.stamp), vehicle, goal, points)


def path_message(
    factory: MessageFactory,
    stamp: float,
    frame: str,
    poses: Array,
    stamps: Array | None = None,
) -> Any:
    """Return a nav_msgs/Path along poses (W, 2) or (W, 3); headings are made where absent.

    stamps (W,) s are those of the single poses, for a path that was driven.
    """
    points = np.asarray(poses, dtype=np.float64)
    if points.shape[-1] == 2:
        steps = np.diff(points, axis=0)
        headings = np.arctan2(steps[:, 1], steps[:, 0])
        last = headings[-1:] if len(headings) else np.zeros(min(1, len(points)))
        points = np.column_stack([points, np.concatenate([headings, last])])
    top = header(factory, stamp, frame)
    tops = [top] * len(points)
    if stamps is not None:
        tops = [header(factory, when, frame) for when in stamps.tolist()]
    stamped = [
        factory.make(
            'geometry_msgs/PoseStamped', header=one, pose=pose_message(factory, Pose2(*row))
        )
        for one, row in zip(tops, points.tolist(), strict=True)
    ]
    return factory.make('nav_msgs/Path', header=top, poses=stamped)


def estimate_message(
    factory: MessageFactory, stamp: float, frame: str, pose: Pose2, covariance: Array
) -> Any:
    """Return a geometry_msgs/PoseWithCovarianceStamped."""
    return factory.make(
        'geometry_msgs/PoseWithCovarianceStamped',
        header=header(factory, stamp, frame),
        pose=factory.make(
            'geometry_msgs/PoseWithCovariance',
            pose=pose_message(factory, pose),
            covariance=covariance_message(covariance),
        ),
    )


def pose_array_message(factory: MessageFactory, stamp: float, frame: str, poses: Array) -> Any:
    """Return a geometry_msgs/PoseArray of poses (M, 3)."""
    return factory.make(
        'geometry_msgs/PoseArray',
        header=header(factory, stamp, frame),
        poses=[pose_message(factory, Pose2(*row)) for row in np.asarray(poses).tolist()],
    )
