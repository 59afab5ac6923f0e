"""Hardware of a vehicle without ROS: base, laser, camera, and what makes it follow a plan."""

from explore_slam.vehicle.config import PathFollowerConfig
from explore_slam.vehicle.path_follower import FollowerState, PathFollower, VelocityCommand

__all__ = ['FollowerState', 'PathFollower', 'PathFollowerConfig', 'VelocityCommand']
