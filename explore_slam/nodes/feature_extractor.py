"""Node `feature_extractor`: vision on the vehicle; images in, topic `landmarks` out.

About 30 kB a keyframe go over the air instead of 1.5 MB of images. The agent runs with
`vision: vehicle` then. Keyframes are chosen by odometry, as the agent does it.
"""

import logging
import sys
import threading
import time
from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2

from explore_slam.agent.odometry import OdometryBuffer
from explore_slam.data import RgbdFrame
from explore_slam.errors import ExploreSlamError
from explore_slam.messages import landmarks_message, odometry_record
from explore_slam.messages.frame_pairing import FramePairing
from explore_slam.nodes.inbox import Inbox
from explore_slam.nodes.messages import MESSAGES
from explore_slam.nodes.vehicle_support import (
    OK,
    WARN,
    declare_settings,
    diagnostics_message,
    run_node,
    vehicle_name,
)
from explore_slam.settings import Section, section, setting
from explore_slam.vision import FeatureExtractor, KeyframeSelector, VisionConfig

PATIENCE = 0.5  # s that a frame waits for odometry of its time


@dataclass(frozen=True)
class FeatureExtractorConfig(Section):
    """All parameters of the node."""

    robot_base_frame: str = setting(
        'base_link', "frame of the vehicle, behind the vehicle's name and a slash"
    )
    compact_descriptors: bool = setting(
        True, 'send descriptors as 128 bytes instead of 128 float32 values'
    )
    vision: VisionConfig = section(VisionConfig)


class FeatureExtractorNode(Node):
    """Adapter between images and FeatureExtractor; a worker thread does the extraction."""

    def __init__(self, **options: Any) -> None:
        super().__init__('feature_extractor', **options)
        self.config = declare_settings(self, FeatureExtractorConfig())
        self.vehicle = vehicle_name(self)
        self._extractor = FeatureExtractor(self.config.vision)
        self._selector = KeyframeSelector(self.config.vision)
        self._pairing = FramePairing()
        self._odometry = OdometryBuffer(self.vehicle, 30.0, 3.0, 1.0)
        self._odometry_came = threading.Condition()
        self._inbox = Inbox({'frame': 4})
        self._malformed = 0
        self._sent = 0
        self._busy = 0.0
        self._reported = time.monotonic()
        sensor = qos_profile_sensor_data
        color, depth = 'camera/rgb/image_raw', 'camera/depth_registered/image_raw'
        burst = QoSProfile(depth=50, reliability=sensor.reliability)
        listen = self.create_subscription
        listen(Odometry, 'odom', self._on_odometry, burst)
        listen(CameraInfo, 'camera/rgb/camera_info', self._pairing.add_camera_info, sensor)
        listen(Image, color, self._with(self._pairing.add_color), sensor)
        listen(Image, depth, self._with(self._pairing.add_depth), sensor)
        compressed = CompressedImage
        listen(compressed, f'{color}/compressed', self._with(self._pairing.add_color), sensor)
        listen(compressed, f'{depth}/compressed', self._with(self._pairing.add_depth), sensor)
        self._landmarks = self.create_publisher(PointCloud2, 'landmarks', 10)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._worker = threading.Thread(target=self._work, name='features', daemon=True)
        self._worker.start()

    def _with(self, add: Any) -> Any:
        def on_image(message: Any) -> None:
            try:
                frame = add(message)
            except ExploreSlamError as error:
                self._malformed += 1
                self.get_logger().warning(f'image: {error}', throttle_duration_sec=5.0)
                return
            if frame is not None:
                self._inbox.put('frame', self.vehicle, self._extract, frame)

        return on_image

    def _on_odometry(self, message: Odometry) -> None:
        try:
            reading = odometry_record(message)
        except ExploreSlamError as error:
            self._malformed += 1
            self.get_logger().warning(f'odom: {error}', throttle_duration_sec=5.0)
            return
        with self._odometry_came:
            self._odometry.add(reading)
            self._odometry_came.notify_all()

    def _work(self) -> None:
        while not self._inbox.closed:
            item = self._inbox.get(timeout=0.2)
            try:
                if item is not None:
                    item.take(item.payload)
            except ExploreSlamError as error:
                self.get_logger().warning(f'frame: {error}', throttle_duration_sec=5.0)
            if time.monotonic() > self._reported + 1.0:
                self._report()

    def _extract(self, frame: RgbdFrame) -> None:
        with self._odometry_came:
            self._odometry_came.wait_for(lambda: self._odometry.last >= frame.stamp, PATIENCE)
            if not len(self._odometry):
                return
            pose = self._odometry.at(frame.stamp)
        if not self._selector.select(frame.stamp, pose):
            return
        start = time.perf_counter()
        observations = self._extractor.extract(frame)
        self._busy += time.perf_counter() - start
        self._sent += 1
        base = f'{self.vehicle}/{self.config.robot_base_frame}'
        compact = self.config.compact_descriptors
        self._landmarks.publish(landmarks_message(MESSAGES, observations, base, compact))

    def _report(self) -> None:
        self._reported = time.monotonic()
        dropped = self._inbox.dropped[('frame', self.vehicle)]
        values = {
            'keyframes': self._sent,
            'extraction_mean_ms': 1e3 * self._busy / max(self._sent, 1),
            'dropped_frames': dropped,
            'malformed': self._malformed,
            'unpaired_images': self._pairing.unpaired,
            'frames_without_camera_info': self._pairing.without_camera_info,
        }
        level, text = (OK, 'extracting') if self._sent else (WARN, 'no keyframe yet')
        parts = {'features': (level, text, values)}
        self._diagnostics.publish(diagnostics_message(self, parts, self.vehicle))

    def stop(self) -> None:
        """End the worker."""
        self._inbox.close()
        self._worker.join(timeout=2.0)


def main(arguments: list[str] | None = None) -> int:
    """Run the node; the entry point of the executable."""
    logging.getLogger('explore_slam').setLevel(logging.INFO)
    return run_node(FeatureExtractorNode, arguments)


if __name__ == '__main__':
    sys.exit(main())
