"""What the package must know of one kind of measurement: topics, conversion, receiver, queue."""

import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

from explore_slam.data import (
    ImuReading,
    InterRobotObservation,
    LandmarkObservations,
    LaserScan,
    ObstacleView,
    OdometryReading,
    RgbdFrame,
    TagObservations,
)
from explore_slam.errors import DataError
from explore_slam.messages.base import MessageFactory
from explore_slam.messages.frames import FrameNames
from explore_slam.messages.sensor_mounts import SensorMounts
from explore_slam.messages.topics import COLOR_TOPICS, DEPTH_TOPICS, SensorTopic, TopicKind
from explore_slam.messages.vehicle_settings import VehicleConfig

logger = logging.getLogger(__name__)

# topics whose records name their sensor
_SENSOR_TOPICS = (TopicKind.SCAN, TopicKind.CLOUD, *COLOR_TOPICS, *DEPTH_TOPICS)

Record = (
    OdometryReading
    | ImuReading
    | LaserScan
    | RgbdFrame
    | LandmarkObservations
    | TagObservations
    | ObstacleView
    | InterRobotObservation
)
TopicMessages = list[tuple[TopicKind, Any]]


class MeasurementSink(Protocol):
    """Receiver of the records of vehicles; the agent is one."""

    def add(self, vehicle: str, record: Any, /) -> None:
        """Add a record of a vehicle, of any kind."""


class RefusedMessageError(DataError):
    """A message that waited for others is malformed; topic: the one it came on."""

    def __init__(self, text: str, topic: TopicKind) -> None:
        super().__init__(text)
        self.topic = topic


class Reader(Protocol):
    """Converts the messages of one vehicle on the topics of one kind of measurement."""

    def read(self, topic: TopicKind, message: Any) -> Any:
        """Return the record, or None while messages of other topics are missing.

        DataError if the message is malformed, RefusedMessageError if an earlier one is.
        """

    def losses(self) -> Mapping[str, int]:
        """Return what could not be used so far, by name."""

    def explanations(self) -> Mapping[str, str]:
        """Return name of a loss -> why, as the end of a sentence that begins with the number."""


class MessageReader:
    """Reader of a kind whose single message holds the whole record."""

    def __init__(self, convert: Callable[[Any], Any]) -> None:
        self._convert = convert

    def read(self, _topic: TopicKind, message: Any) -> Any:
        """Return the record."""
        return self._convert(message)

    def losses(self) -> Mapping[str, int]:
        """Return nothing: no message waits for another."""
        return {}

    def explanations(self) -> Mapping[str, str]:
        """Return nothing: there are no losses."""
        return {}


@dataclass(frozen=True)
class MeasurementKind:
    """One kind of measurement.

    name: in queues and diagnostics.
    topics: all that may carry it; events are labelled with the first one.
    reader: makes the Reader of one sensor of a vehicle, whose mounts may be known; sensor as of
    SensorTopic.
    write: record -> messages by topic.
    queue_limit: records per vehicle that may wait for the agent's worker; the oldest is dropped.
    expected: topics whose silence is explained to the operator.
    vision: the value of the setting `vision` with which it is expected; '' is any.
    laser: it is expected of vehicles with a laser scanner only, and there may be several.
    camera: it comes from a camera, of which there may be several.
    sources: the values of the setting `odometry` with which it is expected; () is any.
    clock: the setting of the vehicle that is added to its stamps.
    exclusive: it is used with that value of the setting only, otherwise others publish it.
    high_bandwidth: subscribed to only with that setting, to save bandwidth.
    """

    name: str
    topics: tuple[TopicKind, ...]
    reader: Callable[[SensorMounts | None, str], Reader]
    write: Callable[[MessageFactory, FrameNames, Any], TopicMessages]
    queue_limit: int
    expected: tuple[TopicKind, ...] = ()
    vision: str = ''
    exclusive: bool = False
    high_bandwidth: bool = False
    laser: bool = False
    camera: bool = False
    sources: tuple[str, ...] = ()
    clock: str = 'camera_time_offset'

    def topics_of(self, config: VehicleConfig) -> list[SensorTopic]:
        """Return the topics that carry it with the settings of a vehicle."""
        if self.laser:
            return config.laser_topics
        if self.camera:
            return config.camera_topics(self.topics)
        if TopicKind.IMU in self.topics:
            return [SensorTopic(TopicKind.IMU, config.imu)]
        return [SensorTopic(topic, topic.value) for topic in self.topics]

    def is_expected(self, config: VehicleConfig) -> bool:
        """Return whether it is expected of a vehicle with these settings."""
        if self.sources and config.odometry not in self.sources:
            return False
        return self.vision in ('', config.vision) and (config.use_laser or not self.laser)

    def is_accepted(self, config: VehicleConfig) -> bool:
        """Return whether it is used if it arrives: it is from sensors that the vehicle has."""
        if self.laser and not config.use_laser:
            return False
        if self.exclusive and self.vision != config.vision:
            return False
        return not self.high_bandwidth and (not self.vision or config.vision != 'none')


