"""Subscriptions of the agent: messages of one vehicle become records in the inbox."""

from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, LaserScan, PointCloud2
from std_msgs.msg import String

from explore_slam.errors import ExploreSlamError
from explore_slam.messages import (
    landmarks_record,
    odometry_record,
    planar_covariance,
    planar_pose,
    scan_record,
    sighting_record,
)
from explore_slam.messages.frame_pairing import FramePairing
from explore_slam.nodes.inbox import Inbox
from explore_slam.nodes.vehicle_support import explain_silence, now_seconds

COLOR = 'camera/rgb/image_raw'
DEPTH = 'camera/depth_registered/image_raw'
SILENCE = 5.0  # s without a message after which somebody is told why that may be


class VehicleInputs:
    """All that the agent hears of one vehicle.

    A malformed message is counted, named in a warning and left out.
    """

    def __init__(
        self,
        node: Node,
        vehicle: str,
        others: list[str],
        inbox: Inbox,
        takers: dict[str, Callable[[Any], None]],
        images: bool,
    ) -> None:
        self._node = node
        self.vehicle = vehicle
        self._others = [name for name in others if name != vehicle]
        self._inbox = inbox
        self._takers = takers
        self.pairing = FramePairing()
        self.malformed = 0
        self.heard: dict[str, int] = {}
        self._expected: list[str] = []
        sensor, reliable = qos_profile_sensor_data, QoSProfile(depth=10)
        # a burst of odometry or scans must not push an older one out before it was read
        burst = QoSProfile(depth=50, reliability=qos_profile_sensor_data.reliability)
        self._subscribe('odom', Odometry, self._on_odometry, burst, expected=True)
        self._subscribe('scan', LaserScan, self._on_scan, sensor, expected=True)
        self._subscribe('landmarks', PointCloud2, self._on_landmarks, reliable, not images)
        self._subscribe('sightings', PoseWithCovarianceStamped, self._on_sighting, reliable)
        self._subscribe('initialpose', PoseWithCovarianceStamped, self._on_pose, reliable)
        self._subscribe('follower_status', String, self._on_follower, reliable)
        if images:
            self._subscribe(COLOR, Image, self._on_color, sensor, expected=True)
            self._subscribe(DEPTH, Image, self._on_depth, sensor, expected=True)
            self._subscribe('camera/rgb/camera_info', CameraInfo, self._on_info, sensor, True)
            compressed = CompressedImage
            self._subscribe(f'{COLOR}/compressed', compressed, self._on_color, sensor)
            self._subscribe(f'{DEPTH}/compressed', compressed, self._on_depth, sensor)
            self._subscribe(f'{DEPTH}/compressedDepth', compressed, self._on_depth, sensor)

    def _subscribe(
        self,
        name: str,
        message_type: Any,
        take: Callable[[Any], None],
        qos: QoSProfile,
        expected: bool = False,
    ) -> None:
        self.heard[name] = 0
        if expected:
            self._expected.append(name)

        def on_message(message: Any) -> None:
            self.heard[name] += 1
            try:
                self._check_frame(name, message)
                take(message)
            except (ExploreSlamError, ValueError, TypeError) as error:
                self.malformed += 1
                self._node.get_logger().warning(
                    f'{self.vehicle}/{name}: {error}; message left out',
                    throttle_duration_sec=5.0,
                )

        self._node.create_subscription(message_type, f'{self.vehicle}/{name}', on_message, qos)

    def _check_frame(self, name: str, message: Any) -> None:
        frame = message.header.frame_id if hasattr(message, 'header') else ''
        owner = frame.split('/')[0]
        if owner in self._others and name != 'sightings':
            raise ValueError(f'frame {frame!r} belongs to vehicle {owner!r}')

    def _put(self, kind: str, record: Any) -> None:
        if record is not None:
            self._inbox.put(kind, self.vehicle, self._takers[kind], (self.vehicle, record))

    def _on_odometry(self, message: Any) -> None:
        self._put('odometry', odometry_record(message))

    def _on_scan(self, message: Any) -> None:
        self._put('scan', scan_record(message))

    def _on_landmarks(self, message: Any) -> None:
        self._put('landmarks', landmarks_record(message))

    def _on_sighting(self, message: Any) -> None:
        self._put('sighting', sighting_record(message))

    def _on_pose(self, message: Any) -> None:
        covariance = planar_covariance(message.pose.covariance)
        self._put('pose', (planar_pose(message.pose.pose), covariance))

    def _on_follower(self, message: Any) -> None:
        self._put('follower', (message.data, now_seconds(self._node)))

    def _on_color(self, message: Any) -> None:
        self._put('frame', self.pairing.add_color(message))

    def _on_depth(self, message: Any) -> None:
        self._put('frame', self.pairing.add_depth(message))

    def _on_info(self, message: Any) -> None:
        self.pairing.add_camera_info(message)

    def silence(self) -> list[str]:
        """Return, for every expected topic that brought nothing so far, why that may be."""
        return [
            explain_silence(self._node, f'{self.vehicle}/{name}', SILENCE)
            for name in self._expected
            if not self.heard[name]
        ]
