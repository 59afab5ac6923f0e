"""Publishers of the driver: odometry, scans, images, sonar, battery, tf, diagnostics."""

import importlib.util
import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import BatteryState, CameraInfo, Image, LaserScan, PointCloud2
from std_msgs.msg import Bool

from explore_slam.data import LaserScan as Scan
from explore_slam.data import RgbdFrame
from explore_slam.geometry import Pose2, rotation_matrix
from explore_slam.messages import (
    camera_info_message,
    cloud_message,
    image_message,
    odometry_message,
    scan_message,
    time_message,
)
from explore_slam.nodes.messages import MESSAGES
from explore_slam.nodes.vehicle_support import LATCHED, diagnostics_message, now_seconds
from explore_slam.vehicle import BaseState, DriverConfig
from explore_slam.vehicle.safety import sonar_points

RELIABLE = QoSProfile(depth=10)
_OPTICAL = rotation_matrix(-math.pi / 2, 0.0, -math.pi / 2)  # of body: x right, y down, z ahead
_BATTERY_LOW, _BATTERY_FULL = 11.0, 12.8  # V


@dataclass(frozen=True)
class Frames:
    """Names of frames; all stand behind the vehicle's name and a slash."""

    vehicle: str
    odometry: str
    base: str
    laser: str
    camera: str

    def name(self, frame: str) -> str:
        """Return the frame's full name."""
        return f'{self.vehicle}/{frame}'


class Latency:
    """The last latencies (s) from a device's last byte to its message."""

    def __init__(self) -> None:
        self._values: deque[float] = deque(maxlen=200)

    def add(self, seconds: float) -> None:
        """Take one."""
        self._values.append(seconds)

    def summary(self) -> dict[str, float]:
        """Return median and 99 % (ms)."""
        if not self._values:
            return {}
        median, high = np.percentile(list(self._values), [50, 99]) * 1e3
        return {'latency_median_ms': float(median), 'latency_p99_ms': float(high)}