class VehicleReader:
    """Converts the messages of one vehicle, of all kinds.

    mounts: of its sensors; None: records have none, so that the team's settings apply.
    """

    def __init__(
        self, kinds: Iterable[MeasurementKind], mounts: SensorMounts | None = None
    ) -> None:
        self._mounts = mounts
        kinds = list(kinds)
        self._by_topic = {topic: kind for kind in kinds for topic in kind.topics}
        self._readers = {(kind.name, ''): kind.reader(mounts, '') for kind in kinds}
        self._frames: dict[tuple[TopicKind, str], str] = {}  # first header.frame_id of a topic
        self._mixed: set[tuple[TopicKind, str]] = set()  # topics with several of them

    def read(
        self, topic: TopicKind, message: Any, sensor: str = ''
    ) -> tuple[MeasurementKind, Any] | None:
        """Return kind and record, or None while messages of other topics are missing.

        sensor: which of the vehicle's lasers or cameras it is from; see SensorTopic.
        """
        kind = self._by_topic[topic]
        reader = self._readers.get((kind.name, sensor))
        if reader is None:
            reader = self._readers[kind.name, sensor] = kind.reader(self._mounts, sensor)
        record = reader.read(topic, message)
        if record is None:
            return None
        if topic in _SENSOR_TOPICS:
            sensor = self._told_apart(topic, sensor, message.header.frame_id)
            if sensor:
                record = replace(record, sensor=sensor)
        if self._mounts is not None:
            if topic is TopicKind.ODOMETRY:
                self._mounts.add_odometry(message)
            offset = float(getattr(self._mounts.config, kind.clock))
            if offset:
                record = replace(record, stamp=record.stamp + offset)
        return kind, record

    def _told_apart(self, topic: TopicKind, sensor: str, frame: str) -> str:
        """Return which sensor a message is from, where those of several share its topic."""
        first = self._frames.setdefault((topic, sensor), frame)
        if frame == first:
            return sensor
        name = sensor or topic.value
        if (topic, sensor) not in self._mixed:
            self._mixed.add((topic, sensor))
            vehicle = self._mounts.vehicle if self._mounts is not None else 'a vehicle'
            logger.warning(
                '%s: messages on %s have the frames %r and %r: they are taken as those of '
                'different sensors, each with its own mount; give every sensor a topic of its own',
                vehicle, name, first, frame,
            )  # fmt: skip
        return f'{name}, {frame}'

    def losses(self) -> dict[str, int]:
        """Return what could not be used so far, by name."""
        found: dict[str, int] = {}
        for reader in self._readers.values():
            for name, count in reader.losses().items():
                found[name] = found.get(name, 0) + count
        return found

    def explanations(self) -> dict[str, str]:
        """Return name of a loss -> why, as the end of a sentence that begins with the number."""
        found: dict[str, str] = {}
        for reader in self._readers.values():
            found.update(reader.explanations())
        return found
