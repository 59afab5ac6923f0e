"""Settings of the simulated vehicles and their sensors (a Pioneer 3DX, LMS-200, Kinect)."""

from dataclasses import dataclass

from explore_slam.settings import Section, section, setting


@dataclass(frozen=True)
class SimulatedBaseConfig(Section):
    """The differential drive base; defaults are those of a Pioneer 3DX."""

    simulated_radius: float = setting(
        0.26, 'circle that holds the body of a vehicle', unit='m', low=0.05, high=2.0
    )
    simulated_max_speed: float = setting(
        0.75, 'fastest the base drives, whatever is commanded', unit='m/s', low=0.01, high=5.0
    )
    simulated_max_turn_rate: float = setting(
        1.75, 'fastest the base turns, whatever is commanded', unit='rad/s', low=0.01, high=10.0
    )
    simulated_acceleration: float = setting(
        0.8, 'change of speed per second that the motors manage', unit='m/s²', low=0.01, high=20.0
    )
    simulated_turn_acceleration: float = setting(
        3.5, 'change of turn rate per second that the motors manage', unit='rad/s²',
        low=0.01, high=50.0,
    )  # fmt: skip


@dataclass(frozen=True)
class SimulatedOdometryConfig(Section):
    """Wheel odometry: its variance grows with what is driven (see odometry.py for table I)."""

    simulated_odometry_rate: float = setting(
        20.0, 'odometry readings per second', unit='Hz', low=0.5, high=200.0
    )
    simulated_distance_variance: float = setting(
        3.125e-4, 'variance of the driven distance', unit='m² per m', low=0.0, high=1.0
    )
    simulated_drift_variance: float = setting(
        1.371e-3, 'variance of the heading from driving', unit='rad² per m', low=0.0, high=1.0
    )
    simulated_turn_variance: float = setting(
        4.363e-4, 'variance of the heading from turning', unit='rad² per rad', low=0.0, high=1.0
    )


@dataclass(frozen=True)
class SimulatedLaserConfig(Section):
    """The laser scanner; defaults are those of a SICK LMS-200 (180 degrees at 0.5)."""

    simulated_scan_rate: float = setting(
        10.0, 'scans per second; 0 switches the laser off', unit='Hz', low=0.0, high=100.0
    )
    simulated_beams: int = setting(361, 'beams of a scan', low=2, high=4000)
    simulated_field_of_view: float = setting(
        180.0, 'angle from the first to the last beam', unit='degrees', low=1.0, high=360.0
    )
    simulated_scan_range: float = setting(8.0, 'farthest return', unit='m', low=0.5, high=100.0)
    simulated_scan_noise: float = setting(
        0.01, 'standard deviation of a range', unit='m', low=0.0, high=1.0
    )
    simulated_laser_x: float = setting(
        0.1, 'laser ahead of the vehicle origin', unit='m', low=-1.0, high=1.0
    )
    simulated_laser_z: float = setting(0.3, 'laser above the ground', unit='m', low=0.02, high=3.0)


@dataclass(frozen=True)
class SimulatedKinectConfig(Section):
    """The RGB-D camera; defaults are those of a Kinect v1 in registered mode."""

    simulated_camera_rate: float = setting(
        4.0, 'RGB-D frames per second; 0 switches the camera off', unit='Hz', low=0.0, high=60.0
    )
    simulated_image_width: int = setting(
        640, 'columns of the images', unit='pixels', low=16, high=4096
    )
    simulated_image_height: int = setting(
        480, 'rows of the images', unit='pixels', low=16, high=4096
    )
    simulated_camera_angle: float = setting(
        57.0, 'horizontal field of view', unit='degrees', low=10.0, high=120.0
    )
    simulated_min_depth: float = setting(
        0.8, 'nearest depth that the camera measures', unit='m', low=0.1, high=20.0
    )
    simulated_max_depth: float = setting(
        3.5, 'farthest depth that the camera measures', unit='m', low=0.2, high=20.0
    )
    simulated_depth_noise: float = setting(
        0.003, 'standard deviation of depth at 1 m; grows with its square', unit='1/m',
        low=0.0, high=1.0,
    )  # fmt: skip
    simulated_color_noise: float = setting(
        2.0, 'standard deviation of each colour value', unit='grey levels', low=0.0, high=40.0
    )
    simulated_camera_x: float = setting(
        0.1, 'camera ahead of the vehicle origin', unit='m', low=-1.0, high=1.0
    )
    simulated_camera_z: float = setting(
        0.4, 'camera above the ground', unit='m', low=0.02, high=3.0
    )


@dataclass(frozen=True)
class SimulationConfig(Section):
    """All settings of the simulator."""

    tick_rate: float = setting(
        50.0, 'steps of the simulation per simulated second', unit='Hz', low=5.0, high=1000.0
    )
    base: SimulatedBaseConfig = section(SimulatedBaseConfig)
    odometry: SimulatedOdometryConfig = section(SimulatedOdometryConfig)
    laser: SimulatedLaserConfig = section(SimulatedLaserConfig)
    kinect: SimulatedKinectConfig = section(SimulatedKinectConfig)
