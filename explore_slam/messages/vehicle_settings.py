"""What differs from vehicle to vehicle: sensors, mounts, size, speed, frames, clocks.

Every setting has a value for the team, and a vehicle may have another one: `vision` is the team's,
`robot2.vision` that of robot2.
"""

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from explore_slam.battery import BatteryConfig
from explore_slam.body import BodyConfig, ViewConfig
from explore_slam.errors import ConfigError
from explore_slam.geometry import Array, Pose2, Pose3, quaternion_from_rotation, rotation_matrix
from explore_slam.messages.base import OPTICAL
from explore_slam.messages.topics import SensorTopic, Topic, TopicKind, VehicleTopic, sensor_topic
from explore_slam.settings import Section, section, setting, unknown_name, values_of, with_values
from explore_slam.sweeps import SweepConfig

_UNSET = (math.nan,)
_NONE = ('',)
_NAME = re.compile(r'[A-Za-z_]\w*(/[A-Za-z_]\w*)*')


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
    odometry: str = setting(
        'wheels',
        'What the odometry of the vehicle is measured by: its wheels (odom); wheels+gyro, with '
        'the turns of a gyroscope (imu); scan, by matching the scans alone, for a vehicle without '
        'wheel odometry or with one that is wrong',
        choices=('wheels', 'scan', 'wheels+gyro'),
    )
    imu: str = setting('imu', 'Topic of its IMU (sensor_msgs/Imu), below its namespace')
    use_laser: bool = setting(
        True,
        'Whether the vehicle has a laser scanner; without one, and with vision: agent, scans are '
        'made of its depth images',
        tier='basic',
    )
    scans: tuple[str, ...] = setting(
        ('scan',),
        'Topics of its laser scanners (LaserScan), below its namespace; a single empty name: none',
        tier='basic',
    )
    clouds: tuple[str, ...] = setting(
        _NONE,
        'Topics of its 3-D lidars (PointCloud2), below its namespace; a single empty name: none',
    )
    cloud_lowest: float = setting(
        0.1,
        'Height above the floor, in the base frame, from which points of a 3-D lidar count as '
        'obstacles',
        unit='m',
        low=-10.0,
        high=10.0,
    )
    cloud_highest: float = setting(
        1.0,
        'Height up to which they do',
        unit='m',
        low=-10.0,
        high=10.0,
    )
    cameras: tuple[str, ...] = setting(
        ('camera',),
        'Names of its RGB-D cameras, with which their topics begin (<camera>/rgb/image_raw, '
        '<camera>/depth_registered/image_raw, <camera>/rgb/camera_info)',
        tier='basic',
    )
    navigator: str = setting(
        'follower',
        'What drives the vehicle along its plans: follower; nav2 by the action '
        '<vehicle>/navigate_to_pose; nav2_path by <vehicle>/follow_path',
        tier='basic',
    )
    cmd_vel_type: str = setting(
        'auto',
        'Type in which the path follower sends cmd_vel: twist, stamped (TwistStamped), or auto: '
        'as its subscribers take it. Our driver and simulator take both',
        choices=('auto', 'twist', 'stamped'),
    )
    body: BodyConfig = section(BodyConfig)
    view: ViewConfig = section(ViewConfig)
    battery: BatteryConfig = section(BatteryConfig)
    battery_topic: str = setting(
        'battery',
        'Topic of its battery (BatteryState), below its namespace; subscribed to where '
        'battery_low or battery_critical is set',
    )
    laser_mount: tuple[float, ...] = setting(
        _UNSET,
        'Pose x (m), y (m), yaw (rad) of the laser in the vehicle frame, used if /tf_static does '
        'not provide it; of several lasers one after the other, in the order of scans; a single '
        'NaN: laser_x, laser_y, laser_yaw',
        tier='basic',
    )
    cloud_mount: tuple[float, ...] = setting(
        _UNSET,
        'Pose x, y, z (m), roll, pitch, yaw (rad) of the 3-D lidar in the vehicle frame, used if '
        '/tf_static does not provide it; of several in the order of clouds; a single NaN: not set',
    )
    camera_mount: tuple[float, ...] = setting(
        _UNSET,
        'Pose x, y, z (m), roll, pitch, yaw (rad) of the camera body in the vehicle frame, used '
        'if /tf_static does not provide it; of several cameras in the order of cameras; a single '
        'NaN: camera_x to camera_yaw',
        tier='basic',
    )
    imu_mount: tuple[float, ...] = setting(
        _UNSET,
        'Roll, pitch, yaw (rad) of the IMU in the vehicle frame, used if /tf_static does not '
        'provide it; a single NaN: its axes are those of the vehicle (x forward, z up)',
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
    imu_time_offset: float = setting(
        0.0, 'Added to the stamps of the IMU', unit='s', low=-1e10, high=1e10
    )
    scan_time_offset: float = setting(
        0.0, 'Added to the stamps of scans', unit='s', low=-1e10, high=1e10
    )
    camera_time_offset: float = setting(
        0.0, 'Added to the stamps of images and of landmarks', unit='s', low=-1e10, high=1e10
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for setting_name in ('scans', 'clouds', 'cameras'):
            _check_topics(setting_name, getattr(self, setting_name))
        _check_topics('battery_topic', (self.battery_topic,))
        for name, each, sensors in (
            ('laser_mount', 3, self.scans),
            ('cloud_mount', 6, self.clouds),
            ('camera_mount', 6, self.cameras),
            ('imu_mount', 3, (self.imu,)),
        ):
            values = getattr(self, name)
            count = each * len(sensors)
            if len(values) == 1 and math.isnan(values[0]):
                object.__setattr__(self, name, _UNSET)  # NaN equals no other one but itself
            elif not (len(values) == count and all(map(math.isfinite, values))):
                raise ConfigError(f'{name} is {list(values)}, expected {count} finite numbers')
        if not _NAME.fullmatch(self.imu):
            raise ConfigError(
                f'imu is {self.imu!r}, expected a name below the namespace of the vehicle, such '
                "as 'imu/data', without a slash at the beginning or the end"
            )
        if self.odometry == 'scan' and not self.use_laser:
            raise ConfigError('odometry is scan and use_laser false: scans are what it needs')
        if not self.cloud_lowest < self.cloud_highest:
            raise ConfigError(
                f'cloud_lowest is {self.cloud_lowest} m and cloud_highest {self.cloud_highest} m, '
                'expected the former to be less'
            )

    @property
    def laser_topics(self) -> list[SensorTopic]:
        """Topics of all lasers, 3-D lidars included; none with use_laser false."""
        if not self.use_laser:
            return []
        found = [sensor_topic(TopicKind.SCAN, name) for name in self.scans if name]
        found += [sensor_topic(TopicKind.CLOUD, name) for name in self.clouds if name]
        return [found[0]._replace(sensor='')] if len(found) == 1 else found

    def camera_topics(self, kinds: Iterable[TopicKind]) -> list[SensorTopic]:
        """Return the topics of all cameras, of some kinds."""
        found = [sensor_topic(kind, name) for name in self.cameras for kind in kinds]
        return [item._replace(sensor='') for item in found] if len(self.cameras) == 1 else found

    @property
    def has_camera_scans(self) -> bool:
        """Whether the agent makes scans of the images of the vehicle, which has no laser."""
        return not self.use_laser and self.vision == 'agent'

    @property
    def has_sensor(self) -> bool:
        """Whether the vehicle has a sensor that maps: a laser or a camera."""
        return self.use_laser or self.vision != 'none'

    def laser_pose(self, sensor: str = '') -> Pose2 | None:
        """Return the pose of a laser, None where it is not set; '' is the only one."""
        numbers = _mount_of(sensor, self.scans, self.laser_mount, 3)
        return None if numbers is None else Pose2.from_array(numbers)

    def cloud_pose(self, sensor: str = '') -> Pose3 | None:
        """Return the pose of a 3-D lidar, None where it is not set; '' is the only one."""
        numbers = _mount_of(sensor, self.clouds, self.cloud_mount, 6)
        return None if numbers is None else _pose_in_space(numbers)

    @property
    def imu_rotation(self) -> Array | None:
        """Rotation (3, 3) of the IMU in the vehicle frame, None where it is not set."""
        if len(self.imu_mount) != 3:
            return None
        roll, pitch, yaw = self.imu_mount
        return rotation_matrix(roll, pitch, yaw)

    def optical_pose(self, sensor: str = '') -> Pose3 | None:
        """Return the pose of a camera's optical frame, None where it is not set."""
        numbers = _mount_of(sensor, self.cameras, self.camera_mount, 6)
        if numbers is None:
            return None
        return _pose_in_space(numbers).compose(Pose3((0.0, 0.0, 0.0), OPTICAL))


def odometry_topic(config: VehicleConfig) -> Topic:
    """Return the topic of the odometry that is to be followed: of the base, or of its scans."""
    return VehicleTopic.SCAN_ODOMETRY if config.odometry == 'scan' else TopicKind.ODOMETRY


def _mount_of(
    sensor: str, sensors: tuple[str, ...], numbers: tuple[float, ...], count: int
) -> tuple[float, ...] | None:
    """Return the numbers of one sensor out of those of all, None where they are not set."""
    if len(numbers) != count * len(sensors) or (sensor and sensor not in sensors):
        return None
    index = sensors.index(sensor) if sensor else 0
    return numbers[count * index : count * (index + 1)]


def _pose_in_space(numbers: tuple[float, ...]) -> Pose3:
    x, y, z, roll, pitch, yaw = numbers
    return Pose3((x, y, z), quaternion_from_rotation(rotation_matrix(roll, pitch, yaw)))


def _check_topics(setting_name: str, names: tuple[str, ...]) -> None:
    """Raise ConfigError unless these are different relative names, or a single empty one."""
    if names == _NONE and setting_name not in ('cameras', 'battery_topic'):
        return
    if not names or len(set(names)) != len(names) or not all(map(_NAME.fullmatch, names)):
        raise ConfigError(
            f'{setting_name} is {list(names)}, expected different names below the namespace of '
            "the vehicle, such as 'front/scan', without a slash at the beginning or the end"
        )


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
