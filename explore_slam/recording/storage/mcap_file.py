"""Files of the mcap format (mcap.dev/spec), read record by record.

The index is used to skip what need not be read, and only where it agrees with the statistics of
the file. Without it, the chunks themselves are read. After a damage, reading goes on at the next
chunk.
"""

import itertools
import mmap
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from explore_slam.errors import RecordingError
from explore_slam.recording.storage.compression import decompress
from explore_slam.recording.storage.ros1_messages import Conversion, conversion, ros2_name
from explore_slam.recording.storage.storage import (
    ChunkedFile,
    RawMessage,
    Span,
    UnusableTopic,
)

MAGIC = b'\x89MCAP0\r\n'
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06
_MESSAGE_INDEX, _STATISTICS, _DATA_END = 0x07, 0x0B, 0x0F
_LAST_KIND = 0x0F  # of records of the specification; others are private, from 0x80 on
_RECORD = struct.Struct('<BQ')
_MESSAGE_HEAD = struct.Struct('<HIQQ')
_CHUNK_HEAD = struct.Struct('<QQQII')
_STATISTICS_HEAD = struct.Struct('<QHIIIIQQI')
_INDEX_HEAD = struct.Struct('<HI')
_INDEX_ENTRY = 16  # bytes: log time and offset
_LOOSE = 1000  # messages outside of chunks that are read together


class _Channel(NamedTuple):
    """Topic, message type, and why its messages cannot be used, or their conversion from ROS 1."""

    topic: str
    type: str
    unusable: str
    convert: Conversion | None


class _Schema(NamedTuple):
    name: str
    definition: str


class _Record(NamedTuple):
    """Kind, and first and last byte of the content, which may be cut short by the end of file."""

    kind: int
    begin: int
    end: int


@dataclass
class _Survey:
    """What a first look at the records finds.

    chunks: each with the numbers of its messages by channel, as its index states them.
    stated: of all messages by channel, as the statistics state them; None without any.
    """

    chunks: list[tuple[_Record, dict[int, int]]] = field(default_factory=list)
    loose: list[_Record] = field(default_factory=list)
    stated: dict[int, int] | None = None
    complete: bool = False

    def is_indexed(self) -> bool:
        """Return whether the index of the chunks agrees with the statistics."""
        found: dict[int, int] = {}
        for _, counts in self.chunks:
            for channel, count in counts.items():
                found[channel] = found.get(channel, 0) + count
        if self.loose or self.stated is None:
            return False
        return found == {channel: count for channel, count in self.stated.items() if count}


