"""Mounts of the sensors of one vehicle: from /tf_static, or from the vehicle's settings.

The frame of a message (header.frame_id) is looked up below the vehicle's base frame, which its
odometry messages name (child_frame_id). Where the tree of transforms does not hold it, the mount
comes from the settings.
"""

import logging
import math
from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from explore_slam.data import LaserScan
from explore_slam.geometry import Array, Pose2, Pose3, roll_pitch_yaw, wrap_angle
from explore_slam.messages.base import OPTICAL
from explore_slam.messages.cloud_scans import cloud_scan
from explore_slam.messages.transforms import TransformTree, frame_name
from explore_slam.messages.vehicle_settings import VehicleConfig
from explore_slam.mounts import ExplicitMounts

logger = logging.getLogger(__name__)

# names that base frames have by convention (REP-105, Kobuki, TurtleBot)
_BASE_FRAMES = ('base_link', 'base_footprint')
# Chosen by hand; test_sensor_mounts shows what they decide.
_TOLERANCE = 0.02  # m and rad by which transform and setting may differ without a warning
_LEVEL = math.radians(10.0)  # tilt of a laser from which its scans are no section of the walls
_UPRIGHT = 0.9  # vertical part of the z axis of a camera frame that is no optical frame


@dataclass(frozen=True)
class Mount:
    """The mount of a sensor: pose in the vehicle frame and where it comes from.

    pose: of the laser in the plane, or of the optical frame of the camera; None: the team's.
    inverted: the laser is mounted upside down, so that its beams turn the other way.
    """

    source: str
    pose: Pose2 | Pose3 | None
    inverted: bool = False

    def __str__(self) -> str:
        if self.pose is None:
            return self.source
        if isinstance(self.pose, Pose2):
            x, y, yaw = self.pose
            turned = ', upside down' if self.inverted else ''
            return (
                f'x {x:.3f} m, y {y:.3f} m, yaw {math.degrees(yaw):.1f}°{turned}, '
                f'from {self.source}'
            )
        x, y, z = self.pose.position
        return f'x {x:.3f} m, y {y:.3f} m, z {z:.3f} m, from {self.source}'


