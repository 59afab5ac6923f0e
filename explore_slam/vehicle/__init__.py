"""Vehicle hardware without ROS: devices and their drivers, safety gate, path follower."""

from explore_slam.data import FollowerState
from explore_slam.vehicle.clearance import scan_points
from explore_slam.vehicle.config import PathFollowerConfig
from explore_slam.vehicle.devices import Base, BaseState, Camera, Device, Laser
from explore_slam.vehicle.driver_config import BaseConfig, CameraConfig, LaserConfig, SafetyConfig
from explore_slam.vehicle.kinect import Kinect, KinectConfig
from explore_slam.vehicle.lms200 import Lms200, Lms200Config
from explore_slam.vehicle.path_follower import PathFollower, VelocityCommand
from explore_slam.vehicle.pioneer_robot import PioneerConfig, PioneerRobot
from explore_slam.vehicle.registry import DriverConfig, make_base, make_camera, make_laser
from explore_slam.vehicle.safety import SafetyGate, SafetyInputs, SafeVelocity
from explore_slam.vehicle.supervisor import Supervisor

__all__ = [
    'Base',
    'BaseConfig',
    'BaseState',
    'Camera',
    'CameraConfig',
    'Device',
    'DriverConfig',
    'FollowerState',
    'Kinect',
    'KinectConfig',
    'Laser',
    'LaserConfig',
    'Lms200',
    'Lms200Config',
    'PathFollower',
    'PathFollowerConfig',
    'PioneerConfig',
    'PioneerRobot',
    'SafeVelocity',
    'SafetyConfig',
    'SafetyGate',
    'SafetyInputs',
    'Supervisor',
    'VelocityCommand',
    'make_base',
    'make_camera',
    'make_laser',
    'scan_points',
]
