"""Bags: recordings of ROS 1 and ROS 2 are read, rosbag2 folders are written, without ROS."""

import heapq
import itertools
import logging
from collections.abc import Collection, Iterable, Iterator, Mapping
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
    StoragePlugin,
    Writer,
    WriterError,
)

from explore_slam.errors import RecordingError
from explore_slam.recording.rosbags_types import deserialize, full_name, serialize, typestore
from explore_slam.recording.storage.bag_folder import BagFiles, bag_files
from explore_slam.recording.storage.compression import ZSTD_MAGIC, decompress
from explore_slam.recording.storage.file_kinds import open_storage
from explore_slam.recording.storage.storage import RawMessage, Storage, UnusableTopic

logger = logging.getLogger(__name__)


class BagReader:
    """Reads a recording in the order of log times: a rosbag2 folder, or a file of any format.

    Formats: mcap, sqlite3 and ROS 1 bags, also compressed as a whole (.zstd, .bz2 ...). Damaged
    recordings are read as far as they can be.

    topics: message type by topic. counts: messages by topic that the files hold.
    expected: messages by topic that were counted when they were recorded; more than in counts
    where some are lost.
    unusable: topics whose messages cannot be used, with the reasons.
    start, end: first and last log time (ns).
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.topics: dict[str, str] = {}
        self.counts: dict[str, int] = {}
        self.expected: dict[str, int] = {}
        self.unusable: dict[str, UnusableTopic] = {}
        self.start = 0
        self.end = 0
        self._warnings: list[str] = []
        self._is_whole = True  # all files are there and can be opened
        found = bag_files(path)
        self._warnings += found.notes
        self._storages = self._open_all(found)
        try:
            self._join(found)
        except RecordingError:
            self.close()
            raise

    @property
    def message_count(self) -> int:
        """Number of messages on all topics."""
        return sum(self.counts.values())

    @property
    def rates(self) -> dict[str, float]:
        """Messages per second on each topic, also of those that are lost."""
        duration = max((self.end - self.start) * 1e-9, 1e-9)
        return {
            topic: max(count, self.expected.get(topic, 0)) / duration
            for topic, count in self.counts.items()
        }

    @property
    def warnings(self) -> list[str]:
        """What is wrong with the recording; more may come while it is read."""
        damages = [text for storage in self._storages for text in storage.damages]
        return [*self._warnings, *damages]

    def __enter__(self) -> 'BagReader':
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files."""
        for storage in self._storages:
            storage.close()

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield the messages of the given topics, or all; damaged ones are left out.

        Where fewer come than the files state, the warnings say so afterwards.
        """
        read: dict[str, int] = {}
        for message in self._by_time(topics):
            read[message.topic] = read.get(message.topic, 0) + 1
            if message.data[: len(ZSTD_MAGIC)] == ZSTD_MAGIC:  # CDR begins with a zero
                content, _ = decompress(message.data, 'zstd')
                yield message._replace(data=content)
            else:
                yield message
        self._compare(read, self.counts if topics is None else topics)

    def _by_time(self, topics: Collection[str] | None) -> Iterator[RawMessage]:
        parts = sorted(self._storages, key=lambda storage: storage.start)
        if all(a.end <= b.start for a, b in itertools.pairwise(parts)):
            return itertools.chain.from_iterable(part.messages(topics) for part in parts)
        return heapq.merge(
            *(part.messages(topics) for part in parts), key=lambda message: message.log_time
        )

    def _compare(self, read: Mapping[str, int], topics: Iterable[str]) -> None:
        """Warn of messages that were counted and could not be read."""
        lost = [
            f'{read.get(topic, 0)} of {self.expected[topic]} on {topic}'
            for topic in sorted(topics)
            if read.get(topic, 0) < self.expected.get(topic, 0)
        ]
        if lost:
            self.warn(f'{self.path}: messages are lost, read were {", ".join(lost)}')

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

    def _open_all(self, found: BagFiles) -> list[Storage]:
        """Open all files; RecordingError with the reasons if there is none that can be read."""
        storages, reasons = [], []
        for file in found.files:
            try:
                storages.append(open_storage(file))
            except RecordingError as error:
                reasons.append(str(error))
        reasons += [f'{self.path / name} is missing' for name in found.missing]
        if not storages:
            raise RecordingError('; '.join(reasons))
        self._is_whole = not reasons
        for reason in reasons:
            self.warn(f'{reason}: the rest of the recording is read')
        return storages

    def _join(self, found: BagFiles) -> None:
        """Add up what the files hold, and compare it with what metadata.yaml states."""
        for storage in self._storages:
            self.topics |= storage.topics
            self.unusable |= storage.unusable
            for topic in {*storage.counts, *storage.declared}:
                count = storage.counts.get(topic, 0)
                stated = max(count, storage.declared.get(topic, 0))
                self.counts[topic] = self.counts.get(topic, 0) + count
                self.expected[topic] = self.expected.get(topic, 0) + stated
        for topic in self.topics:
            self.counts.setdefault(topic, 0)
        held = [storage for storage in self._storages if storage.message_count]
        if held:
            self.start = min(storage.start for storage in held)
            self.end = max(storage.end for storage in held)
        if found.counts is not None:
            self._compare_with_metadata(found.counts)
        for topic, (_, reason) in sorted(self.unusable.items()):
            self.warn(f'{topic} holds {reason}, which cannot be used: expected CDR of ROS 2')
        if not self.message_count and (self.warnings or not self.topics):
            reasons = '; '.join(self.warnings) or 'there are none on any topic'
            raise RecordingError(f'{self.path} holds no readable message: {reasons}')

    def _compare_with_metadata(self, stated: Mapping[str, int]) -> None:
        """Warn of other numbers in metadata.yaml; those of damaged files are expected."""
        there = {t: count for t, count in stated.items() if count and t not in self.unusable}
        if there == {topic: count for topic, count in self.counts.items() if count}:
            return
        self.warn(
            f'{self.path}: metadata.yaml counts {sum(there.values())} messages, its files hold '
            f'{self.message_count}'
        )
        if self._is_whole and not any(storage.damages for storage in self._storages):
            return  # it is metadata.yaml that is wrong
        for topic, count in there.items():
            self.expected[topic] = max(self.expected.get(topic, 0), count)

    def warn(self, text: str) -> None:
        """Keep a warning, once: the caller shows it in the report, on the terminal or in a log."""
        if text not in self._warnings:
            logger.info('%s', text)
            self._warnings.append(text)


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
