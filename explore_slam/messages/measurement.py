"""What the package must know of one kind of measurement: topics, conversion, receiver, queue."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

from explore_slam.data import (
    InterRobotObservation,
    LandmarkObservations,
    LaserScan,
    OdometryReading,
    RgbdFrame,
)
from explore_slam.errors import DataError
from explore_slam.messages.base import MessageFactory
from explore_slam.messages.frames import FrameNames
from explore_slam.messages.sensor_mounts import SensorMounts
from explore_slam.messages.topics import TopicKind
from explore_slam.messages.vehicle_settings import VehicleConfig

Record = OdometryReading | LaserScan | RgbdFrame | LandmarkObservations | InterRobotObservation
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
    reader: makes the Reader of one vehicle from the mounts of its sensors, if they are known.
    write: record -> messages by topic.
    queue_limit: records per vehicle that may wait for the agent's worker; the oldest is dropped.
    expected: topics whose silence is explained to the operator.
    vision: the value of the setting `vision` with which it is expected; '' is any.
    laser: it is expected of vehicles with a laser scanner only.
    clock: the setting of the vehicle that is added to its stamps.
    high_bandwidth: subscribed to only with that setting, to save bandwidth.
    """

    name: str
    topics: tuple[TopicKind, ...]
    reader: Callable[[SensorMounts | None], Reader]
    write: Callable[[MessageFactory, FrameNames, Any], TopicMessages]
    queue_limit: int
    expected: tuple[TopicKind, ...] = ()
    vision: str = ''
    high_bandwidth: bool = False
    laser: bool = False
    clock: str = 'camera_time_offset'

    def is_expected(self, config: VehicleConfig) -> bool:
        """Return whether it is expected of a vehicle with these settings."""
        return self.vision in ('', config.vision) and (config.use_laser or not self.laser)

    def is_accepted(self, config: VehicleConfig) -> bool:
        """Return whether it is used if it arrives: it is from sensors that the vehicle has."""
        if self.laser and not config.use_laser:
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
        self._readers = [(kind, kind.reader(mounts)) for kind in kinds]
        self._by_topic = {
            topic: (kind, reader) for kind, reader in self._readers for topic in kind.topics
        }

    def read(self, topic: TopicKind, message: Any) -> tuple[MeasurementKind, Any] | None:
        """Return kind and record, or None while messages of other topics are missing."""
        kind, reader = self._by_topic[topic]
        record = reader.read(topic, message)
        if record is None:
            return None
        if self._mounts is not None:
            if topic is TopicKind.ODOMETRY:
                self._mounts.add_odometry(message)
            offset = float(getattr(self._mounts.config, kind.clock))
            if offset:
                record = replace(record, stamp=record.stamp + offset)
        return kind, record

    def losses(self) -> dict[str, int]:
        """Return what could not be used so far, by name."""
        found: dict[str, int] = {}
        for _, reader in self._readers:
            found.update(reader.losses())
        return found

    def explanations(self) -> dict[str, str]:
        """Return name of a loss -> why, as the end of a sentence that begins with the number."""
        found: dict[str, str] = {}
        for _, reader in self._readers:
            found.update(reader.explanations())
        return found
