"""Subscriptions of the agent: messages of one vehicle become records in the inbox."""

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

from rclpy.node import Node
from std_msgs.msg import String

from explore_slam.errors import ExploreSlamError
from explore_slam.messages.base import planar_covariance, planar_pose
from explore_slam.messages.measurement import MeasurementKind, MeasurementSink, VehicleReader
from explore_slam.messages.measurement_kinds import MEASUREMENT_KINDS
from explore_slam.messages.topics import Topic, TopicKind, VehicleTopic
from explore_slam.nodes.endpoints import subscribe
from explore_slam.nodes.inbox import Inbox
from explore_slam.nodes.node_support import SILENCE, WARNING_PERIOD, explain_silence, now_seconds

# records per vehicle that may wait for the worker
LIMITS: Mapping[str, int] = {
    **{kind.name: kind.queue_limit for kind in MEASUREMENT_KINDS},
    'follower': 100,
}

type Take = Callable[[tuple[str, Any]], None]


class VehicleInputs:
    """All subscriptions to the topics of one vehicle.

    A malformed message is counted, named in a warning and omitted.

    sink: the agent, which takes measurements.
    set_pose, report_follower: take (vehicle, (pose, covariance)) of the operator and (vehicle,
    (status, stamp)) of the path follower.
    vision: 'agent' or 'vehicle', the setting of that name.
    """

    def __init__(
        self,
        node: Node,
        vehicle: str,
        team: list[str],
        inbox: Inbox,
        sink: MeasurementSink,
        set_pose: Take,
        report_follower: Take,
        vision: str,
    ) -> None:
        self._node = node
        self.vehicle = vehicle
        self._others = [name for name in team if name != vehicle]
        self._inbox = inbox
        self._sink = sink
        self._set_pose = set_pose
        self._report_follower = report_follower
        self._reader = VehicleReader(MEASUREMENT_KINDS)
        self.malformed = 0
        self._warned: dict[Topic, float] = {}
        self.received: dict[Topic, int] = {}
        self._expected: list[Topic] = []
        for kind in MEASUREMENT_KINDS:
            expected = kind.is_expected(vision)
            if expected or not kind.bulky:
                for topic in kind.topics:
                    self._subscribe(topic, self._measurement_callback(topic))
            if expected:
                self._expected += kind.expected
        self._subscribe(TopicKind.INITIAL_POSE, self._on_pose)
        self._subscribe(VehicleTopic.FOLLOWER_STATUS, self._on_follower)

    def _subscribe(self, topic: Topic, take: Callable[[Any], None]) -> None:
        self.received[topic] = 0

        def on_message(message: Any) -> None:
            self.received[topic] += 1
            try:
                self._check_frame(topic, message)
                take(message)
            except (ExploreSlamError, ValueError, TypeError) as error:
                self.malformed += 1
                self._warn(topic, f'{error}; message omitted')

        subscribe(self._node, topic, on_message, self.vehicle)

    def _warn(self, topic: Topic, text: str) -> None:
        """Log a warning about a topic, at most one per WARNING_PERIOD and topic."""
        now = time.monotonic()
        if now - self._warned.get(topic, -math.inf) >= WARNING_PERIOD:
            self._warned[topic] = now
            self._node.get_logger().warning(f'{self.vehicle}/{topic.value}: {text}')

    def _check_frame(self, topic: Topic, message: Any) -> None:
        """Raise ValueError for a message in the frame of another vehicle: topics are mixed up."""
        frame = message.header.frame_id if hasattr(message, 'header') else ''
        owner = frame.split('/')[0]
        if owner in self._others and topic is not TopicKind.INTER_ROBOT:
            raise ValueError(f'frame {frame!r} belongs to vehicle {owner!r}')

    def _measurement_callback(self, topic: TopicKind) -> Callable[[Any], None]:
        def on_measurement(message: Any) -> None:
            found = self._reader.read(topic, message)
            if found is not None:
                self._put(*found)

        return on_measurement

    def _put(self, kind: MeasurementKind, record: Any) -> None:
        def add(payload: Any) -> None:
            self._sink.add(self.vehicle, payload)

        self._inbox.put(kind.name, self.vehicle, add, record)

    def _on_pose(self, message: Any) -> None:
        covariance = planar_covariance(message.pose.covariance)
        record = (planar_pose(message.pose.pose), covariance)
        self._inbox.put('pose', self.vehicle, self._set_pose, (self.vehicle, record))

    def _on_follower(self, message: String) -> None:
        record = (message.data, now_seconds(self._node))
        self._inbox.put('follower', self.vehicle, self._report_follower, (self.vehicle, record))

    def losses(self) -> dict[str, int]:
        """Return the numbers of messages that could not be used so far, by reason."""
        return {'malformed': self.malformed, **self._reader.losses()}

    def silence(self) -> list[str]:
        """Return an explanation for every expected topic on which nothing has arrived."""
        return [
            explain_silence(self._node, f'{self.vehicle}/{topic.value}', SILENCE)
            for topic in self._expected
            if not self.received[topic]
        ]