class McapFile(ChunkedFile):
    """Reads one mcap file, whatever its state."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._schemas: dict[int, _Schema] = {}
        self._channels: dict[int, _Channel] = {}
        self._file = path.open('rb')
        self._bytes: mmap.mmap | bytes = b''
        if path.stat().st_size:
            self._bytes = mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_READ)
        if self._bytes[: len(MAGIC)] != MAGIC:
            self.close()
            raise RecordingError(f'{path} is not an mcap file: its first bytes differ')
        self._open()

    def close(self) -> None:
        """Close the file."""
        if isinstance(self._bytes, mmap.mmap):
            self._bytes.close()
        self._file.close()

    def _open(self) -> None:
        survey = self._survey()
        if survey.is_indexed() and all(
            channel in self._channels for channel in survey.stated or {}
        ):
            for record, counts in survey.chunks:
                self._add_indexed(record, counts)
        else:
            self._add_unindexed(survey)
        for channel, count in (survey.stated or {}).items():
            if count and channel in self._channels:
                topic = self._channels[channel].topic
                self.declared[topic] = self.declared.get(topic, 0) + count
        if not survey.complete:
            self.damage(f'is truncated: its first {self.message_count} messages can be read')
        for known in self._channels.values():
            if known.unusable:
                self.unusable[known.topic] = UnusableTopic(known.type, known.unusable)
                for table in (self.counts, self.declared):
                    table.pop(known.topic, None)
            else:
                self.topics[known.topic] = known.type

    def _survey(self) -> _Survey:
        """Go through the records of the file without reading the chunks."""
        found = _Survey()
        for record in self._records():
            if record.kind == _CHUNK:
                found.chunks.append((record, {}))
            elif record.kind == _MESSAGE:
                found.loose.append(record)
            elif record.kind == _MESSAGE_INDEX and found.chunks:
                channel, size = _INDEX_HEAD.unpack_from(self._bytes, record.begin)
                if size:
                    found.chunks[-1][1][channel] = size // _INDEX_ENTRY
            elif record.kind == _STATISTICS and record.end - record.begin >= _STATISTICS_HEAD.size:
                found.stated = self._statistics(record)
            elif record.kind in (_SCHEMA, _CHANNEL):
                self._define(record.kind, bytes(self._bytes[record.begin : record.end]))
            elif record.kind in (_DATA_END, _FOOTER):
                found.complete = True
        return found

    def _records(self) -> Iterator[_Record]:
        """Yield the records from the start; after a damage, those from the next chunk on."""
        at, size = len(MAGIC), len(self._bytes)
        while at + _RECORD.size <= size:
            kind, length = _RECORD.unpack_from(self._bytes, at)
            begin = at + _RECORD.size
            end = begin + length
            is_kind = 0 < kind <= _LAST_KIND or kind >= 0x80
            if is_kind and end <= size and self._is_sound(kind, begin, end):
                yield _Record(kind, begin, end)
                at = end
                if kind == _FOOTER:
                    return
                continue
            following = self._next_chunk(at + 1)
            if following is None:
                if kind == _CHUNK and end > size:  # cut short: its first messages can be used
                    yield _Record(kind, begin, size)
                elif is_kind and end <= size:
                    self.damage('is damaged from byte {} on', at)
                return
            self.damage('is damaged at byte {}: reading goes on at the next chunk', at)
            at = following

    def _is_sound(self, kind: int, begin: int, end: int) -> bool:
        """Return whether the parts of a chunk, or of a message, fit into its length."""
        if kind == _MESSAGE:
            return end - begin >= _MESSAGE_HEAD.size
        if kind != _CHUNK:
            return True
        return self._chunk_is_sound(begin, end)

    def _chunk_is_sound(self, begin: int, end: int) -> bool:
        if end - begin < _CHUNK_HEAD.size + 8:
            return False
        at = begin + _CHUNK_HEAD.size + int(_CHUNK_HEAD.unpack_from(self._bytes, begin)[-1])
        if at + 8 > end:
            return False
        return at + 8 + int.from_bytes(self._bytes[at : at + 8], 'little') == int(end)

    def _next_chunk(self, at: int) -> int | None:
        """Return the byte at which the next whole chunk begins."""
        for match in re.compile(re.escape(bytes([_CHUNK]))).finditer(self._bytes, at):
            start = match.start()
            if start + _RECORD.size > len(self._bytes):
                return None
            _, length = _RECORD.unpack_from(self._bytes, start)
            begin = start + _RECORD.size
            if begin + length <= len(self._bytes) and self._chunk_is_sound(begin, begin + length):
                return start
        return None

    def _statistics(self, record: _Record) -> dict[int, int]:
        head = _STATISTICS_HEAD.unpack_from(self._bytes, record.begin)
        at, size = record.begin + _STATISTICS_HEAD.size, head[-1]
        if at + size > record.end:
            return {}
        table = struct.iter_unpack('<HQ', self._bytes[at : at + size // 10 * 10])
        return {int(channel): int(count) for channel, count in table}

    def _define(self, kind: int, content: bytes) -> None:
        number = int.from_bytes(content[:2], 'little')
        if kind == _SCHEMA:
            name, at = _string(content, 2)
            _, at = _string(content, at)
            definition, _ = _string(content, at)
            self._schemas[number] = _Schema(name, definition)
            return
        topic, at = _string(content, 4)
        encoding, _ = _string(content, at)
        schema = self._schemas.get(int.from_bytes(content[2:4], 'little'), _Schema('', ''))
        known = self._channels.get(number)
        if known is None or (known.topic, bool(known.type)) != (topic, bool(schema.name)):
            self._channels[number] = _channel(topic, encoding, schema)

    def _add_indexed(self, record: _Record, counts: dict[int, int]) -> None:
        first, last, *_ = _CHUNK_HEAD.unpack_from(self._bytes, record.begin)
        for channel, count in counts.items():
            topic = self._channels[channel].topic
            self.counts[topic] = self.counts.get(topic, 0) + count
        if counts:
            topics = frozenset(self._channels[channel].topic for channel in counts)
            begin = record.begin - _RECORD.size
            self._keep_span(Span(begin, record.end, first, last, topics))

    def _add_unindexed(self, survey: _Survey) -> None:
        """Read all chunks and messages once, to count them and to know their times."""
        pieces = sorted([*(record for record, _ in survey.chunks), *survey.loose], key=_begin)
        for kind, group in itertools.groupby(pieces, key=lambda piece: piece.kind):
            together = _LOOSE if kind == _MESSAGE else 1
            for batch in itertools.batched(group, together):
                self._add_span(_begin(batch[0]), batch[-1].end)

    def _between(self, begin: int, end: int) -> Iterator[RawMessage]:
        at = begin
        while at + _RECORD.size <= end:
            kind, length = _RECORD.unpack_from(self._bytes, at)
            first, at = at + _RECORD.size, at + _RECORD.size + length
            if kind == _MESSAGE:
                yield from self._message(self._bytes[first:at])
            elif kind == _CHUNK:
                yield from self._chunk(first, min(at, end))

    def _chunk(self, begin: int, end: int) -> Iterator[RawMessage]:
        if end - begin < _CHUNK_HEAD.size:
            return
        _, _, size, checksum, name = _CHUNK_HEAD.unpack_from(self._bytes, begin)
        first = begin + _CHUNK_HEAD.size + name
        compression = self._bytes[first - name : first].decode('utf-8', 'replace')
        records, reason = decompress(self._bytes[first + 8 : end], compression)
        if reason:
            self.damage(f'is damaged: the chunk at byte {{}} is read in part, {reason}', begin)
        elif len(records) != size:
            self.damage('is damaged: the chunk at byte {} is read in part, it is too short', begin)
        elif checksum and zlib.crc32(records) != checksum:
            self.damage(
                'is damaged: the checksum of the chunk at byte {} differs; its messages are used '
                'as far as they can be read', begin,
            )  # fmt: skip
        at = 0
        while at + _RECORD.size <= len(records):
            kind, length = _RECORD.unpack_from(records, at)
            at += _RECORD.size
            content = records[at : at + length]
            at += length
            if at > len(records):
                if not reason and len(records) == size:  # else it has been named
                    self.damage('is damaged: the chunk at byte {} is read in part', begin)
                return
            if kind == _MESSAGE:
                yield from self._message(content)
            elif kind in (_SCHEMA, _CHANNEL):
                self._define(kind, content)

    def _message(self, content: bytes) -> Iterator[RawMessage]:
        if len(content) < _MESSAGE_HEAD.size:
            return
        number, _, log_time, _ = _MESSAGE_HEAD.unpack_from(content)
        channel = self._channels.get(number)
        if channel is None:
            self.damage('is damaged: the topic of the messages of channel {} is lost', number)
            return
        if channel.unusable:
            return
        data = content[_MESSAGE_HEAD.size :]
        if channel.convert is not None:
            try:
                data = channel.convert(data)
            except Exception:  # rosbags lets the errors of its parsers through
                self.damage(
                    f'holds messages on {channel.topic} that are no {channel.type} of ROS 1, the '
                    'first logged at {} ns', log_time,
                )  # fmt: skip
                return
        yield RawMessage(channel.topic, channel.type, log_time, data)


def _begin(record: _Record) -> int:
    """Return the first byte of a record."""
    return record.begin - _RECORD.size


def _channel(topic: str, encoding: str, schema: _Schema) -> _Channel:
    if encoding == 'ros1':
        try:
            convert = conversion(schema.name, schema.definition)
        except Exception as error:  # rosbags lets the errors of its parsers through
            reason = f'messages of ROS 1 whose definition cannot be used ({error})'
            return _Channel(topic, schema.name, reason, None)
        return _Channel(topic, ros2_name(schema.name), '', convert)
    if encoding not in ('cdr', ''):
        return _Channel(topic, schema.name, f'{encoding.upper()} messages', None)
    return _Channel(topic, schema.name, '', None)


def _string(content: bytes, at: int) -> tuple[str, int]:
    length = int.from_bytes(content[at : at + 4], 'little')
    end = at + 4 + length
    return content[at + 4 : end].decode('utf-8', 'replace'), end
