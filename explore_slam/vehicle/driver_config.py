"""Settings of the driver of a vehicle: base, laser, camera, safety."""

import math
from dataclasses import dataclass

from explore_slam.errors import ConfigError
from explore_slam.mounts import CameraMountConfig, LaserMountConfig
from explore_slam.settings import Section, section, setting

_VARIANTS = ((180, 1.0), (180, 0.5), (100, 1.0), (100, 0.5), (100, 0.25))  # of the LMS-200
_RANGES = (8, 16, 32)  # m


@dataclass(frozen=True)
class BaseNoiseConfig(Section):
    """How the uncertainty of the base's odometry grows."""

    base_distance_variance: float = setting(
        0.0002, 'variance of position per metre driven', unit='m²/m', low=0.0, high=1.0
    )
    base_heading_variance_turn: float = setting(
        0.002, 'variance of heading per radian turned', unit='rad²/rad', low=0.0, high=1.0
    )
    base_heading_variance_distance: float = setting(
        0.0005, 'variance of heading per metre driven', unit='rad²/m', low=0.0, high=1.0
    )


@dataclass(frozen=True)
class BaseConfig(Section):
    """The Pioneer base."""

    use_base: bool = setting(True, 'drive a Pioneer base')
    base_port: str = setting('/dev/ttyUSB0', "serial device of the robot, or 'tcp://host:port'")
    base_baud: int = setting(
        0, 'rate of the robot at the start; 0 tries all', unit='Bd', low=0, high=1_000_000
    )
    host_baud: int = setting(
        0, 'rate to change to after the handshake; 0 stays', unit='Bd', low=0, high=115200
    )
    distance_factor: float = setting(
        0.0, 'millimetres per count of the odometry; 0 takes the factor of the subclass',
        unit='mm', low=0.0, high=100.0,
    )  # fmt: skip
    base_timeout: float = setting(
        1.0, 'connect anew when no status packet has come for longer', unit='s', low=0.2, high=30.0
    )
    motors_at_start: bool = setting(
        False, 'switch the motors on when the base is first connected, without being asked'
    )
    motors_after_reconnect: bool = setting(
        False, 'switch motors that were on back on after the cable was lost and found'
    )
    use_sonar: bool = setting(True, 'switch the sonar on, publish it and stop for what it shows')
    maximum_speed: float = setting(0.75, 'fastest drive', unit='m/s', low=0.05, high=2.0)
    maximum_turn_rate: float = setting(1.5, 'fastest turn', unit='rad/s', low=0.05, high=5.0)
    base_acceleration: float = setting(0.6, 'speeding up', unit='m/s²', low=0.05, high=3.0)
    base_deceleration: float = setting(1.0, 'slowing down', unit='m/s²', low=0.05, high=3.0)
    base_turn_acceleration: float = setting(
        3.0, 'change of turn rate', unit='rad/s²', low=0.1, high=10.0
    )
    noise: BaseNoiseConfig = section(BaseNoiseConfig)


@dataclass(frozen=True)
class LaserConfig(Section):
    """The SICK LMS-200."""

    use_laser: bool = setting(True, 'read a SICK LMS-200')
    laser_port: str = setting('/dev/ttyUSB1', "serial device of the laser, or 'tcp://host:port'")
    laser_baud: int = setting(
        38400, 'rate to run the laser at (500000 needs RS-422)', unit='Bd', low=9600, high=500000
    )
    laser_angle: int = setting(180, 'field of view', unit='°', low=100, high=180)
    laser_resolution: float = setting(0.5, 'angle between beams', unit='°', low=0.25, high=1.0)
    laser_range: int = setting(8, 'largest range measured in mm', unit='m', low=8, high=32)
    laser_inverted: bool = setting(False, 'the laser is mounted upside down')
    scanner_timeout: float = setting(
        2.0, 'connect anew when no valid scan has come for longer', unit='s', low=0.5, high=30.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        variant = (self.laser_angle, self.laser_resolution)
        if variant not in _VARIANTS:
            raise ConfigError(
                f'laser_angle and laser_resolution are {variant}, expected one of {_VARIANTS}'
            )
        if self.laser_range not in _RANGES:
            raise ConfigError(f'laser_range is {self.laser_range}, expected one of {_RANGES}')


@dataclass(frozen=True)
class CameraConfig(Section):
    """The Kinect."""

    use_camera: bool = setting(True, 'read a Kinect')
    camera_index: int = setting(0, 'which Kinect, counted from 0', low=0, high=15)
    camera_rate: float = setting(10.0, 'frames published per second', unit='Hz', low=0.2, high=30)
    camera_depth: str = setting(
        'registered', 'registered: mm, aligned with the colour image; raw: disparities, by a fit',
        choices=('registered', 'raw'),
    )  # fmt: skip
    camera_timeout: float = setting(
        3.0, 'report the camera lost when no image has come for longer', unit='s',
        low=0.5, high=60.0,
    )  # fmt: skip
    camera_focal_length: float = setting(
        525.0, 'focal length of the colour camera', unit='pixels', low=100.0, high=2000.0
    )
    camera_center: tuple[float, ...] = setting(
        (319.5, 239.5), 'principal point of the colour camera (pixels)'
    )
    camera_mount: CameraMountConfig = section(CameraMountConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.camera_center) != 2 or not all(map(math.isfinite, self.camera_center)):
            raise ConfigError(
                f'camera_center is {list(self.camera_center)}, expected 2 finite numbers'
            )


@dataclass(frozen=True)
class SafetyConfig(Section):
    """When the driver stops the vehicle whatever is commanded."""

    command_timeout: float = setting(
        0.3, 'stop when no velocity has been commanded for longer', unit='s', low=0.1, high=2.0
    )
    laser_timeout: float = setting(
        0.3, 'stop when the laser has sent nothing for longer', unit='s', low=0.1, high=5.0
    )
    driver_obstacle_stop: bool = setting(
        True, 'stop for what the laser shows in the direction of travel'
    )
    sonar_stop: bool = setting(
        False, 'stop for what the sonar shows in the direction of travel (false alarms at edges)'
    )
    guard_distance: float = setting(
        0.15, 'room kept between body and obstacle', unit='m', low=0.02, high=2.0
    )
    guard_half_width: float = setting(
        0.22, 'half the width of the lane that must be free', unit='m', low=0.05, high=2.0
    )
    guard_length: float = setting(
        0.25, 'from the middle of the vehicle to its front and back', unit='m', low=0.05, high=2.0
    )
    guard_acceleration: float = setting(
        0.8, 'speeding up as commanded', unit='m/s²', low=0.05, high=5.0
    )
    guard_deceleration: float = setting(
        0.6, 'braking reckoned with before obstacles', unit='m/s²', low=0.05, high=5.0
    )
    guard_turn_acceleration: float = setting(
        4.0, 'change of the turn rate commanded', unit='rad/s²', low=0.1, high=20.0
    )


@dataclass(frozen=True)
class DriverConfig(Section):
    """All of one vehicle's driver."""

    base: BaseConfig = section(BaseConfig)
    laser: LaserConfig = section(LaserConfig)
    camera: CameraConfig = section(CameraConfig)
    safety: SafetyConfig = section(SafetyConfig)
    retry_after: float = setting(
        0.25, 'first wait before a lost part is tried again; doubles twice', unit='s',
        low=0.05, high=10.0,
    )  # fmt: skip
    laser_mount: LaserMountConfig = section(LaserMountConfig)
