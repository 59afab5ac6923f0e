"""Publishers of the simulator: for each vehicle the topics of a real one, and the truth."""

import importlib.util
import math
from dataclasses import dataclass
from typing import Any

from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, LaserScan

from explore_slam.data import LaserScan as Scan
from explore_slam.data import OdometryReading, RgbdFrame
from explore_slam.geometry import Pose2
from explore_slam.messages import (
    camera_info_message,
    image_message,
    odometry_message,
    scan_message,
    time_message,
)
from explore_slam.nodes.messages import MESSAGES
from explore_slam.nodes.vehicle_support import LATCHED
from explore_slam.simulation import SimEvent, SimulationConfig, TruePose

RELIABLE = QoSProfile(depth=10)
OPTICAL = (-0.5, 0.5, -0.5, 0.5)  # quaternion of an optical frame (REP-103): z looks ahead
Mount = tuple[float, float, float, float, float, float, float]  # x, y, z, quaternion x, y, z, w


@dataclass(frozen=True)
class Frames:
    """Names of frames; all but the map stand behind the vehicle's name and a slash."""

    world: str
    odometry: str
    base: str
    laser: str = 'laser'
    camera: str = 'camera_optical_frame'


class VehicleOutputs:
    """All that one simulated vehicle says."""

    def __init__(self, node: Node, vehicle: str, frames: Frames, config: SimulationConfig) -> None:
        self._vehicle = vehicle
        self._frames = frames
        self._scan_rate = config.laser.simulated_scan_rate
        topics: dict[str, Any] = {
            'odom': Odometry,
            'ground_truth': Odometry,
            'scan': LaserScan,
            'camera/rgb/image_raw': Image,
            'camera/depth_registered/image_raw': Image,
            'camera/rgb/camera_info': CameraInfo,
        }
        self._out = {
            name: node.create_publisher(kind, f'{vehicle}/{name}', RELIABLE)
            for name, kind in topics.items()
        }
        self._tf: Any = None
        if importlib.util.find_spec('tf2_msgs') is not None:
            from tf2_msgs.msg import TFMessage

            self._tf_type = TFMessage
            self._tf = node.create_publisher(TFMessage, '/tf', QoSProfile(depth=100))
            self._static = node.create_publisher(TFMessage, '/tf_static', LATCHED)

    def _name(self, frame: str) -> str:
        return f'{self._vehicle}/{frame}'

    def publish(self, event: SimEvent, velocity: tuple[float, float]) -> None:
        """Publish one record; velocity is what the wheels report (m/s, rad/s)."""
        record, frames = event.record, self._frames
        if isinstance(record, OdometryReading):
            names = self._name(frames.odometry), self._name(frames.base)
            message = odometry_message(MESSAGES, record, *names, velocity)
            self._out['odom'].publish(message)
            self._transform(record.stamp, *names, _planar(record.pose))
        elif isinstance(record, TruePose):
            truth = OdometryReading(record.stamp, record.pose)
            names = frames.world, self._name(frames.base)
            speeds = record.linear, record.angular
            self._out['ground_truth'].publish(odometry_message(MESSAGES, truth, *names, speeds))
        elif isinstance(record, Scan):
            period = 1.0 / self._scan_rate
            self._out['scan'].publish(
                scan_message(MESSAGES, record, self._name(frames.laser), period)
            )
        elif isinstance(record, RgbdFrame):
            self._publish_frame(record)

    def _publish_frame(self, frame: RgbdFrame) -> None:
        name = self._name(self._frames.camera)
        info = camera_info_message(MESSAGES, frame.stamp, name, frame.intrinsics)
        self._out['camera/rgb/camera_info'].publish(info)
        depth = image_message(MESSAGES, frame.stamp, name, '16UC1', frame.depth)
        self._out['camera/depth_registered/image_raw'].publish(depth)
        color = image_message(MESSAGES, frame.stamp, name, 'rgb8', frame.rgb)
        self._out['camera/rgb/image_raw'].publish(color)

    def _transform(self, stamp: float, frame: str, child: str, mount: Mount) -> None:
        if self._tf is not None:
            message = transform_message(stamp, frame, child, mount)
            self._tf.publish(self._tf_type(transforms=[message]))

    def publish_mounts(self, config: SimulationConfig) -> None:
        """Publish where laser and camera sit, where tf2_msgs is installed."""
        if self._tf is None:
            return
        laser, kinect, base = config.laser, config.kinect, self._name(self._frames.base)
        mounts = {
            self._frames.laser: (laser.simulated_laser_x, 0.0, laser.simulated_laser_z)
            + (0.0, 0.0, 0.0, 1.0),
            self._frames.camera: (kinect.simulated_camera_x, 0.0, kinect.simulated_camera_z)
            + OPTICAL,
        }
        messages = [
            transform_message(0.0, base, self._name(child), mount)
            for child, mount in mounts.items()
        ]
        self._static.publish(self._tf_type(transforms=messages))


def _planar(pose: Pose2) -> Mount:
    half = 0.5 * pose.theta
    return (pose.x, pose.y, 0.0, 0.0, 0.0, math.sin(half), math.cos(half))


def transform_message(stamp: float, frame: str, child: str, mount: Mount) -> TransformStamped:
    """Return where a frame sits in another one."""
    message = TransformStamped()
    message.header.stamp = time_message(MESSAGES, stamp)
    message.header.frame_id = frame
    message.child_frame_id = child
    move, turn = message.transform.translation, message.transform.rotation
    move.x, move.y, move.z = map(float, mount[:3])
    turn.x, turn.y, turn.z, turn.w = map(float, mount[3:])
    return message


def clock_message(stamp: float) -> Clock:
    """Return simulated time as a message."""
    return Clock(clock=time_message(MESSAGES, stamp))
