"""Hardware of a vehicle without ROS: base, laser, camera, and what makes it follow a plan."""

from explore_slam.vehicle.config import PathFollowerConfig
from explore_slam.vehicle.driver_config import (
    BaseConfig,
    CameraConfig,
    DriverConfig,
    LaserConfig,
    SafetyConfig,
)
from explore_slam.vehicle.kinect import Kinect
from explore_slam.vehicle.lms200 import Lms200
from explore_slam.vehicle.path_follower import FollowerState, PathFollower, VelocityCommand
from explore_slam.vehicle.pioneer_robot import BaseState, PioneerRobot
from explore_slam.vehicle.safety import SafetyGate, SafetyInputs
from explore_slam.vehicle.supervisor import Supervisor

__all__ = [
    'BaseConfig',
    'BaseState',
    'CameraConfig',
    'DriverConfig',
    'FollowerState',
    'Kinect',
    'LaserConfig',
    'Lms200',
    'PathFollower',
    'PathFollowerConfig',
    'PioneerRobot',
    'SafetyConfig',
    'SafetyGate',
    'SafetyInputs',
    'Supervisor',
    'VelocityCommand',
]
