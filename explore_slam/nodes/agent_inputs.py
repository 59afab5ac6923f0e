"""Subscriptions of the agent: messages of one vehicle become records in the inbox."""

import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

from rclpy.node import Node

from explore_slam.errors import DataError, ExploreSlamError
from explore_slam.geometry import Array, Pose2
from explore_slam.messages.base import planar_covariance, planar_pose, seconds, time_message
from explore_slam.messages.battery import battery_reading
from explore_slam.messages.clocks import StampProblem, StampWatch
from explore_slam.messages.measurement import (
    MeasurementKind,
    MeasurementSink,
    RefusedMessageError,
    VehicleReader,
)
from explore_slam.messages.measurement_kinds import KIND_OF_TOPIC, MEASUREMENT_KINDS
from explore_slam.messages.sensor_mounts import SensorMounts
from explore_slam.messages.topics import (
    COLOR_TOPICS,
    DEPTH_TOPICS,
    SensorTopic,
    Topic,
    TopicKind,
    VehicleTopic,
    sensor_topic,
)
from explore_slam.messages.transforms import frame_name
from explore_slam.messages.vehicle_settings import VehicleConfig
from explore_slam.nodes.endpoints import subscribe
from explore_slam.nodes.inbox import Inbox
from explore_slam.nodes.node_support import SILENCE, WARNING_PERIOD, explain_silence, now_seconds
from explore_slam.nodes.ros_types import MESSAGES
from explore_slam.nodes.transform_listener import TransformListener

# records per vehicle that may wait for the worker
LIMITS: Mapping[str, int] = {
    **{kind.name: kind.queue_limit for kind in MEASUREMENT_KINDS},
    'navigator': 100,
    'battery': 10,
}
MOUNT_WAIT = 2.0  # s for which messages wait for the transform of their sensor
_HELD = 100  # messages per vehicle that wait for a transform
# topics whose sensor has a mount
_MOUNTED = (TopicKind.SCAN, TopicKind.CLOUD, *COLOR_TOPICS, *DEPTH_TOPICS)

type Take = Callable[[tuple[str, Any]], None]


@dataclass(frozen=True)
class OperatorPose:
    """A pose that the operator has given, with its covariance (3, 3)."""

    pose: Pose2
    covariance: Array


class PlannerSink(NamedTuple):
    """What takes the requests of the operator, and readings of batteries.

    set_pose: takes (vehicle, OperatorPose). set_goal: takes (vehicle, Pose2).
    set_battery: takes (vehicle, BatteryReading).
    """

    set_pose: Take
    set_goal: Take
    set_battery: Take


def operator_pose(message: Any, map_frame: str) -> OperatorPose:
    """Return the pose in a PoseWithCovarianceStamped; DataError where it cannot be used.

    Its frame must be that of the map. A covariance of zero is no statement about the accuracy, and
    would pin all particles to one point.
    """
    frame = frame_name(message.header.frame_id)
    if frame != map_frame:
        raise DataError(f'pose is in frame {frame!r}, expected {map_frame!r}')
    pose, covariance = planar_pose(message.pose.pose), planar_covariance(message.pose.covariance)
    if not pose.is_finite():
        raise DataError(f'pose is {tuple(pose)}, expected finite values')
    if not (covariance.diagonal() > 0.0).all():
        raise DataError(
            f'variances of x, y and yaw are {covariance.diagonal().tolist()}, expected more than '
            '0; RViz sends 0.25 m² and 0.068 rad²'
        )
    return OperatorPose(pose, covariance)


def operator_goal(message: Any, map_frame: str) -> Pose2:
    """Return the goal in a PoseStamped; DataError where it cannot be used."""
    frame = frame_name(message.header.frame_id)
    if frame != map_frame:
        raise DataError(f'goal is in frame {frame!r}, expected {map_frame!r}')
    goal = planar_pose(message.pose)
    if not goal.is_finite():
        raise DataError(f'goal is {tuple(goal)}, expected finite values')
    return goal


def operator_polygon(message: Any, map_frame: str) -> list[tuple[float, float]]:
    """Return the corners (m) of a PolygonStamped; DataError for another frame."""
    frame = frame_name(message.header.frame_id)
    points = [(float(point.x), float(point.y)) for point in message.polygon.points]
    if points and frame != map_frame:
        raise DataError(f'polygon is in frame {frame!r}, expected {map_frame!r}')
    return points


def _alternatives(topic: SensorTopic) -> list[SensorTopic]:
    """Return the topics that may take the place of one, itself included."""
    groups = (COLOR_TOPICS, DEPTH_TOPICS)
    group = next((group for group in groups if topic.kind in group), ())
    stem = topic.name.removesuffix(topic.kind.value.removeprefix('camera'))
    others = [kind for kind in group if kind is not topic.kind]
    return [topic] + [
        SensorTopic(kind, stem + kind.value.removeprefix('camera'), topic.sensor)
        for kind in others
    ]


