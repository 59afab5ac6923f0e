"""What differs from vehicle to vehicle: sensors, mounts, size, speed, frames, clocks.

Every setting has a value for the team, and a vehicle may have another one: `vision` is the team's,
`robot2.vision` that of robot2.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from explore_slam.body import BodyConfig
from explore_slam.errors import ConfigError
from explore_slam.geometry import Pose2, Pose3, quaternion_from_rotation, rotation_matrix
from explore_slam.messages.base import OPTICAL
from explore_slam.settings import Section, section, setting, unknown_name, values_of, with_values
from explore_slam.sweeps import SweepConfig

_UNSET = (math.nan,)


@dataclass(frozen=True)
class VehicleConfig(Section):
    """Settings of one vehicle."""

    vision: str = setting(
        'agent',
        'Where features are extracted: in the agent, from images; on the vehicle, which then '
        'publishes landmarks; none for a vehicle without camera',
        choices=('agent', 'vehicle', 'none'),
        tier='basic',
    )
    use_laser: bool = setting(True, 'Whether the vehicle has a laser scanner', tier='basic')
    navigator: str = setting(
        'follower',
        'What drives the vehicle along its plans: follower; nav2 by the action '
        '<vehicle>/navigate_to_pose; nav2_path by <vehicle>/follow_path',
        tier='basic',
    )
    body: BodyConfig = section(BodyConfig)
    laser_mount: tuple[float, ...] = setting(
        _UNSET,
        'Pose x (m), y (m), yaw (rad) of the laser in the vehicle frame, used if /tf_static does '
        'not provide it; a single NaN: laser_x, laser_y, laser_yaw',
        tier='basic',
    )
    camera_mount: tuple[float, ...] = setting(
        _UNSET,
        'Pose x, y, z (m), roll, pitch, yaw (rad) of the camera body in the vehicle frame, used '
        'if /tf_static does not provide it; a single NaN: camera_x to camera_yaw',
        tier='basic',
    )
    pairing_tolerance: float = setting(
        0.02,  # half the period of a Kinect at 30 Hz is 0.017 s; its sensors are not synchronized
        'Largest difference of the stamps of a colour and a depth image of one frame',
        unit='s',
        low=0.0,
        high=1.0,
    )
    sweep: SweepConfig = section(SweepConfig)
    odom_frame: str = setting(
        '', "Odometry frame; empty: as the vehicle's odometry messages name it", tier='basic'
    )
    robot_base_frame: str = setting(
        '', "Base frame; empty: as the vehicle's odometry messages name it", tier='basic'
    )
    odom_time_offset: float = setting(
        0.0, 'Added to the stamps of odometry', unit='s', low=-1e10, high=1e10
    )
    scan_time_offset: float = setting(
        0.0, 'Added to the stamps of scans', unit='s', low=-1e10, high=1e10
    )
    camera_time_offset: float = setting(
        0.0, 'Added to the stamps of images and of landmarks', unit='s', low=-1e10, high=1e10
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, count in (('laser_mount', 3), ('camera_mount', 6)):
            values = getattr(self, name)
            if len(values) == 1 and math.isnan(values[0]):
                object.__setattr__(self, name, _UNSET)  # NaN equals no other one but itself
            elif not (len(values) == count and all(map(math.isfinite, values))):
                raise ConfigError(f'{name} is {list(values)}, expected {count} finite numbers')

    @property
    def has_sensor(self) -> bool:
        """Whether the vehicle has a sensor that maps: a laser or a camera."""
        return self.use_laser or self.vision != 'none'

    @property
    def laser_pose(self) -> Pose2 | None:
        """Pose of the laser, None where it is not set."""
        return Pose2.from_array(self.laser_mount) if len(self.laser_mount) == 3 else None

    @property
    def optical_pose(self) -> Pose3 | None:
        """Pose of the camera's optical frame, None where it is not set."""
        if len(self.camera_mount) != 6:
            return None
        x, y, z, roll, pitch, yaw = self.camera_mount
        body = Pose3((x, y, z), quaternion_from_rotation(rotation_matrix(roll, pitch, yaw)))
        return body.compose(Pose3((0.0, 0.0, 0.0), OPTICAL))


def vehicle_names(vehicles: Iterable[str]) -> list[str]:
    """Return the names of all parameters of single vehicles: 'robot1.vision' and so on."""
    return [f'{name}.{leaf}' for name in vehicles for leaf in values_of(VehicleConfig())]


def vehicle_settings(
    team: VehicleConfig, values: Mapping[str, Any], vehicles: Iterable[str]
) -> dict[str, VehicleConfig]:
    """Return vehicle -> settings: those of the team, and its own '<vehicle>.<setting>'.

    ConfigError for an unknown vehicle or setting, and for a value that does not fit.
    """
    names = list(vehicles)
    own: dict[str, dict[str, Any]] = {name: {} for name in names}
    for full, value in values.items():
        vehicle, _, leaf = full.partition('.')
        if vehicle not in own:
            raise ConfigError(unknown_name(full, vehicle_names(names)))
        own[vehicle][leaf] = value
    made = {}
    for name in names:
        try:
            made[name] = with_values(team, own[name])
        except ConfigError as error:
            raise ConfigError(f'{name}: {error}') from error
    return made


def settings_of_vehicles(
    values: Mapping[str, Any], vehicles: Iterable[str]
) -> dict[str, VehicleConfig]:
    """Return vehicle -> settings from values of the team and of single vehicles by name.

    Values of other vehicles are ignored: a recording may hold some of a team only.
    """
    names = list(vehicles)
    team = with_values(VehicleConfig(), {n: v for n, v in values.items() if '.' not in n})
    own = {n: v for n, v in values.items() if '.' in n and n.partition('.')[0] in names}
    return vehicle_settings(team, own, names)


def split_vehicle_values(values: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return (settings of vehicles, all others) of values by name."""
    known = values_of(VehicleConfig())
    own = {name: value for name, value in values.items() if '.' in name or name in known}
    return own, {name: value for name, value in values.items() if name not in own}
