"""Velocities, plans, paths and pose estimates."""

import math
from typing import Any

import numpy as np

from explore_slam.data import Plan
from explore_slam.geometry import Array, Pose2
from explore_slam.messages.base import (
    MessageFactory,
    covariance_message,
    header,
    planar_pose,
    pose_message,
    seconds,
)


def twist_message(factory: MessageFactory, linear: float, angular: float) -> Any:
    """Return a geometry_msgs/Twist: m/s forward, rad/s to the left."""
    return factory.make(
        'geometry_msgs/Twist',
        linear=factory.make('geometry_msgs/Vector3', x=float(linear), y=0.0, z=0.0),
        angular=factory.make('geometry_msgs/Vector3', x=0.0, y=0.0, z=float(angular)),
    )


def stamped_twist_message(
    factory: MessageFactory, stamp: float, frame: str, linear: float, angular: float
) -> Any:
    """Return a geometry_msgs/TwistStamped: m/s forward, rad/s to the left, in the base frame."""
    return factory.make(
        'geometry_msgs/TwistStamped',
        header=header(factory, stamp, frame),
        twist=twist_message(factory, linear, angular),
    )


def plan_record(message: Any, vehicle: str) -> Plan:
    """Return the plan of a vehicle from a nav_msgs/Path; an empty path means stop."""
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
    """Return a nav_msgs/Path of poses (W, 3), or of points (W, 2) with headings along the path.

    stamps: (W,) times (s) of the single poses, for a path that was driven.
    """
    points = np.asarray(poses, dtype=np.float64)
    if points.shape[-1] == 2:
        steps = np.diff(points, axis=0)
        headings = np.arctan2(steps[:, 1], steps[:, 0])
        last = headings[-1:] if len(headings) else np.zeros(min(1, len(points)))
        points = np.column_stack([points, np.concatenate([headings, last])])
    own = header(factory, stamp, frame)
    headers = [own] * len(points)
    if stamps is not None:
        headers = [header(factory, time, frame) for time in stamps.tolist()]
    stamped = [
        factory.make(
            'geometry_msgs/PoseStamped', header=one, pose=pose_message(factory, Pose2(*row))
        )
        for one, row in zip(headers, points.tolist(), strict=True)
    ]
    return factory.make('nav_msgs/Path', header=own, poses=stamped)


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
