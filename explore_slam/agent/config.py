"""The configuration of the agent; parameters, settings files and options derive from it."""

from dataclasses import dataclass

from explore_slam.exploration import ExplorationConfig
from explore_slam.mapping import GridConfig
from explore_slam.mounts import CameraMountConfig, ExplicitMounts, LaserMountConfig
from explore_slam.registration import ScanMatchingConfig
from explore_slam.settings import Section, section, setting
from explore_slam.slam import FastSlamConfig
from explore_slam.slam.closures import ClosureConfig
from explore_slam.vision import CameraMount, VisionConfig


@dataclass(frozen=True)
class InputConfig(Section):
    """Which records the agent accepts from its vehicles, and when it gives a vehicle up."""

    odometry_duration: float = setting(
        30.0, 'Time for which odometry is kept', unit='s', low=1.0, high=3600.0
    )
    odometry_jump_speed: float = setting(
        3.0,
        'Odometry that moves faster is treated as a reset of the base, not as motion',
        unit='m/s',
        low=0.1,
        high=100.0,
    )
    clock_jump_threshold: float = setting(
        1.0,
        'Odometry stamps that go back by this or more belong to a restarted clock',
        unit='s',
        low=0.01,
        high=1e6,
    )
    measurement_queue_length: int = setting(
        50, 'Measurements per vehicle that may wait for odometry', low=1, high=10000
    )
    silent_timeout: float = setting(
        3.0,
        'A vehicle without odometry for longer is silent and gets no target',
        unit='s',
        low=0.1,
        high=3600.0,
    )
    lost_deviation: float = setting(
        1.0,
        'A vehicle is lost, and gets no target, when the largest standard deviation of its '
        'position exceeds this',
        unit='m',
        low=0.05,
        high=100.0,
    )


@dataclass(frozen=True)
class ScanConfig(Section):
    """Which scans enter the occupancy grid."""

    map_scan_distance: float = setting(
        0.1, 'Minimum travel between mapped scans', unit='m', low=0.0, high=10.0
    )
    map_scan_heading: float = setting(
        0.1, 'Minimum change of heading between mapped scans', unit='rad', low=0.0, high=6.3
    )
    map_scan_period: float = setting(
        2.0,
        'Time after which a scan is mapped even if the vehicle has not moved',
        unit='s',
        low=0.0,
        high=3600.0,
    )
    body_margin: float = setting(
        0.12,
        'Beams that end within this distance of the body of another vehicle are not obstacles',
        unit='m',
        low=0.0,
        high=2.0,
    )


@dataclass(frozen=True)
class AgentConfig(Section):
    """All settings of the agent."""

    inputs: InputConfig = section(InputConfig)
    laser_mount: LaserMountConfig = section(LaserMountConfig)
    scans: ScanConfig = section(ScanConfig)
    vision: VisionConfig = section(VisionConfig)
    slam: FastSlamConfig = section(FastSlamConfig)
    scan_matching: ScanMatchingConfig = section(ScanMatchingConfig)
    closures: ClosureConfig = section(ClosureConfig)
    mapping: GridConfig = section(GridConfig)
    exploration: ExplorationConfig = section(ExplorationConfig)


def explicit_mounts(config: AgentConfig) -> ExplicitMounts:
    """Return the mounts that differ from the defaults of the settings."""
    laser, camera = config.laser_mount, config.vision.mount
    optical = CameraMount.from_config(camera).optical_pose
    return ExplicitMounts(
        laser.pose if laser != LaserMountConfig() else None,
        optical if camera != CameraMountConfig() else None,
    )