class SensorMounts:
    """Mounts of the sensors of one vehicle by the frame of their messages.

    tree: transforms, which may grow while messages arrive.
    config: settings of the vehicle.
    team: mounts that the settings of the team give explicitly.
    mapping: the node draws a map, so that a mount that is missing or comes late is a warning; in
    the nodes of a vehicle, which do not wait for transforms, it is information.
    used: frame -> mount of every sensor so far.
    """

    def __init__(
        self,
        vehicle: str,
        tree: TransformTree,
        config: VehicleConfig | None = None,
        team: ExplicitMounts | None = None,
        mapping: bool = True,
    ) -> None:
        self.vehicle = vehicle
        self.config = config or VehicleConfig()
        self.used: dict[str, Mount] = {}
        self._tree = tree
        self._mapping = mapping
        self._team = team or ExplicitMounts()
        self._odometry_base = self._odometry_frame = ''
        self._warned: set[str] = set()
        # setting and frame -> sensor and its pose by the transforms, of several sensors
        self._places: dict[tuple[str, str], tuple[str, Pose3]] = {}
        self._sensors: dict[tuple[str, str], str] = {}  # setting and frame -> its first sensor
        self._shared: set[tuple[str, str]] = set()  # setting and frame of several sensors

    @property
    def base(self) -> str:
        """Base frame: as set, as the odometry messages name it, or one of the usual names."""
        named = self.config.robot_base_frame or self._odometry_base
        if named:
            return frame_name(named)
        usual = [f'{self.vehicle}/{name}' for name in _BASE_FRAMES] + list(_BASE_FRAMES)
        return next((name for name in usual if name in self._tree), usual[0])

    @property
    def odom(self) -> str:
        """Odometry frame: as set, as the odometry messages name it, or '<vehicle>/odom'."""
        return frame_name(self.config.odom_frame or self._odometry_frame) or f'{self.vehicle}/odom'

    @property
    def has_odometry(self) -> bool:
        """Whether an odometry message has come, or the frame is set."""
        return bool(self.config.odom_frame or self._odometry_frame)

    def add_odometry(self, message: Any) -> None:
        """Take the names of base and odometry frame from an odometry message."""
        self._odometry_base = message.child_frame_id
        self._odometry_frame = message.header.frame_id

    def is_known(self, frame: str) -> bool:
        """Return whether the transforms join a sensor's frame to the base frame."""
        return self._tree.lookup(self.base, frame) is not None

    def place_scan(self, scan: LaserScan, frame: str, sensor: str = '') -> LaserScan:
        """Return a scan with the mount of its laser, and with the vehicle's settings of sweeps.

        sensor: which of the vehicle's lasers it is from, as in LaserScan.
        """
        scan = replace(scan, timing=self.config.sweep.record)
        mount = self._laser(frame, sensor)
        if not isinstance(mount.pose, Pose2):
            return scan
        if mount.inverted:
            scan = replace(scan, angle_min=-scan.angle_min, angle_increment=-scan.angle_increment)
        return replace(scan, mount=mount.pose)

    def place_cloud(self, message: Any, sensor: str = '') -> LaserScan:
        """Return a PointCloud2 of a 3-D lidar as a scan with the mount of the lidar.

        Times of its points go before the settings of sweeps, which do not know where it begins.
        """
        config, frame = self.config, message.header.frame_id
        pose = self._cloud(frame, sensor).pose
        lidar = pose if isinstance(pose, Pose3) else Pose3((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        scan = cloud_scan(message, lidar, config.cloud_lowest, config.cloud_highest)
        if scan.timing.duration is not None:
            return scan
        return replace(scan, timing=config.sweep.record)

    def imu_rotation(self, frame: str) -> Array | None:
        """Return the rotation (3, 3) of the IMU in the vehicle frame; None: its axes are the same.

        Nothing is said of an IMU without a mount: whether it turns as the vehicle does shows when
        that turns (explore_slam.agent.odometry_sources.gyro_check).
        """
        found = self._tree.lookup(self.base, frame)
        if found is None:
            return self.config.imu_rotation
        if frame not in self.used:
            self.used[frame] = Mount('/tf_static', found)
            logger.info('%s: mount of %s: %s', self.vehicle, frame, self.used[frame])
        return found.rotation

    def optical_pose(self, frame: str, sensor: str = '') -> Pose3 | None:
        """Return the pose of a camera's optical frame; None: that of the team's settings.

        sensor: which of the vehicle's cameras it is, as in RgbdFrame.
        """
        pose = self._camera(frame, sensor).pose
        return pose if isinstance(pose, Pose3) else None

    def check_registered(self, color_frame: str, depth_frame: str) -> None:
        """Warn, once, of depth images that are not in the frame of the colour images."""
        if frame_name(color_frame) != frame_name(depth_frame):
            self._warn_once(
                f'registered {depth_frame}',
                f'depth images are in frame {depth_frame!r}, colour images in {color_frame!r}; '
                'they are used as if they were registered (depth_image_proc) to the colour image',
            )

    def _cloud(self, frame: str, sensor: str) -> Mount:
        own = self.config.cloud_pose(sensor)
        found = self._lookup(frame, own, None, 'cloud_mount', sensor)
        if found is None:
            return self._use(frame, self._from_settings(own, True, 'cloud_mount'), 'cloud_mount')
        if own is not None and _differ_in_space(found, own):
            self._warn_once(
                f'cloud {frame}',
                f'/tf_static has the lidar ({frame}) at {_text(found)}, the settings at '
                f'{_text(own)}; /tf_static is used',
            )
        return self._use(frame, Mount('/tf_static', found), 'cloud_mount')

    def _laser(self, frame: str, sensor: str) -> Mount:
        own = self.config.laser_pose(sensor)
        team = None if sensor else self._team.laser  # it cannot be that of several lasers
        found = self._lookup(frame, own, team, 'laser_mount', sensor)
        if found is None:
            mount = self._from_settings(own or team, own is not None, 'laser_mount')
            return self._use(frame or sensor, mount, 'laser_mount')
        rotation = found.rotation
        ahead = math.atan2(rotation[1, 0], rotation[0, 0])
        pose = Pose2(found.position[0], found.position[1], ahead)
        vertical = float(rotation[2, 2])
        if abs(vertical) < math.cos(_LEVEL):
            self._warn_once(
                f'tilt {frame}',
                f'laser frame {frame!r} is tilted by {math.degrees(math.acos(abs(vertical))):.0f}°'
                '; its scans are used as if it were level',
            )
        expected = own or team
        if expected is not None and _differ(pose, expected):
            self._warn_once(
                f'laser {frame}',
                f'/tf_static has the laser ({frame}) at x {pose.x:.3f}, y {pose.y:.3f}, '
                f'yaw {pose.theta:.3f}, the settings at x {expected.x:.3f}, '
                f'y {expected.y:.3f}, yaw {expected.theta:.3f}; /tf_static is used',
            )
        return self._use(frame, Mount('/tf_static', pose, vertical < 0.0), 'laser_mount')

    def _camera(self, frame: str, sensor: str) -> Mount:
        own = self.config.optical_pose(sensor)
        team = None if sensor else self._team.camera
        found = self._lookup(frame, own, team, 'camera_mount', sensor)
        if found is None:
            mount = self._from_settings(own or team, own is not None, 'camera_mount')
            return self._use(frame or sensor, mount, 'camera_mount')
        if abs(float(found.rotation[2, 2])) > _UPRIGHT and 'optical' not in frame:
            # the z axis of an optical frame looks forward: this is the body of the camera
            self._warn_once(
                f'body {frame}',
                f'image frame {frame!r} is no optical frame (REP-103): its z axis points up; '
                'it is taken as the body of the camera',
            )
            found = found.compose(Pose3((0.0, 0.0, 0.0), OPTICAL))
        expected = own or team
        if expected is not None and _differ_in_space(found, expected):
            self._warn_once(
                f'camera {frame}',
                f'/tf_static and the settings have the camera ({frame}) at different poses: '
                f'{_body_text(found)} and {_body_text(expected)}; /tf_static is used',
            )
        return self._use(frame, Mount('/tf_static', found), 'camera_mount')

    def _lookup(
        self, frame: str, own: object, team: object, setting: str, sensor: str
    ) -> Pose3 | None:
        """Return the pose of a sensor's frame; None where the settings are to be used.

        own, team: mounts in the settings, None where they have none. That of the vehicle decides
        where static transforms contradict each other, as when several robots publish one frame,
        and where several sensors of the vehicle have one frame.
        """
        found = self._tree.lookup(self.base, frame)
        if sensor and self._is_shared(frame, sensor, setting, own) and own is not None:
            return None
        is_set = own is not None or (team is not None and not self._mapping)  # of one vehicle
        if found is not None and is_set and self._tree.is_contradicted(self.base, frame):
            self._warn_once(
                f'several {frame}',
                f'/tf_static has had different poses of {frame}, as if several robots published '
                f'it; {self.vehicle}.{setting} is used',
            )
            return None
        if found is not None and sensor:
            self._check_places(frame, sensor, setting, found)
        return found

    def _check_places(self, frame: str, sensor: str, setting: str, found: Pose3) -> None:
        """Name transforms of several sensors that contradict each other."""
        remedy = f'correct the transforms, or set {self.vehicle}.{setting}'
        if self._tree.is_contradicted(self.base, frame):
            self._warn_once(
                f'several {frame}',
                f'/tf_static has had different poses of {frame} ({sensor}); the newest, '
                f'{_text(found)}, is used; {remedy}',
            )
        for other, (name, place) in self._places.items():
            if other[0] == setting and other[1] != frame and not _differ_in_space(found, place):
                pair = ' and '.join(sorted((f'{name} ({other[1]})', f'{sensor} ({frame})')))
                self._warn_once(
                    f'same place {pair}',
                    f'{pair} are at the same pose {_text(found)} by /tf_static; {remedy}',
                )
        self._places[setting, frame] = (sensor, found)

    def _is_shared(self, frame: str, sensor: str, setting: str, own: object) -> bool:
        """Return whether another sensor has the same frame; name both once."""
        owner = self._sensors.setdefault((setting, frame), sensor)
        if owner == sensor and (setting, frame) not in self._shared:
            return False
        self._shared.add((setting, frame))
        if owner != sensor:
            name = f'{self.vehicle}.{setting}'
            self._warn_once(
                f'shared {setting} {frame}',
                f'{owner} and {sensor} have the same frame {frame!r}: '
                + (f'{name} is used' if own is not None else f'set their frames, or {name}'),
            )
        return True

    def _from_settings(self, pose: Pose2 | Pose3 | None, own: bool, name: str) -> Mount:
        if pose is None:
            return Mount('the default settings', None)
        return Mount(f'{self.vehicle}.{name}' if own else 'the settings of the team', pose)

    def _use(self, frame: str, mount: Mount, setting: str) -> Mount:
        last = self.used.get(frame)
        if last == mount:
            return mount
        self.used[frame] = mount
        name = frame or 'a sensor'
        if self._mapping and last is None and mount.pose is None:
            logger.warning(
                '%s: no transform leads from %s to %s, and %s.%s is not set: the default mount '
                'is used, and the map is wrong if the sensor is elsewhere; publish the '
                'transform on /tf_static (robot_state_publisher), or set it',
                self.vehicle, self.base, name, self.vehicle, setting,
            )  # fmt: skip
        elif self._mapping and last is not None and last.source != mount.source:
            logger.warning(
                '%s: the mount of %s is now %s; until now it was %s, with which the map so far '
                'was drawn: call the service reset unless they are the same',
                self.vehicle, name, mount, last,
            )  # fmt: skip
        else:
            logger.info('%s: mount of %s: %s', self.vehicle, name, mount)
        return mount

    def _warn_once(self, key: str, text: str) -> None:
        if key not in self._warned:
            self._warned.add(key)
            logger.warning('%s: %s', self.vehicle, text)

    def report(self) -> Mapping[str, str]:
        """Return frame -> mount and its source, in words."""
        return {frame: str(mount) for frame, mount in sorted(self.used.items())}


def shared_frames(mounts: Iterable[SensorMounts], own_transforms: Container[str]) -> list[str]:
    """Return a sentence for every frame that several vehicles of a team share.

    own_transforms: vehicles whose transforms are in their namespace, where they mix with none.
    """
    odometry: dict[str, list[str]] = {}
    sensors: dict[str, list[str]] = {}
    for one in mounts:
        if one.vehicle in own_transforms:
            continue
        if one.has_odometry:
            odometry.setdefault(one.odom, []).append(one.vehicle)
        for frame, mount in one.used.items():
            if mount.source == '/tf_static':
                sensors.setdefault(frame, []).append(one.vehicle)
    advice = (
        "give each vehicle's nodes a frame prefix, or remap /tf and /tf_static to tf and "
        'tf_static in its namespace'
    )

    def settings(names: Iterable[str]) -> str:
        return ' and '.join(f'{name}.laser_mount or camera_mount' for name in names)

    return [
        f'{" and ".join(names)} have the same odometry frame {frame!r}: the transform from the '
        f'map to it on /tf jumps between them; {advice}'
        for frame, names in odometry.items()
        if len(names) > 1
    ] + [
        f'{" and ".join(names)} have the same sensor frame {frame!r}: all use the mount that was '
        f'published last on /tf_static, which is wrong unless their mounts are equal; {advice}, '
        f'or set {settings(names)}, which are used where transforms contradict each other'
        for frame, names in sensors.items()
        if len(names) > 1
    ]


def _differ(a: Pose2, b: Pose2) -> bool:
    turn = abs(wrap_angle(a.theta - b.theta))
    return math.dist(a[:2], b[:2]) > _TOLERANCE or turn > _TOLERANCE


def _differ_in_space(a: Pose3, b: Pose3) -> bool:
    cosine = 0.5 * (float(np.trace(a.rotation.T @ b.rotation)) - 1.0)
    turn = math.acos(min(max(cosine, -1.0), 1.0))
    return math.dist(a.position, b.position) > _TOLERANCE or turn > _TOLERANCE


def _body_text(pose: Pose3) -> str:
    """Return the pose of the body of a camera by that of its optical frame, in words."""
    return _text(pose.compose(Pose3((0.0, 0.0, 0.0), OPTICAL).inverse()))


def _text(body: Pose3) -> str:
    values = (*body.position, *roll_pitch_yaw(body.rotation))
    return '(' + ', '.join(f'{round(value, 3) + 0.0:.3f}' for value in values) + ')'  # no -0.000
