"""Messages to records and back, in one place; duck-typed, so that no ROS is imported here.

Reading works on any object with the field names of common_interfaces (rclpy's or rosbags').
Writing goes through a MessageFactory, which knows the classes and the sequence type to use.
"""

from explore_slam.messages.base import (
    MessageFactory,
    covariance_message,
    header,
    planar_covariance,
    planar_pose,
    pose_message,
    seconds,
    time_message,
)
from explore_slam.messages.clouds import (
    cloud_columns,
    cloud_message,
    landmarks_message,
    landmarks_record,
    sighting_message,
    sighting_record,
)
from explore_slam.messages.images import (
    camera_info_message,
    color_array,
    depth_array,
    frame_record,
    image_message,
    intrinsics_record,
)
from explore_slam.messages.maps import (
    grid_arrays,
    grid_message,
)
from explore_slam.messages.motion import (
    estimate_message,
    odometry_message,
    odometry_record,
    path_message,
    plan_record,
    pose_array_message,
    scan_message,
    scan_record,
    twist_message,
)

__all__ = [
    'MessageFactory',
    'camera_info_message',
    'cloud_columns',
    'cloud_message',
    'color_array',
    'covariance_message',
    'depth_array',
    'estimate_message',
    'frame_record',
    'grid_arrays',
    'grid_message',
    'header',
    'image_message',
    'intrinsics_record',
    'landmarks_message',
    'landmarks_record',
    'odometry_message',
    'odometry_record',
    'path_message',
    'plan_record',
    'planar_covariance',
    'planar_pose',
    'pose_array_message',
    'pose_message',
    'scan_message',
    'scan_record',
    'seconds',
    'sighting_message',
    'sighting_record',
    'time_message',
    'twist_message',
]
