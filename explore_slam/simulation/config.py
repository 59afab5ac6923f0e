"""Settings of the rendered simulator: bases, lasers and cameras of its vehicles.

Defaults are a Pioneer 3-DX with a SICK LMS-200 and a Kinect v1.
"""

from dataclasses import dataclass

from explore_slam.errors import ConfigError
from explore_slam.mounts import CameraMountConfig, LaserMountConfig
from explore_slam.settings import Section, section, setting
from explore_slam.sweeps import LONGEST_SWEEP


@dataclass(frozen=True)
class SimulatedBaseConfig(Section):
    """The differential drive."""

    simulated_radius: float = setting(
        0.26, 'Radius of the circle that contains the body and collides', unit='m',
        low=0.05, high=2.0, tier='basic',
    )  # fmt: skip
    simulated_height: float = setting(
        0.8, 'Height of the vehicle with its mast: table tops and shelves that hang lower collide',
        unit='m', low=0.05, high=5.0,
    )  # fmt: skip
    simulated_max_speed: float = setting(
        0.75, 'Maximum speed, whatever is commanded', unit='m/s', low=0.01, high=5.0,
        tier='basic',
    )  # fmt: skip
    simulated_max_turn_rate: float = setting(
        1.75, 'Maximum turn rate, whatever is commanded', unit='rad/s', low=0.01, high=10.0
    )
    simulated_acceleration: float = setting(
        0.8, 'Acceleration and deceleration', unit='m/s²', low=0.01, high=20.0
    )
    simulated_turn_acceleration: float = setting(
        3.5, 'Angular acceleration', unit='rad/s²', low=0.01, high=50.0
    )


@dataclass(frozen=True)
class SimulatedOdometryConfig(Section):
    """Wheel odometry with the noise of the paper's table I (wheel_odometry.py).

    `benchmarks/noise_carmen.py` measures the same values in logs of real robots.
    """

    simulated_odometry_rate: float = setting(
        20.0, 'Rate of odometry readings', unit='Hz', low=0.5, high=200.0
    )
    simulated_distance_variance: float = setting(
        3.125e-4, 'Variance of the driven distance', unit='m² per m', low=0.0, high=1.0
    )
    simulated_drift_variance: float = setting(
        1.371e-3, 'Variance of the heading per driven distance', unit='rad² per m',
        low=0.0, high=1.0,
    )  # fmt: skip
    simulated_turn_variance: float = setting(
        4.363e-4, 'Variance of the heading per rotation', unit='rad² per rad', low=0.0, high=1.0
    )
    simulated_distance_scale: float = setting(
        0.0, 'Systematic error of the driven distance', unit='m per m', low=-0.5, high=0.5
    )
    simulated_turn_scale: float = setting(
        0.0, 'Systematic error of rotations', unit='rad per rad', low=-0.5, high=0.5
    )
    simulated_heading_drift: float = setting(
        0.0, 'Systematic error of the heading: wheels of unequal diameter', unit='rad per m',
        low=-0.5, high=0.5,
    )  # fmt: skip


@dataclass(frozen=True)
class SimulatedLaserMountConfig(LaserMountConfig):
    """Pose of the simulated laser, which has a place of its own at the front of the vehicle.

    The simulator states it like a robot: on /tf_static, and in its scans.
    """

    laser_x: float = setting(
        0.1, 'Laser ahead of the vehicle origin', unit='m', low=-10.0, high=10.0, tier='basic'
    )


@dataclass(frozen=True)
class SimulatedLaserConfig(Section):
    """The laser scanner; its pose in the plane is a LaserMountConfig."""

    simulated_scan_rate: float = setting(
        10.0, 'Rate of scans; 0 switches the laser off', unit='Hz', low=0.0, high=100.0,
        tier='basic',
    )  # fmt: skip
    simulated_beams: int = setting(361, 'Beams of a scan', low=2, high=4000)
    simulated_field_of_view: float = setting(
        180.0, 'Angle between the first and the last beam', unit='degrees', low=1.0, high=360.0
    )
    simulated_scan_range: float = setting(
        8.0, 'Maximum range', unit='m', low=0.5, high=100.0, tier='basic'
    )
    simulated_scan_noise: float = setting(
        0.01, 'Standard deviation of a range', unit='m', low=0.0, high=1.0
    )
    simulated_sweep_time: float = setting(
        0.0,
        'Time from the first to the last beam of a scan, which is stamped at its first beam; 0: '
        'all at one moment. A spinning lidar takes as long as from scan to scan',
        unit='s',
        low=0.0,
        high=LONGEST_SWEEP,
        tier='basic',
    )
    simulated_laser_z: float = setting(0.3, 'Laser above the ground', unit='m', low=0.02, high=3.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.simulated_sweep_time * self.simulated_scan_rate > 1.0:
            raise ConfigError(
                f'simulated_sweep_time is {self.simulated_sweep_time} s, expected at most the '
                f'{1.0 / self.simulated_scan_rate:.3f} s between scans (simulated_scan_rate)'
            )


@dataclass(frozen=True)
class SimulatedKinectConfig(Section):
    """The RGB-D camera, registered; its pose is a CameraMountConfig."""

    simulated_camera_rate: float = setting(
        4.0, 'Rate of RGB-D frames; 0 switches the camera off', unit='Hz', low=0.0, high=60.0,
        tier='basic',
    )  # fmt: skip
    simulated_image_width: int = setting(
        640, 'Columns of the images', unit='pixels', low=16, high=4096
    )
    simulated_image_height: int = setting(
        480, 'Rows of the images', unit='pixels', low=16, high=4096
    )
    simulated_camera_angle: float = setting(
        57.0, 'Horizontal field of view', unit='degrees', low=10.0, high=120.0
    )
    simulated_min_depth: float = setting(
        0.8, 'Minimum measured depth', unit='m', low=0.1, high=20.0
    )
    simulated_max_depth: float = setting(
        3.5, 'Maximum measured depth', unit='m', low=0.2, high=20.0
    )
    simulated_depth_noise: float = setting(
        0.003, 'Standard deviation of depth at 1 m; grows with the square of depth', unit='1/m',
        low=0.0, high=1.0,
    )  # fmt: skip
    simulated_readout_time: float = setting(  # as camera_readout_time of the agent
        0.026, 'Time from the exposure of the first row of an image to that of the last (rolling '
        'shutter)', unit='s', low=0.0, high=0.1,
    )  # fmt: skip
    simulated_color_noise: float = setting(
        2.0, 'Standard deviation of each colour channel', unit='grey levels', low=0.0, high=40.0
    )


@dataclass(frozen=True)
class SimulationConfig(Section):
    """All settings of the rendered simulator."""

    tick_rate: float = setting(
        50.0, 'Time steps per simulated second', unit='Hz', low=5.0, high=1000.0
    )
    base: SimulatedBaseConfig = section(SimulatedBaseConfig)
    odometry: SimulatedOdometryConfig = section(SimulatedOdometryConfig)
    laser: SimulatedLaserConfig = section(SimulatedLaserConfig)
    laser_mount: SimulatedLaserMountConfig = section(SimulatedLaserMountConfig)
    kinect: SimulatedKinectConfig = section(SimulatedKinectConfig)
    camera_mount: CameraMountConfig = section(CameraMountConfig)
