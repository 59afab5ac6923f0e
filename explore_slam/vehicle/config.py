"""Settings of the path follower."""

from dataclasses import dataclass

from explore_slam.body import BodyConfig
from explore_slam.mounts import LaserMountConfig
from explore_slam.settings import Section, section, setting


@dataclass(frozen=True)
class PathFollowerConfig(Section):
    """How a vehicle follows its plan and when it stops."""

    control_frequency: float = setting(
        20.0, 'Rate of velocity commands', unit='Hz', low=2.0, high=100.0
    )
    body: BodyConfig = section(BodyConfig)
    follow_turn_rate: float = setting(
        0.9, 'Maximum turn rate', unit='rad/s', low=0.05, high=4.0, tier='basic'
    )
    follow_acceleration: float = setting(
        0.5, 'Forward acceleration along the plan', unit='m/s²', low=0.05, high=5.0
    )
    follow_turn_acceleration: float = setting(
        2.5, 'Angular acceleration along the plan', unit='rad/s²', low=0.1, high=20.0
    )
    lookahead_time: float = setting(
        0.8, 'Lookahead distance per speed', unit='s', low=0.2, high=3.0
    )
    minimum_lookahead: float = setting(
        0.22, 'Minimum lookahead distance', unit='m', low=0.05, high=2.0
    )
    turn_in_place_angle: float = setting(
        0.9, 'Bearing of the lookahead point beyond which the vehicle turns on the spot',
        unit='rad', low=0.2, high=3.14,
    )  # fmt: skip
    arrival_tolerance: float = setting(
        0.12, 'Distance from the last waypoint at which a plan is complete', unit='m',
        low=0.01, high=1.0, tier='basic',
    )  # fmt: skip
    maximum_deviation: float = setting(
        1.0, 'Distance from the plan beyond which the vehicle reports blocked and waits',
        unit='m', low=0.1, high=10.0,
    )  # fmt: skip
    obstacle_stop: bool = setting(
        True, 'Require scans, and stop for obstacles they show on the path', tier='basic'
    )
    stop_distance: float = setting(
        0.2, 'Clearance kept between body and obstacle ahead, unless the plan ends before it',
        unit='m', low=0.02, high=2.0, tier='basic',
    )  # fmt: skip
    reaction_time: float = setting(
        0.35, 'Delay between the appearance of an obstacle and braking', unit='s',
        low=0.0, high=2.0,
    )  # fmt: skip
    blocked_timeout: float = setting(
        3.0, 'Report blocked when an obstacle has stopped the vehicle for longer than this',
        unit='s', low=0.1, high=120.0,
    )  # fmt: skip
    stuck_timeout: float = setting(
        6.0, 'Report blocked when commands have made no progress for longer than this', unit='s',
        low=0.5, high=120.0,
    )  # fmt: skip
    agent_timeout: float = setting(
        2.0,
        'Stop when neither plan nor pose has come for longer than this',
        unit='s',
        low=0.1,
        high=60.0,
    )
    heartbeat_timeout: float = setting(
        0.25,
        "Stop when the agent's heartbeat, once received, has not come for longer than this "
        '(wall time)',
        unit='s', low=0.15, high=60.0,
    )  # fmt: skip
    pose_timeout: float = setting(
        20.0, 'Stop when the newest map pose is older than this', unit='s', low=0.1, high=600.0
    )
    odometry_timeout: float = setting(
        0.5, 'Stop when no odometry has come for longer than this', unit='s', low=0.05, high=10.0
    )
    scan_timeout: float = setting(
        0.6, 'Stop when no scan has come for longer than this', unit='s', low=0.05, high=10.0
    )
    laser_mount: LaserMountConfig = section(LaserMountConfig)
