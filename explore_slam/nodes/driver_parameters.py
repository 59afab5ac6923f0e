"""Parameters of the driver node: frames, and the settings of its devices."""

from dataclasses import dataclass

from explore_slam.settings import Section, section, setting
from explore_slam.vehicle import DriverConfig


@dataclass(frozen=True)
class DriverNodeConfig(Section):
    """All parameters of the driver node."""

    odom_frame: str = setting('odom', "frame of odometry, behind the vehicle's name and a slash")
    robot_base_frame: str = setting(
        'base_link', "frame of the vehicle, behind the vehicle's name and a slash"
    )
    laser_frame: str = setting('laser', "frame of the laser, behind the vehicle's name")
    camera_frame: str = setting(
        'camera_optical_frame', "frame of the camera, behind the vehicle's name"
    )
    publish_tf: bool = setting(True, 'publish tf, where tf2_msgs is installed')
    watch_scan_topic: bool = setting(
        False, "stop for another driver's laser: use the topic scan where use_laser is false"
    )
    driver: DriverConfig = section(DriverConfig)
