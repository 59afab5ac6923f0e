"""Node `feature_extractor`: vision on the vehicle; images in; landmarks, tags and obstacles out.

It sends about 30 kB per keyframe, and 30 kB per frame for obstacles, instead of 1.5 MB of images.
The agent then runs with `vision: vehicle`. Keyframes are selected by odometry, as in the agent.
"""

import logging
import threading
import time
from collections import Counter
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from nav_msgs.msg import Odometry
from rclpy.node import Node

from explore_slam.agent.config import InputConfig
from explore_slam.agent.odometry import OdometryBuffer
from explore_slam.data import RgbdFrame
from explore_slam.errors import ExploreSlamError
from explore_slam.messages import (
    landmarks_message,
    obstacles_message,
    odometry_record,
    tags_message,
)
from explore_slam.messages.frame_pairing import FRAME, FramePairing
from explore_slam.messages.topics import GlobalTopic, SensorTopic, TopicKind
from explore_slam.messages.vehicle_settings import VehicleConfig, odometry_topic
from explore_slam.mounts import LaserMountConfig
from explore_slam.nodes.driver_parameters import DriverNodeConfig
from explore_slam.nodes.endpoints import publisher, subscribe
from explore_slam.nodes.inbox import Inbox
from explore_slam.nodes.node_support import (
    OK,
    REPORT_PERIOD,
    WARN,
    WARNING_PERIOD,
    declare_settings,
    diagnostics_message,
    run_node,
    vehicle_name,
    warn_of_unknown_vehicle_parameters,
)
from explore_slam.nodes.ros_types import MESSAGES
from explore_slam.nodes.transform_listener import own_mounts
from explore_slam.settings import Section, section, setting, values_of
from explore_slam.vehicle import PathFollowerConfig
from explore_slam.vision import FeatureExtractor, KeyframeSelector, VisionConfig
from explore_slam.vision.obstacles import ObstacleDetector

_INPUTS = InputConfig()  # the defaults of the agent
# settings of the vehicle, which the agent has too
_VEHICLE_SETTINGS = ('odometry', 'cameras', 'camera_mount', 'odom_frame', 'robot_base_frame')
POLL_PERIOD = 0.2  # s that the worker waits for a frame before it looks at the time
ODOMETRY_WAIT = 0.5  # s that a frame waits for odometry that reaches its stamp


@dataclass(frozen=True)
class FeatureExtractorConfig(Section):
    """All parameters of the node."""

    compact_descriptors: bool = setting(
        True, 'Publish descriptors as 128 bytes instead of 128 float32 values'
    )
    vision: VisionConfig = section(VisionConfig)


class FeatureExtractorNode(Node):
    """Adapter between images and FeatureExtractor; a worker thread does the extraction."""

    def __init__(self, **options: Any) -> None:
        super().__init__('feature_extractor', **options)
        self.vehicle = vehicle_name(self)
        self.config = declare_settings(self, FeatureExtractorConfig(), vehicle=self.vehicle)
        sensors = declare_settings(
            self, VehicleConfig(), vehicle=self.vehicle, names=_VEHICLE_SETTINGS
        )
        others = {**values_of(DriverNodeConfig()), **values_of(PathFollowerConfig())}
        warn_of_unknown_vehicle_parameters(self, self.vehicle, others)
        self._extractor = FeatureExtractor(self.config.vision)
        self._detector = ObstacleDetector(self.config.vision, vehicle=self.vehicle)
        self._mounts = own_mounts(self, self.vehicle, LaserMountConfig(), sensors)
        topics = sensors.camera_topics(FRAME.topics)
        cameras = {topic.sensor for topic in topics}
        self._pairings = {name: FramePairing(self._mounts, name) for name in cameras}
        self._selectors = {name: KeyframeSelector(self.config.vision) for name in cameras}
        self._odometry = OdometryBuffer(
            self.vehicle,
            _INPUTS.odometry_duration,
            _INPUTS.odometry_jump_speed,
            _INPUTS.clock_jump_threshold,
        )
        self._odometry_came = threading.Condition()
        self._inbox = Inbox({FRAME.name: FRAME.queue_limit})
        self._malformed = 0
        self._sent = 0
        self._busy = 0.0
        self._reported = time.monotonic()
        subscribe(self, odometry_topic(sensors), self._on_odometry)
        for topic in topics:
            subscribe(self, topic.kind, partial(self._on_camera, topic), name=topic.name)
        self._landmarks = publisher(self, TopicKind.LANDMARKS)
        self._tags = publisher(self, TopicKind.TAGS)
        self._obstacles = publisher(self, TopicKind.OBSTACLES)
        self._diagnostics = publisher(self, GlobalTopic.DIAGNOSTICS)
        self._worker = threading.Thread(target=self._work, name='features', daemon=True)
        self._worker.start()

    def _on_camera(self, topic: SensorTopic, message: Any) -> None:
        try:
            frame = self._pairings[topic.sensor].read(topic.kind, message)
        except ExploreSlamError as error:
            self._malformed += 1
            self.get_logger().warning(
                f'{topic.name}: {error}', throttle_duration_sec=WARNING_PERIOD
            )
            return
        if frame is not None:
            named = replace(frame, sensor=topic.sensor)
            self._inbox.put(FRAME.name, self.vehicle, self._extract, named)

    def _on_odometry(self, message: Odometry) -> None:
        try:
            reading = odometry_record(message)
        except ExploreSlamError as error:
            self._malformed += 1
            self.get_logger().warning(f'odom: {error}', throttle_duration_sec=WARNING_PERIOD)
            return
        self._mounts.add_odometry(message)
        with self._odometry_came:
            self._odometry.add(reading)
            self._odometry_came.notify_all()

    def _work(self) -> None:
        while not self._inbox.closed:
            item = self._inbox.get(timeout=POLL_PERIOD)
            try:
                if item is not None:
                    item.take(item.payload)
            except ExploreSlamError as error:
                self.get_logger().warning(f'frame: {error}', throttle_duration_sec=WARNING_PERIOD)
            if time.monotonic() > self._reported + REPORT_PERIOD:
                self._report()

    def _extract(self, frame: RgbdFrame) -> None:
        if self.config.vision.obstacles.depth_obstacles:
            view = self._detector.detect(frame)
            self._obstacles.publish(obstacles_message(MESSAGES, view, self._mounts.base))
        with self._odometry_came:
            self._odometry_came.wait_for(lambda: self._odometry.last >= frame.stamp, ODOMETRY_WAIT)
            if not len(self._odometry):
                return
            pose = self._odometry.at(frame.stamp)
        if not self._selectors[frame.sensor].select(frame.stamp, pose):
            return
        start = time.perf_counter()
        observations = self._extractor.extract(frame)
        tags = self._extractor.observe_tags(frame)
        self._busy += time.perf_counter() - start
        self._sent += 1
        base, compact = self._mounts.base, self.config.compact_descriptors
        self._landmarks.publish(landmarks_message(MESSAGES, observations, base, compact))
        if tags is not None:
            self._tags.publish(tags_message(MESSAGES, tags, base))

    def _report(self) -> None:
        self._reported = time.monotonic()
        dropped = self._inbox.dropped[(FRAME.name, self.vehicle)]
        losses: Counter[str] = Counter()
        for pairing in self._pairings.values():
            losses.update(pairing.losses())
        values = {
            'keyframes': self._sent,
            'extraction_mean_ms': 1e3 * self._busy / max(self._sent, 1),
            'dropped_frames': dropped,
            'malformed': self._malformed,
            **losses,
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
