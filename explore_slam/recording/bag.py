"""Bags: rosbag2 folders, written as mcap, read as mcap or sqlite3, without ROS.

A truncated bag is read up to its damage, with a warning.
"""

import logging
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import (
    CompressionFormat,
    CompressionMode,
    Reader,
    StoragePlugin,
    Writer,
    WriterError,
)

from explore_slam.errors import RecordingError
from explore_slam.recording.rosbags_types import deserialize, full_name, serialize, typestore
from explore_slam.recording.salvage import McapSalvage, RawMessage

logger = logging.getLogger(__name__)

SUFFIXES = ('.mcap', '.db3')


class BagReader:
    """Reads a rosbag2 folder, or one of its .mcap or .db3 files, in the order of log times."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.topics: dict[str, str] = {}
        self.counts: dict[str, int] = {}
        self.start = 0
        self.end = 0
        self.warnings: list[str] = []
        self._reader: Reader | None = None
        self._parts: list[BagReader | McapSalvage] = []
        if not path.exists():
            raise RecordingError(f'{path} does not exist, expected a bag (a rosbag2 folder)')
        if path.is_file() and path.suffix not in SUFFIXES:
            raise RecordingError(f'{path} is not a bag: expected a folder, .mcap or .db3')
        self._open()

    @property
    def message_count(self) -> int:
        """Number of messages on all topics."""
        return sum(self.counts.values())

    @property
    def rates(self) -> dict[str, float]:
        """Messages per second on each topic."""
        duration = max((self.end - self.start) * 1e-9, 1e-9)
        return {topic: count / duration for topic, count in self.counts.items()}

    def __enter__(self) -> 'BagReader':
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files."""
        if self._reader is not None:
            with suppress(Exception):
                self._reader.close()
            self._reader = None
        for part in self._parts:
            if isinstance(part, BagReader):
                part.close()

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield the messages of the given topics, or all; damage ends them with a warning."""
        if self._reader is None:
            for part in self._parts:
                if isinstance(part, BagReader):
                    yield from part.messages(topics)
                else:
                    whole = part.messages()
                    yield from (m for m in whole if topics is None or m.topic in topics)
            return
        wanted = [
            connection
            for connection in self._reader.connections
            if topics is None or connection.topic in topics
        ]
        if not wanted:
            return
        count = 0
        try:
            for connection, log_time, data in self._reader.messages(wanted):
                yield RawMessage(connection.topic, connection.msgtype, log_time, bytes(data))
                count += 1
        except Exception as error:  # rosbags lets the errors of its storages and parsers through
            self.warn(f'{self.path} is damaged after {count} messages ({error}): the rest is lost')

    @staticmethod
    def decode(message: RawMessage) -> Any:
        """Return the deserialized message; RecordingError if its data do not fit its type."""
        try:
            return deserialize(message.type, message.data)
        except Exception as error:
            raise RecordingError(
                f'message on {message.topic} at {message.log_time * 1e-9:.3f} s is not a '
                f'{message.type} ({len(message.data)} bytes): {error}'
            ) from error

    def _open(self) -> None:
        if self.path.is_dir() and not (self.path / 'metadata.yaml').exists():
            self._open_damaged('metadata.yaml is missing (the recording was not closed)')
            return
        try:
            reader = Reader(self.path)
            reader.open()
        except Exception as error:  # rosbags lets the errors of its storages and parsers through
            self._open_damaged(str(error))
            return
        self._reader = reader
        for connection in reader.connections:
            self.topics[connection.topic] = connection.msgtype
            self.counts[connection.topic] = (
                self.counts.get(connection.topic, 0) + connection.msgcount
            )
        if reader.message_count:
            self.start, self.end = reader.start_time, reader.end_time

    def _open_damaged(self, reason: str) -> None:
        """Read the storage files one by one where the bag as a whole cannot be opened."""
        if self.path.is_dir():
            files = sorted(file for file in self.path.iterdir() if file.suffix in SUFFIXES)
            if not files:
                raise RecordingError(f'{self.path} is not a bag: {reason}')
            self.warn(f'{self.path}: {reason}; reading its files one by one')
            for file in files:
                try:
                    self._parts.append(BagReader(file))
                except RecordingError as error:
                    self.warn(str(error))
        elif self.path.suffix == '.mcap':
            salvage = McapSalvage(self.path)
            self._survey(salvage)
            if not salvage.complete:
                self.warn(
                    f'{self.path} is truncated: its first {self.message_count} messages are used'
                )
            self._parts.append(salvage)
        else:
            raise RecordingError(f'{self.path} cannot be read: {reason}')
        parts = [part for part in self._parts if isinstance(part, BagReader)]
        for part in parts:
            self.topics |= part.topics
            self.warnings += part.warnings
            for topic, count in part.counts.items():
                self.counts[topic] = self.counts.get(topic, 0) + count
        if parts:
            self.start = min(part.start for part in parts)
            self.end = max(part.end for part in parts)
        if not self.message_count:
            raise RecordingError(f'{self.path} holds no readable message: {reason}')

    def _survey(self, salvage: McapSalvage) -> None:
        for message in salvage.messages():
            self.start = message.log_time if not self.counts else min(self.start, message.log_time)
            self.end = max(self.end, message.log_time)
            self.topics[message.topic] = message.type
            self.counts[message.topic] = self.counts.get(message.topic, 0) + 1

    def warn(self, text: str) -> None:
        """Keep a warning: the caller shows it in the report, on the terminal or in a log."""
        logger.info('%s', text)
        self.warnings.append(text)


class BagWriter:
    """Writes a rosbag2 folder with mcap storage; it stays readable if the block raises."""

    def __init__(self, path: Path, *, compress: bool = False) -> None:
        self.path = path
        self._connections: dict[str, Connection] = {}
        try:
            self._writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
            if compress:
                self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
        except (WriterError, OSError) as error:
            raise RecordingError(f'{path} cannot be written: {error}') from error

    def __enter__(self) -> 'BagWriter':
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Write the index and close; a second call does nothing."""
        if self._writer.storage is None:
            return
        if not any(self._writer.counts.values()):
            # rosbags would write the largest integer as start time of an empty bag
            self._writer.min_timestamp = 0
        self._writer.close()

    @property
    def message_count(self) -> int:
        """Number of messages written."""
        return sum(self._writer.counts.values())

    def topic_counts(self) -> dict[str, int]:
        """Return messages written per topic."""
        counts = self._writer.counts
        return {topic: counts[item.id] for topic, item in self._connections.items()}

    def add_topic(self, topic: str, name: str, *, latched: bool = False) -> None:
        """Declare a topic and its type.

        latched: offer durability transient local, so that a player keeps the last message for
        late subscribers.
        """
        if topic in self._connections:
            return
        kind = full_name(name)
        if kind not in typestore().fielddefs:
            raise RecordingError(f'topic {topic}: message type {kind} is unknown')
        self._connections[topic] = self._writer.add_connection(
            topic, kind, typestore=typestore(), offered_qos_profiles=[_qos(latched)]
        )

    def write(self, topic: str, log_time: int, data: bytes) -> None:
        """Write CDR data, logged at log_time (ns), on a declared topic."""
        connection = self._connections.get(topic)
        if connection is None:
            raise RecordingError(f'topic {topic} was not declared in the bag {self.path}')
        self._writer.write(connection, log_time, data)

    def write_message(self, topic: str, name: str, stamp: float, message: Any) -> None:
        """Serialize a message and write it, logged at the stamp (s)."""
        self.add_topic(topic, name)
        self.write(topic, round(stamp * 1e9), serialize(name, message))


def _qos(latched: bool) -> Qos:
    never = QosTime(9223372036, 854775807)  # 2**63 - 1 ns: rmw's infinite duration
    return Qos(
        QosHistory.KEEP_LAST,
        1 if latched else 10,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        never,
        never,
        QosLiveliness.AUTOMATIC,
        never,
        avoid_ros_namespace_conventions=False,
    )
