"""The whole configuration of the agent: one tree, from which parameters, files, options derive."""

from dataclasses import dataclass

from explore_slam.exploration import ExplorationConfig
from explore_slam.mapping import GridConfig, ScanMatchingConfig
from explore_slam.mounts import LaserMountConfig
from explore_slam.settings import Section, section, setting
from explore_slam.slam import FastSlamConfig
from explore_slam.vision import VisionConfig


@dataclass(frozen=True)
class InputConfig(Section):
    """What the agent accepts from its vehicles."""

    odometry_span: float = setting(
        30.0, 'odometry is kept for this long', unit='s', low=1.0, high=3600.0
    )
    maximum_speed: float = setting(
        3.0,
        'odometry that moves faster is taken for a reset of the base',
        unit='m/s',
        low=0.1,
        high=100.0,
    )
    clock_jump: float = setting(
        1.0, 'stamps that go back further than this are a new time', unit='s', low=0.01, high=1e6
    )
    waiting_observations: int = setting(
        50, 'observations that may wait for odometry, per vehicle', low=1, high=10000
    )
    silent_timeout: float = setting(
        3.0, 'a vehicle without odometry for longer is silent', unit='s', low=0.1, high=3600.0
    )
    lost_deviation: float = setting(
        1.0,
        'a vehicle whose position is less certain (standard deviation) is lost',
        unit='m',
        low=0.05,
        high=100.0,
    )


@dataclass(frozen=True)
class ScanConfig(Section):
    """Which scans enter the occupancy grid."""

    scan_distance: float = setting(
        0.1, 'a scan is kept after this way', unit='m', low=0.0, high=10.0
    )
    scan_heading: float = setting(
        0.1, 'a scan is kept after this turn', unit='rad', low=0.0, high=6.3
    )
    scan_gap: float = setting(
        2.0, 'a scan is kept after this time anyway', unit='s', low=0.0, high=3600.0
    )
    body_margin: float = setting(
        0.12,
        'beams that end this near the body of another vehicle are no wall',
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
    mapping: GridConfig = section(GridConfig)
    exploration: ExplorationConfig = section(ExplorationConfig)