class VehicleInputs:
    """All subscriptions to the topics of one vehicle.

    A malformed message is counted, named in a warning and omitted. A scan or image whose frame
    the transforms do not hold yet waits for it for a while; then the settings apply.

    sink: the agent, which takes measurements.
    planner: takes what the operator sends to the vehicle, and its battery.
    mounts: of the vehicle's sensors; also its base and odometry frames.
    """

    def __init__(
        self,
        node: Node,
        mounts: SensorMounts,
        team: list[str],
        inbox: Inbox,
        sink: MeasurementSink,
        planner: PlannerSink,
        transforms: TransformListener,
        map_frame: str,
    ) -> None:
        self._node = node
        self.vehicle = mounts.vehicle
        self.mounts = mounts
        self._others = [name for name in team if name != self.vehicle]
        self._inbox = inbox
        self._sink = sink
        self._planner = planner
        self._transforms = transforms
        self._map_frame = map_frame
        self._reader = VehicleReader(MEASUREMENT_KINDS, mounts)
        self._stamps = StampWatch()
        self._since = time.monotonic()
        self._held: deque[tuple[SensorTopic, Any]] = deque(maxlen=_HELD)
        self._waiting_since: dict[str, float] = {}  # frame -> monotonic s
        self._number: int | None = None  # of the newest odometry message at its publisher
        self.malformed = 0
        self._warned: dict[str, float] = {}
        self.received: dict[str, int] = {}  # by name below the vehicle's namespace
        self._takers: dict[Topic, Callable[[Any], None]] = {}
        self._expected: list[SensorTopic] = []
        self._clocks: dict[str, str] = {}  # name of a topic -> setting of its time offset
        for kind in MEASUREMENT_KINDS:
            expected = kind.is_expected(mounts.config)
            if expected or kind.is_accepted(mounts.config):
                for topic in kind.topics_of(mounts.config):
                    self._subscribe_to_sensor(topic)
                    self._clocks[topic.name] = kind.clock
                    if expected and topic.kind in kind.expected:
                        self._expected.append(topic)
        self._subscribe(TopicKind.INITIAL_POSE, self._on_pose)
        self._subscribe(VehicleTopic.GOAL_POSE, self._on_goal)
        if self.config.battery.watched:
            name = self.config.battery_topic
            self.received[name] = 0
            subscribe(node, VehicleTopic.BATTERY, self._on_battery, self.vehicle, name=name)

    @property
    def config(self) -> VehicleConfig:
        """Settings of the vehicle."""
        return self.mounts.config

    def _subscribe(self, topic: Topic, take: Callable[[Any], None]) -> None:
        """Subscribe to what an operator sends."""
        self.received[topic.value] = 0
        self._takers[topic] = take
        subscribe(self._node, topic, partial(self.take, topic), self.vehicle)

    def _subscribe_to_sensor(self, topic: SensorTopic) -> None:
        self.received[topic.name] = 0
        callback: Callable[..., None] = partial(self.take_measurement, topic)
        if topic.kind is TopicKind.ODOMETRY:
            callback = partial(self._on_odometry, topic)
        subscribe(self._node, topic.kind, callback, self.vehicle, name=topic.name)

    def _on_odometry(
        self, topic: SensorTopic, message: Any, info: Mapping[str, int | None]
    ) -> None:
        """Take odometry with its number at the publisher, by which restarts are told from losses.

        info: of rclpy; the number is None where the middleware does not report it.
        """
        self._number = info['publication_sequence_number']
        self.take_measurement(topic, message)

    def take(self, topic: Topic, message: Any) -> None:
        """Take what an operator has sent: check its frame, then use it."""

        def check_and_take(message: Any) -> None:
            self._check_frame(topic, message)
            self._takers[topic](message)

        self.received[topic.value] += 1
        self._try(topic.value, check_and_take, message)

    def take_measurement(self, topic: SensorTopic, message: Any) -> None:
        """Take a measurement: check frame and stamp; it may have to wait for its mount."""

        def check_and_read(message: Any) -> None:
            self._check_frame(topic.kind, message)
            self._check_stamp(topic, message)
            if topic.kind in _MOUNTED and self._must_wait(message.header.frame_id):
                self._held.append((topic, message))
                return
            self.release_held()
            self._read(topic, message)

        self.received[topic.name] += 1
        self._try(topic.name, check_and_read, message, topic.sensor)

    def _try(
        self, topic: str, take: Callable[[Any], None], message: Any, sensor: str = ''
    ) -> None:
        """Take a message of a topic, and of a sensor; a malformed one is counted and named."""
        try:
            take(message)
        except RefusedMessageError as error:
            self.malformed += 1
            name = sensor_topic(error.topic, sensor).name if sensor else error.topic.value
            self._warn(name, f'{error}; message omitted')
        except (ExploreSlamError, ValueError, TypeError) as error:
            self.malformed += 1
            self._warn(topic, f'{error}; message omitted')

    def _warn(self, topic: str, text: str) -> None:
        """Log a warning about a topic, at most one per WARNING_PERIOD and topic."""
        now = time.monotonic()
        if now - self._warned.get(topic, -math.inf) >= WARNING_PERIOD:
            self._warned[topic] = now
            self._node.get_logger().warning(f'{self.vehicle}/{topic}: {text}')

    def _check_frame(self, topic: Topic, message: Any) -> None:
        """Raise ValueError for a message in the frame of another vehicle: topics are mixed up."""
        frame = message.header.frame_id if hasattr(message, 'header') else ''
        owner = frame_name(frame).split('/')[0]
        if owner in self._others and topic is not TopicKind.INTER_ROBOT:
            raise ValueError(f'frame {frame!r} belongs to vehicle {owner!r}')

    def _check_stamp(self, topic: SensorTopic, message: Any) -> None:
        """Compare a stamp with the clock; replace a stamp of zero by the time of receipt."""
        now = now_seconds(self._node)
        if now == 0.0:
            return  # simulated time has not begun: there is nothing to compare with
        offset = float(getattr(self.config, KIND_OF_TOPIC[topic.kind].clock))
        stamp = seconds(message.header.stamp)
        if not self._stamps.add(topic.name, stamp + offset if stamp else 0.0, now):
            message.header.stamp = time_message(MESSAGES, now - offset)

    def release_held(self) -> None:
        """Read the messages that have waited for the transforms of their sensors long enough."""
        while self._held and not self._must_wait(self._held[0][1].header.frame_id):
            topic, message = self._held.popleft()
            self._try(topic.name, partial(self._read, topic), message, topic.sensor)

    def _must_wait(self, frame: str) -> bool:
        """Return whether a message of a sensor has to wait for the transform of its frame."""
        if not self._transforms.available or self.mounts.is_known(frame):
            return False
        now = time.monotonic()
        waited = now - self._waiting_since.setdefault(frame, now)
        if waited > 0.5 * MOUNT_WAIT:
            self._transforms.listen_to_tf()
        return waited < MOUNT_WAIT

    def _read(self, topic: SensorTopic, message: Any) -> None:
        found = self._reader.read(topic.kind, message, topic.sensor)
        if found is not None:
            kind, record = found
            if topic.kind is TopicKind.ODOMETRY:
                record = replace(record, number=self._number)
            self._put(kind, record)

    def _put(self, kind: MeasurementKind, record: Any) -> None:
        def add(payload: Any) -> None:
            self._sink.add(self.vehicle, payload)

        self._inbox.put(kind.name, self.vehicle, add, record)

    def _on_pose(self, message: Any) -> None:
        """Place the vehicle where the operator says; DataError where that cannot be used."""
        given = operator_pose(message, self._map_frame)
        self._inbox.put('pose', self.vehicle, self._planner.set_pose, (self.vehicle, given))

    def _on_goal(self, message: Any) -> None:
        """Send the vehicle where the operator says; DataError where that cannot be used."""
        goal = operator_goal(message, self._map_frame)
        self._inbox.put('goal', self.vehicle, self._planner.set_goal, (self.vehicle, goal))

    def _on_battery(self, message: Any) -> None:
        """Take the state of the vehicle's battery."""
        name = self.config.battery_topic

        def check_and_take(message: Any) -> None:
            self._check_frame(VehicleTopic.BATTERY, message)
            reading = battery_reading(message)
            self._inbox.put(
                'battery', self.vehicle, self._planner.set_battery, (self.vehicle, reading)
            )

        self.received[name] += 1
        self._try(name, check_and_take, message)

    def losses(self) -> dict[str, int]:
        """Return the numbers of messages that could not be used so far, by reason."""
        return {'malformed': self.malformed, **self._reader.losses()}

    def clock_problems(self) -> dict[str, StampProblem]:
        """Return topic -> what is wrong with its stamps.

        Before simulated time begins, stamps cannot be compared: that is the problem then.
        """
        if now_seconds(self._node) == 0.0:
            if time.monotonic() - self._since < SILENCE:
                return {}
            text = (
                'use_sim_time is true, but no time has come; start what publishes it '
                '(a simulator, ros2 bag play --clock), or set use_sim_time to false'
            )
            return {'/clock': StampProblem(text, 'no time')}
        found = {}
        for topic, problem in self._stamps.problems(TopicKind.ODOMETRY.value).items():
            setting = f'{self.vehicle}.{self._clocks[topic]}'
            hint = f'; if the clocks differ by a constant, set {setting}'
            text = problem.text + hint * (problem.amount is not None)
            found[f'{self.vehicle}/{topic}'] = problem._replace(text=text)
        return found

    def silence(self) -> list[str]:
        """Return an explanation for every expected topic on which nothing has arrived.

        Images may come on any of their topics, raw or compressed.
        """
        hints = {
            topic.name: f'; for a vehicle without wheel odometry set {self.vehicle}.odometry: scan'
            * (topic.kind is TopicKind.ODOMETRY and self.config.use_laser)
            for topic in self._expected
            if not any(self.received[other.name] for other in _alternatives(topic))
        }
        name = self.config.battery_topic
        if self.config.battery.watched and not self.received[name]:
            hints[name] = ''
        return [
            explain_silence(self._node, f'{self.vehicle}/{name}', SILENCE) + hint
            for name, hint in hints.items()
        ]
