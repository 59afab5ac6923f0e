"""Publishers of the simulator: the topics of a real vehicle, and the ground truth."""

from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from explore_slam.data import LaserScan, OdometryReading, RgbdFrame
from explore_slam.geometry import quaternion_from_yaw
from explore_slam.messages import (
    camera_transform_message,
    odometry_message,
    planar_transform_message,
    scan_message,
    time_message,
    transform_message,
)
from explore_slam.messages.frame_pairing import frame_messages
from explore_slam.messages.frames import FrameNames
from explore_slam.messages.topics import TopicKind
from explore_slam.nodes.endpoints import TransformBroadcaster, publisher
from explore_slam.nodes.ros_types import MESSAGES
from explore_slam.simulation import SimEvent, SimulationConfig, TruePose

_TOPICS = (
    TopicKind.ODOMETRY, TopicKind.GROUND_TRUTH, TopicKind.SCAN,
    TopicKind.COLOR, TopicKind.DEPTH, TopicKind.CAMERA_INFO,
)  # fmt: skip


class VehicleOutputs:
    """All publishers of one simulated vehicle."""

    def __init__(self, node: Node, frames: FrameNames) -> None:
        self._frames = frames
        self._out = {topic: publisher(node, topic, frames.vehicle) for topic in _TOPICS}
        self._transforms = TransformBroadcaster(node)

    def publish(self, event: SimEvent, velocity: tuple[float, float]) -> None:
        """Publish one record; velocity is what wheel odometry measures (m/s, rad/s)."""
        record, frames = event.record, self._frames
        if isinstance(record, OdometryReading):
            message = odometry_message(MESSAGES, record, frames.odom, frames.base, velocity)
            self._out[TopicKind.ODOMETRY].publish(message)
            self._transforms.send(
                planar_transform_message(
                    MESSAGES, record.stamp, frames.odom, frames.base, record.pose
                )
            )
        elif isinstance(record, TruePose):
            truth = OdometryReading(record.stamp, record.pose)
            speeds = record.linear, record.angular
            self._out[TopicKind.GROUND_TRUTH].publish(
                odometry_message(MESSAGES, truth, frames.map, frames.base, speeds)
            )
        elif isinstance(record, LaserScan):
            self._out[TopicKind.SCAN].publish(scan_message(MESSAGES, record, frames.laser))
        elif isinstance(record, RgbdFrame):
            for topic, message in frame_messages(MESSAGES, frames.camera, record):
                self._out[topic].publish(message)

    def publish_mounts(self, config: SimulationConfig) -> None:
        """Publish the static transforms of laser and camera."""
        laser, frames = config.laser_mount.pose, self._frames
        self._transforms.send_static(
            [
                transform_message(
                    MESSAGES, 0.0, frames.base, frames.laser,
                    (laser.x, laser.y, config.laser.simulated_laser_z),
                    quaternion_from_yaw(laser.theta),
                ),
                camera_transform_message(
                    MESSAGES, 0.0, frames.base, frames.camera, config.camera_mount
                ),
            ]
        )  # fmt: skip


def clock_message(stamp: float) -> Clock:
    """Return simulated time (s) as a rosgraph_msgs/Clock."""
    return Clock(clock=time_message(MESSAGES, stamp))
