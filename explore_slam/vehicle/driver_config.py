"""Settings of a vehicle's driver that all devices of a role share; safety.

Settings of one device are declared with its driver (pioneer_robot.py, lms200.py, kinect.py); the
whole tree is registry.DriverConfig.
"""

from dataclasses import dataclass

from explore_slam.settings import Section, section, setting


@dataclass(frozen=True)
class BaseNoiseConfig(Section):
    """Growth of the covariance of wheel odometry."""

    base_distance_variance: float = setting(
        0.0002, 'Variance of position per metre driven', unit='m²/m', low=0.0, high=1.0
    )
    base_heading_variance_turn: float = setting(
        0.002, 'Variance of heading per radian turned', unit='rad²/rad', low=0.0, high=1.0
    )
    base_heading_variance_distance: float = setting(
        0.0005, 'Variance of heading per metre driven', unit='rad²/m', low=0.0, high=1.0
    )


@dataclass(frozen=True)
class BaseConfig(Section):
    """Settings of any base."""

    enable_base: bool = setting(True, 'Drive the base; false: another driver does', tier='basic')
    base_port: str = setting(
        '/dev/ttyUSB0',
        "Serial device of the base, or 'tcp://host:port' (port 8101 if there is none)",
        tier='basic',
    )
    base_timeout: float = setting(
        1.0, 'Reconnect when no state has come for longer than this', unit='s', low=0.2, high=30.0
    )
    motors_at_start: bool = setting(
        False, 'Switch the motors on at the first connection, without enable_motors', tier='basic'
    )
    motors_after_reconnect: bool = setting(
        False, 'Switch motors that were on back on after the connection was lost'
    )
    battery_nominal_voltage: float = setting(
        0.0,
        'Nominal voltage of a lead-acid battery, usually 12 or 24, for its charge in percent; 0: '
        'by the voltage that the base reports',
        unit='V',
        low=0.0,
        high=48.0,
    )
    use_sonar: bool = setting(True, 'Switch the sonar on and publish its echoes', tier='basic')
    maximum_speed: float = setting(
        0.75, 'Maximum speed', unit='m/s', low=0.05, high=2.0, tier='basic'
    )
    maximum_turn_rate: float = setting(
        1.5, 'Maximum turn rate', unit='rad/s', low=0.05, high=5.0, tier='basic'
    )
    base_acceleration: float = setting(
        0.6, 'Acceleration of the base', unit='m/s²', low=0.05, high=3.0
    )
    base_deceleration: float = setting(
        1.0, 'Deceleration of the base', unit='m/s²', low=0.05, high=3.0
    )
    base_turn_acceleration: float = setting(
        3.0, 'Angular acceleration of the base', unit='rad/s²', low=0.1, high=10.0
    )
    noise: BaseNoiseConfig = section(BaseNoiseConfig)


@dataclass(frozen=True)
class LaserConfig(Section):
    """Settings of any laser scanner."""

    enable_laser: bool = setting(
        True,
        'Read the laser; false: another driver publishes scans, or there is none',
        tier='basic',
    )
    laser_port: str = setting(
        '/dev/ttyUSB1',
        "Serial device of the laser, or 'tcp://host:port' (port 8102 if there is none)",
        tier='basic',
    )
    laser_startup_timeout: float = setting(
        70.0,
        'Keep the port open for this long while the laser does not answer: where the port '
        'switches its power, it boots for 20 to 65 s',
        unit='s',
        low=1.0,
        high=600.0,
        tier='basic',
    )
    laser_inverted: bool = setting(False, 'The laser is mounted upside down', tier='basic')
    scanner_timeout: float = setting(
        2.0,
        'Reconnect when no valid scan has come for longer than this',
        unit='s',
        low=0.5,
        high=30.0,
    )


@dataclass(frozen=True)
class CameraConfig(Section):
    """Settings of any RGB-D camera."""

    enable_camera: bool = setting(
        True, 'Read the camera; false: another driver publishes images', tier='basic'
    )
    camera_rate: float = setting(
        10.0, 'Maximum rate of published frames', unit='Hz', low=0.2, high=30, tier='basic'
    )
    camera_timeout: float = setting(
        3.0, 'Reconnect when no image has come for longer than this', unit='s', low=0.5, high=60.0
    )


@dataclass(frozen=True)
class SafetyConfig(Section):
    """When the driver stops or slows the vehicle whatever is commanded."""

    command_timeout: float = setting(
        0.3,
        'Stop when no velocity has been commanded for longer than this',
        unit='s',
        low=0.1,
        high=2.0,
    )
    laser_timeout: float = setting(
        0.3,
        'Stop when the laser has sent no byte for longer than this',
        unit='s',
        low=0.1,
        high=5.0,
    )
    laser_stop: bool = setting(
        True, 'Stop for laser returns in the direction of travel', tier='basic'
    )
    sonar_stop: bool = setting(
        False, 'Stop for sonar echoes in the direction of travel (false alarms at edges)',
        tier='basic',
    )  # fmt: skip
    guard_distance: float = setting(
        0.15, 'Clearance kept between body and obstacle', unit='m', low=0.02, high=2.0,
        tier='basic',
    )  # fmt: skip
    guard_half_width: float = setting(
        0.22, 'Half the width of the lane that must be free', unit='m', low=0.05, high=2.0
    )
    guard_half_length: float = setting(
        0.25, 'Distance from the vehicle origin to front and back of the body', unit='m',
        low=0.05, high=2.0,
    )  # fmt: skip
    guard_acceleration: float = setting(
        0.8, 'Maximum acceleration passed to the base', unit='m/s²', low=0.05, high=5.0
    )
    guard_deceleration: float = setting(
        0.6, 'Deceleration assumed for braking before obstacles', unit='m/s²', low=0.05, high=5.0
    )
    guard_turn_acceleration: float = setting(
        4.0, 'Maximum angular acceleration passed to the base', unit='rad/s²', low=0.1, high=20.0
    )
