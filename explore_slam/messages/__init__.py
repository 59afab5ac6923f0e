"""Conversion between ROS messages and records, and the tables of topics and measurement kinds.

Nothing here imports ROS: reading works on any object with the field names of common_interfaces
(messages of rclpy or of rosbags), writing goes through a MessageFactory that knows the classes.

topics                 names, types, quality of service
frames                 names of coordinate frames
measurement            the interface of a measurement kind; measurement_kinds is the table
odometry, scans, frame_pairing, landmarks, tags, obstacles, inter_robot    a measurement kind each
base, motion, images, clouds, maps                      conversions
"""

from explore_slam.messages.base import (
    MessageFactory,
    camera_transform_message,
    covariance_message,
    header,
    planar_covariance,
    planar_pose,
    planar_transform_message,
    pose_message,
    seconds,
    time_message,
    transform_message,
)
from explore_slam.messages.clouds import cloud_columns, cloud_message
from explore_slam.messages.images import (
    camera_info_message,
    color_array,
    depth_array,
    image_message,
    intrinsics_record,
)
from explore_slam.messages.inter_robot import inter_robot_message, inter_robot_record
from explore_slam.messages.landmarks import landmarks_message, landmarks_record
from explore_slam.messages.maps import grid_arrays, grid_message
from explore_slam.messages.motion import (
    estimate_message,
    path_message,
    plan_record,
    pose_array_message,
    stamped_twist_message,
    twist_message,
)
from explore_slam.messages.obstacles import obstacles_message, obstacles_record
from explore_slam.messages.odometry import odometry_message, odometry_record
from explore_slam.messages.scans import scan_message, scan_record
from explore_slam.messages.tags import tags_message, tags_record

__all__ = [
    'MessageFactory',
    'camera_info_message',
    'camera_transform_message',
    'cloud_columns',
    'cloud_message',
    'color_array',
    'covariance_message',
    'depth_array',
    'estimate_message',
    'grid_arrays',
    'grid_message',
    'header',
    'image_message',
    'inter_robot_message',
    'inter_robot_record',
    'intrinsics_record',
    'landmarks_message',
    'landmarks_record',
    'obstacles_message',
    'obstacles_record',
    'odometry_message',
    'odometry_record',
    'path_message',
    'plan_record',
    'planar_covariance',
    'planar_pose',
    'planar_transform_message',
    'pose_array_message',
    'pose_message',
    'scan_message',
    'scan_record',
    'seconds',
    'stamped_twist_message',
    'tags_message',
    'tags_record',
    'time_message',
    'transform_message',
    'twist_message',
]
