"""Settings that several nodes declare, and the start poses of a team."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from explore_slam.errors import ConfigError
from explore_slam.geometry import Pose2
from explore_slam.settings import Section, setting

# a vehicle's name is its namespace, and the first part of its parameters' and frames' names
_NAME = re.compile(r'[A-Za-z_][A-Za-z0-9_]*')


@dataclass(frozen=True)
class LifecycleConfig(Section):
    """Parameters that all managed nodes have."""

    autostart: bool = setting(
        True,
        'Configure and activate the node at its start; false: wait for its service change_state',
        tier='basic',
    )


@dataclass(frozen=True)
class TeleoperationConfig(Section):
    """How long commands by hand go before those of the path follower."""

    teleop_timeout: float = setting(
        3.0,
        'Time after the last message on cmd_vel_teleop until the path follower drives again',
        unit='s',
        low=0.1,
        high=600.0,
        tier='basic',
    )


def vehicles() -> Any:
    """Declare the names of the vehicles."""
    return setting(
        ('robot1', 'robot2'), 'Names of the vehicles, which are their namespaces', tier='basic'
    )


def map_frame() -> Any:
    """Declare the common fixed frame."""
    return setting('map', 'Frame of the map, common to all vehicles (REP-105)')


def odom_frame() -> Any:
    """Declare the odometry frame."""
    return setting('odom', "Odometry frame, prefixed with the vehicle's name and a slash")


def robot_base_frame() -> Any:
    """Declare the base frame."""
    return setting('base_link', "Base frame, prefixed with the vehicle's name and a slash")


def start_poses(
    names: Sequence[str], values: Sequence[float], setting_name: str = 'start_poses'
) -> dict[str, Pose2 | None]:
    """Return vehicle -> start pose from x (m), y (m), heading (rad) of each; None where it is nan.

    setting_name: for messages. ConfigError unless the names differ and the numbers fit them.
    """
    check_names(names)
    if len(values) != 3 * len(names):
        raise ConfigError(
            f'{setting_name} has {len(values)} numbers, expected {3 * len(names)}: '
            f'x, y and heading of each of {list(names)}'
        )
    poses: dict[str, Pose2 | None] = {}
    for i, name in enumerate(names):
        numbers = [float(value) for value in values[3 * i : 3 * i + 3]]
        if any(math.isnan(value) for value in numbers):
            if not all(math.isnan(value) for value in numbers):
                raise ConfigError(
                    f'the start pose of {name} is {numbers}, expected three numbers, or nan three '
                    'times where it is unknown'
                )
            poses[name] = None
        else:
            poses[name] = Pose2(*numbers)
    return poses


def check_names(names: Sequence[str]) -> None:
    """Raise ConfigError unless there is a vehicle and all names differ and are names of ROS."""
    if not names or len(set(names)) != len(names):
        raise ConfigError(f'vehicles is {list(names)}, expected one name or more, all different')
    for name in names:
        if not _NAME.fullmatch(name):
            raise ConfigError(
                f'vehicles has the name {name!r}, expected letters, digits and underscores, the '
                'first not a digit: it is the namespace of the vehicle'
            )
