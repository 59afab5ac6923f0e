"""Publishers of the driver: odometry, scans, images, sonar, battery, transforms, diagnostics."""

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Bool

from explore_slam.data import LaserScan, RgbdFrame
from explore_slam.messages import (
    camera_transform_message,
    cloud_message,
    odometry_message,
    planar_transform_message,
    scan_message,
    time_message,
)
from explore_slam.messages.frame_pairing import frame_messages
from explore_slam.messages.frames import FrameNames
from explore_slam.messages.topics import GlobalTopic, Topic, TopicKind, VehicleTopic
from explore_slam.nodes.endpoints import TransformBroadcaster, publisher
from explore_slam.nodes.node_support import diagnostics_message, now_seconds
from explore_slam.nodes.ros_types import MESSAGES
from explore_slam.vehicle import BaseState, DriverConfig

# V; approximate voltages of an empty and of a full lead-acid battery of 12 V; others in proportion
_BATTERY_EMPTY, _BATTERY_FULL, _BATTERY_NOMINAL = 11.0, 12.8, 12.0
_TWICE_NOMINAL = 18.0  # V from which a battery has 24 V: one of 12 V has less while it is charged
_LATENCIES = 200  # newest samples kept


def battery_charge(voltage: float, nominal: float = 0.0) -> float:
    """Return the approximate charge (0 to 1) of a lead-acid battery; NaN without a voltage.

    nominal: V, e.g. 12 or 24; 0: 12, or 24 where the voltage shows that.
    """
    if voltage <= 0.0:
        return math.nan
    if nominal <= 0.0:
        nominal = _BATTERY_NOMINAL * (2.0 if voltage > _TWICE_NOMINAL else 1.0)
    scaled = voltage * _BATTERY_NOMINAL / nominal
    charge = (scaled - _BATTERY_EMPTY) / (_BATTERY_FULL - _BATTERY_EMPTY)
    return min(max(charge, 0.0), 1.0)


class Latency:
    """The newest latencies (s) from a device's last byte to its message."""

    def __init__(self) -> None:
        self._values: deque[float] = deque(maxlen=_LATENCIES)

    def add(self, seconds: float) -> None:
        """Add one sample."""
        self._values.append(seconds)

    def summary(self) -> dict[str, float]:
        """Return median and 99th percentile (ms); empty before the first sample."""
        if not self._values:
            return {}
        median, high = np.percentile(list(self._values), [50, 99]) * 1e3
        return {'latency_median_ms': float(median), 'latency_p99_ms': float(high)}


class DriverOutputs:
    """All publishers of the driver; its methods may be called from any thread."""

    def __init__(
        self, node: Node, frames: FrameNames, config: DriverConfig, publish_tf: bool
    ) -> None:
        self._node = node
        self._frames = frames
        self._battery_nominal = config.base.battery_nominal_voltage
        self.base_values: dict[str, Any] = {}
        topics: list[Topic] = []
        if config.base.enable_base:
            topics += [TopicKind.ODOMETRY, VehicleTopic.BATTERY, VehicleTopic.MOTORS_ON]
            if config.base.use_sonar:
                topics.append(VehicleTopic.SONAR)
        if config.laser.enable_laser:
            topics.append(TopicKind.SCAN)
        if config.camera.enable_camera:
            topics += [TopicKind.COLOR, TopicKind.DEPTH, TopicKind.CAMERA_INFO]
        self._out = {topic: publisher(node, topic) for topic in topics}
        self._diagnostics = publisher(node, GlobalTopic.DIAGNOSTICS)
        self._transforms = TransformBroadcaster(node) if publish_tf else None

    def publish_state(self, state: BaseState, with_sonar: bool) -> None:
        """Publish odometry, its transform, sonar, battery and the state of the motors."""
        frames, reading = self._frames, state.odometry
        velocity = (state.linear, state.angular)
        self._out[TopicKind.ODOMETRY].publish(
            odometry_message(MESSAGES, reading, frames.odom, frames.base, velocity)
        )
        if self._transforms is not None:
            self._transforms.send(
                planar_transform_message(
                    MESSAGES, reading.stamp, frames.odom, frames.base, reading.pose
                )
            )
        if with_sonar and state.sonar_points is not None:
            points = state.sonar_points
            zeros = np.zeros(len(points))
            columns = [('x', points[:, 0]), ('y', points[:, 1]), ('z', zeros)]
            self._out[VehicleTopic.SONAR].publish(
                cloud_message(MESSAGES, reading.stamp, frames.base, columns)
            )
        self._out[VehicleTopic.BATTERY].publish(self._battery_message(state))
        self._out[VehicleTopic.MOTORS_ON].publish(Bool(data=state.motors_on))
        self.base_values = {
            'battery_V': state.battery,
            'motors_on': state.motors_on,
            'emergency_stop': state.emergency_stop,
            'stalled': state.stalled,
            'front_bumpers': f'{state.front_bumpers:b}',
            'rear_bumpers': f'{state.rear_bumpers:b}',
            'faults': state.faults,
        }

    def _battery_message(self, state: BaseState) -> BatteryState:
        voltage = state.battery
        message = BatteryState()
        message.header.stamp = time_message(MESSAGES, state.odometry.stamp)
        message.header.frame_id = self._frames.base
        message.voltage = float(voltage)
        unknown = math.nan
        message.current = message.charge = message.capacity = message.temperature = unknown
        message.design_capacity = unknown
        charge = battery_charge(voltage, self._battery_nominal)
        message.percentage = float(charge if state.charge is None else state.charge)
        message.present = True
        message.power_supply_status = (
            BatteryState.POWER_SUPPLY_STATUS_CHARGING
            if state.charging
            else BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
        )
        return message

    def publish_scan(self, scan: LaserScan) -> None:
        """Publish one scan."""
        self._out[TopicKind.SCAN].publish(scan_message(MESSAGES, scan, self._frames.laser))

    def publish_frame(self, frame: RgbdFrame) -> None:
        """Publish colour image, depth image and camera_info with one stamp."""
        for topic, message in frame_messages(MESSAGES, self._frames.camera, frame):
            self._out[topic].publish(message)

    def publish_diagnostics(self, parts: Mapping[str, tuple[bytes, str, dict[str, Any]]]) -> None:
        """Publish the diagnostics of the devices: name -> (level, message, values)."""
        message = diagnostics_message(self._node, parts, self._frames.vehicle)
        self._diagnostics.publish(message)

    def publish_mounts(self, config: DriverConfig) -> None:
        """Publish the static transforms of laser and camera."""
        if self._transforms is None:
            return
        frames, stamp = self._frames, now_seconds(self._node)
        mounts = []
        if config.laser.enable_laser:
            mounts.append(
                planar_transform_message(
                    MESSAGES, stamp, frames.base, frames.laser, config.laser_mount.pose
                )
            )
        if config.camera.enable_camera:
            mounts.append(
                camera_transform_message(
                    MESSAGES, stamp, frames.base, frames.camera, config.camera_mount
                )
            )
        self._transforms.send_static(mounts)