class DriverOutputs:
    """All that the driver says; its methods may be called from any thread."""

    def __init__(self, node: Node, frames: Frames, config: DriverConfig, publish_tf: bool) -> None:
        self._node = node
        self._frames = frames
        self.base_values: dict[str, Any] = {}
        topics: dict[str, Any] = {}
        if config.base.use_base:
            topics |= {'odom': Odometry, 'battery': BatteryState, 'motors_on': Bool}
            if config.base.use_sonar:
                topics['sonar'] = PointCloud2
        if config.laser.use_laser:
            topics['scan'] = LaserScan
        if config.camera.use_camera:
            topics |= {
                'camera/rgb/image_raw': Image,
                'camera/depth_registered/image_raw': Image,
                'camera/rgb/camera_info': CameraInfo,
            }
        self._out = {
            name: node.create_publisher(kind, name, RELIABLE) for name, kind in topics.items()
        }
        self._diagnostics = node.create_publisher(DiagnosticArray, '/diagnostics', RELIABLE)
        self._tf: Any = None
        if publish_tf and importlib.util.find_spec('tf2_msgs') is not None:
            from tf2_msgs.msg import TFMessage

            self._tf_type = TFMessage
            self._tf = node.create_publisher(TFMessage, '/tf', QoSProfile(depth=100))
            self._static = node.create_publisher(TFMessage, '/tf_static', LATCHED)
            self._publish_mounts(config)

    def publish_state(self, state: BaseState, with_sonar: bool) -> None:
        """Publish odometry, tf, sonar, battery and whether the motors are on."""
        frames, status = self._frames, state.status
        odometry, base = frames.name(frames.odometry), frames.name(frames.base)
        message = odometry_message(
            MESSAGES, state.odometry, odometry, base, (state.linear, state.angular)
        )
        self._out['odom'].publish(message)
        if self._tf is not None:
            pose = state.odometry.pose
            transform = _transform(
                state.odometry.stamp, odometry, base, (pose.x, pose.y, 0.0), _planar(pose)
            )
            self._tf.publish(self._tf_type(transforms=[transform]))
        if with_sonar and state.sonar:
            points = sonar_points(state.sonar)
            zeros = np.zeros(len(points))
            columns = [('x', points[:, 0]), ('y', points[:, 1]), ('z', zeros)]
            stamp = state.odometry.stamp
            self._out['sonar'].publish(cloud_message(MESSAGES, stamp, base, columns))
        self._publish_battery(state)
        self._out['motors_on'].publish(Bool(data=status.motors_on))
        self.base_values = {
            'battery_V': status.battery,
            'motors_on': status.motors_on,
            'emergency_stop': status.emergency_stop,
            'stalled': state.stalled,
            'front_bumpers': f'{status.front_bumpers:b}',
            'rear_bumpers': f'{status.rear_bumpers:b}',
            'faults': status.faults,
        }

    def _publish_battery(self, state: BaseState) -> None:
        voltage = state.status.battery
        message = BatteryState()
        message.header.stamp = time_message(MESSAGES, state.odometry.stamp)
        message.header.frame_id = self._frames.name(self._frames.base)
        message.voltage = float(voltage)
        unknown = math.nan
        message.current = message.charge = message.capacity = message.temperature = unknown
        message.design_capacity = unknown
        share = (voltage - _BATTERY_LOW) / (_BATTERY_FULL - _BATTERY_LOW)
        message.percentage = float(min(max(share, 0.0), 1.0))
        message.present = True
        charging = bool(state.status.charge_state)
        message.power_supply_status = (
            BatteryState.POWER_SUPPLY_STATUS_CHARGING
            if charging
            else BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
        )
        self._out['battery'].publish(message)

    def publish_scan(self, scan: Scan) -> None:
        """Publish one scan."""
        frame = self._frames.name(self._frames.laser)
        self._out['scan'].publish(scan_message(MESSAGES, scan, frame))

    def publish_frame(self, frame: RgbdFrame) -> None:
        """Publish colour, depth and camera description with one stamp."""
        name = self._frames.name(self._frames.camera)
        info = camera_info_message(MESSAGES, frame.stamp, name, frame.intrinsics)
        self._out['camera/rgb/camera_info'].publish(info)
        depth = image_message(MESSAGES, frame.stamp, name, '16UC1', frame.depth)
        self._out['camera/depth_registered/image_raw'].publish(depth)
        color = image_message(MESSAGES, frame.stamp, name, 'rgb8', frame.rgb)
        self._out['camera/rgb/image_raw'].publish(color)

    def publish_diagnostics(self, parts: Mapping[str, tuple[bytes, str, dict[str, Any]]]) -> None:
        """Publish the state of the parts."""
        message = diagnostics_message(self._node, parts, self._frames.vehicle)
        self._diagnostics.publish(message)

    def _publish_mounts(self, config: DriverConfig) -> None:
        frames, stamp = self._frames, now_seconds(self._node)
        base = frames.name(frames.base)
        transforms = []
        if config.laser.use_laser:
            pose, laser = config.laser_mount.pose, frames.name(frames.laser)
            place = (pose.x, pose.y, 0.0)
            transforms.append(_transform(stamp, base, laser, place, _planar(pose)))
        if config.camera.use_camera:
            mount, camera = config.camera.camera_mount, frames.name(frames.camera)
            turn = rotation_matrix(mount.camera_roll, mount.camera_pitch, mount.camera_yaw)
            rotation = _quaternion(turn @ _OPTICAL)
            place = (mount.camera_x, mount.camera_y, mount.camera_z)
            transforms.append(_transform(stamp, base, camera, place, rotation))
        self._static.publish(self._tf_type(transforms=transforms))


Quaternion = tuple[float, float, float, float]  # x, y, z, w


def _planar(pose: Pose2) -> Quaternion:
    return (0.0, 0.0, math.sin(0.5 * pose.theta), math.cos(0.5 * pose.theta))


def _quaternion(rotation: Any) -> Quaternion:
    """Return the quaternion of a rotation matrix (3, 3); the largest part is taken first."""
    m = np.asarray(rotation)
    squares = np.array([m[0, 0] - m[1, 1] - m[2, 2], m[1, 1] - m[0, 0] - m[2, 2],
                        m[2, 2] - m[0, 0] - m[1, 1], m[0, 0] + m[1, 1] + m[2, 2]])  # fmt: skip
    k = np.zeros((4, 4))
    k[:3, :3] = m + m.T
    k[range(4), range(4)] = squares
    k[3, :3] = k[:3, 3] = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    vector = np.linalg.eigh(k)[1][:, -1]  # Bar-Itzhack (2000): eigenvector of the largest value
    x, y, z, w = (vector * np.copysign(1.0, vector[3])).tolist()
    return (x, y, z, w)


def _transform(
    stamp: float, frame: str, child: str, place: tuple[float, float, float], turn: Quaternion
) -> TransformStamped:
    message = TransformStamped()
    message.header.stamp = time_message(MESSAGES, stamp)
    message.header.frame_id = frame
    message.child_frame_id = child
    move, rotation = message.transform.translation, message.transform.rotation
    move.x, move.y, move.z = map(float, place)
    rotation.x, rotation.y, rotation.z, rotation.w = map(float, turn)
    return message
