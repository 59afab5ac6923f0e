"""Settings of a vehicle: how it follows plans; the driver's settings are in driver_config."""

from dataclasses import dataclass

from explore_slam.mounts import LaserMountConfig
from explore_slam.settings import Section, section, setting


@dataclass(frozen=True)
class PathFollowerConfig(Section):
    """How a vehicle follows its plan and when it stops."""

    control_frequency: float = setting(
        20.0, 'rate of velocity commands', unit='Hz', low=2.0, high=100.0
    )
    follow_speed: float = setting(
        0.4, 'speed along the plan where nothing is in the way', unit='m/s', low=0.02, high=1.5
    )
    follow_turn_rate: float = setting(
        0.9, 'largest turn rate commanded', unit='rad/s', low=0.05, high=4.0
    )
    follow_acceleration: float = setting(
        0.5, 'change of speed per second on the way', unit='m/s²', low=0.05, high=5.0
    )
    follow_turn_acceleration: float = setting(
        2.5, 'change of turn rate per second', unit='rad/s²', low=0.1, high=20.0
    )
    lookahead_time: float = setting(
        0.8, 'the point steered at lies this far ahead at the present speed', unit='s',
        low=0.2, high=3.0,
    )  # fmt: skip
    minimum_lookahead: float = setting(
        0.22, 'the point steered at is never nearer than this', unit='m', low=0.05, high=2.0
    )
    turn_in_place_angle: float = setting(
        0.9, 'bearing of the point steered at beyond which the vehicle turns on the spot',
        unit='rad', low=0.2, high=3.14,
    )  # fmt: skip
    goal_tolerance: float = setting(
        0.12, 'a plan is done this near its last waypoint', unit='m', low=0.01, high=1.0
    )
    maximum_deviation: float = setting(
        1.0, 'a vehicle further off its plan reports blocked and waits for another',
        unit='m', low=0.1, high=10.0,
    )  # fmt: skip
    obstacle_stop: bool = setting(True, 'demand scans and stop for what they show in the way')
    vehicle_radius: float = setting(
        0.25, 'circle about the vehicle that holds its body', unit='m', low=0.05, high=2.0
    )
    side_clearance: float = setting(
        0.02, 'room demanded beside the body', unit='m', low=0.0, high=1.0
    )
    stop_distance: float = setting(
        0.2, 'room kept between body and obstacle ahead', unit='m', low=0.02, high=2.0
    )
    reaction_time: float = setting(
        0.35, 'time from an obstacle being there to the brakes being on', unit='s',
        low=0.0, high=2.0,
    )  # fmt: skip
    blocked_timeout: float = setting(
        3.0, 'an obstacle in the way for longer is reported as blocked', unit='s',
        low=0.1, high=120.0,
    )  # fmt: skip
    stuck_timeout: float = setting(
        6.0, 'driving without getting on for longer is reported as blocked', unit='s',
        low=0.5, high=120.0,
    )  # fmt: skip
    agent_timeout: float = setting(
        2.0, 'stop when neither plan nor pose has come for longer', unit='s', low=0.1, high=60.0
    )
    heartbeat_timeout: float = setting(
        0.25, "stop when the agent's heartbeat, once heard, is silent for longer", unit='wall s',
        low=0.15, high=60.0,
    )  # fmt: skip
    pose_timeout: float = setting(
        20.0, 'stop when the newest map pose is older', unit='s', low=0.1, high=600.0
    )
    odometry_timeout: float = setting(
        0.5, 'stop when no odometry has come for longer', unit='s', low=0.05, high=10.0
    )
    scan_timeout: float = setting(
        0.6, 'stop when no scan has come for longer', unit='s', low=0.05, high=10.0
    )
    laser_mount: LaserMountConfig = section(LaserMountConfig)
