"""Bags of ROS 1 (format 2.0, wiki.ros.org/Bags/Format/2.0), with and without an index.

Their messages become those of ROS 2. The index is not needed: the records are read from the start.
"""

import mmap
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from explore_slam.errors import RecordingError
from explore_slam.recording.storage.compression import decompress
from explore_slam.recording.storage.ros1_messages import Conversion, conversion, ros2_name
from explore_slam.recording.storage.storage import ChunkedFile, RawMessage, UnusableTopic

MAGIC = b'#ROSBAG V2.0\n'
_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7
_KINDS = (_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION)
_SIZE = struct.Struct('<I')
_PAIR = struct.Struct('<II')
_LONGEST_HEADER = 2**20  # bytes; a longer one is damage
_CHUNK_FIELD = b'compression='  # in the header of every chunk, and of nothing else
_FARTHEST = 64  # bytes from the start of a chunk to that field
_LOOSE = 1000  # messages outside of chunks that are read together


class _Connection(NamedTuple):
    topic: str
    type: str
    convert: Conversion | None


class _Record(NamedTuple):
    """A record: fields of its header, its first byte, and first and last byte of its data."""

    kind: int
    fields: dict[bytes, bytes]
    begin: int
    data: int
    end: int

    def number(self, name: bytes) -> int:
        value = self.fields.get(name, b'')
        return int(_SIZE.unpack(value)[0]) if len(value) == _SIZE.size else -1


class Ros1File(ChunkedFile):
    """Reads one bag of ROS 1, whatever its state."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._connections: dict[int, _Connection] = {}
        with path.open('rb') as file:
            self._bytes = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        if self._bytes[: len(MAGIC)] != MAGIC:
            first = self._bytes[: len(MAGIC)]
            raise RecordingError(f'{path} begins with {first!r}, expected {MAGIC!r}')
        self._open()

    def close(self) -> None:
        """Close the file."""
        self._bytes.close()

    def _open(self) -> None:
        spans: list[tuple[int, int]] = []
        loose, indexed = 0, False
        for record in self._records():
            if record.kind == _BAG:
                indexed = any(record.fields.get(b'index_pos', b''))
            elif record.kind == _CONNECTION:
                self._define(record, self._bytes)
            elif record.kind == _CHUNK_INFO:
                self._state(record)
            elif record.kind == _CHUNK:
                spans.append((record.begin, record.end))
                loose = 0
            elif record.kind == _MESSAGE:
                if 0 < loose < _LOOSE:
                    spans[-1] = (spans[-1][0], record.end)
                else:
                    spans.append((record.begin, record.end))
                    loose = 0
                loose += 1
        for begin, end in spans:
            self._add_span(begin, end)
        self._name_topics()
        if not indexed:
            self.damage(
                f'has no index (it was not closed): {self.message_count} messages can be read'
            )

    def _name_topics(self) -> None:
        for known in self._connections.values():
            if known.convert is not None:
                self.topics[known.topic] = known.type

    def _state(self, record: _Record) -> None:
        """Add the numbers of messages that the index states of a chunk."""
        table = self._bytes[record.data : record.end]
        for number, count in struct.iter_unpack('<II', table[: len(table) // 8 * 8]):
            if number in self._connections:
                topic = self._connections[number].topic
                self.declared[topic] = self.declared.get(topic, 0) + count

    def _records(self) -> Iterator[_Record]:
        at = len(MAGIC)
        while at + _PAIR.size <= len(self._bytes):
            record = _record(self._bytes, at)
            if record is not None and (record.end <= len(self._bytes) or record.kind == _CHUNK):
                following = None
                if record.end > len(self._bytes):
                    following = self._next_chunk(at + 1)
                if following is None:
                    yield record._replace(end=min(record.end, len(self._bytes)))
                    at = record.end
                    if at > len(self._bytes):
                        self.damage('is truncated at byte {}', len(self._bytes))
                    continue
            else:
                following = self._next_chunk(at + 1)
            if following is None:
                self.damage('is damaged or truncated from byte {} on', at)
                return
            self.damage('is damaged at byte {}: reading goes on at the next chunk', at)
            at = following

    def _next_chunk(self, at: int) -> int | None:
        """Return the byte at which the next whole chunk begins."""
        while (found := self._bytes.find(_CHUNK_FIELD, at)) >= 0:
            for start in range(max(at, found - _FARTHEST), found):
                record = _record(self._bytes, start)
                if (
                    record is not None
                    and record.kind == _CHUNK
                    and record.end <= len(self._bytes)
                    and start < found < record.data
                ):
                    return start
            at = found + len(_CHUNK_FIELD)
        return None

    def _between(self, begin: int, end: int) -> Iterator[RawMessage]:
        at = begin
        while at < end:
            record = _record(self._bytes, at)
            if record is None:
                return
            if record.kind == _CHUNK:
                yield from self._chunk(record, self._bytes[record.data : min(record.end, end)])
            elif record.kind == _MESSAGE:
                yield from self._message(record, self._bytes)
            at = record.end

    def _chunk(self, chunk: _Record, data: bytes) -> Iterator[RawMessage]:
        compression = chunk.fields.get(b'compression', b'none').decode('ascii', 'replace')
        content, reason = decompress(data, compression)
        if reason:
            reason = f'is damaged: the chunk at byte {{}} is read in part, {reason}'
            self.damage(reason, chunk.begin)
        elif len(content) < chunk.number(b'size'):
            self.damage('is damaged: the chunk at byte {} is cut short', chunk.begin)
        at = 0
        while (record := _record(content, at)) is not None and record.end <= len(content):
            if record.kind == _CONNECTION:
                self._define(record, content)
            elif record.kind == _MESSAGE:
                yield from self._message(record, content)
            at = record.end
        if at < len(content) and not reason:
            self.damage('is damaged: the chunk at byte {} is read in part', chunk.begin)

    def _message(self, record: _Record, content: 'bytes | mmap.mmap') -> Iterator[RawMessage]:
        known = self._connections.get(record.number(b'conn'))
        time = record.fields.get(b'time', b'')
        if known is None or len(time) != _PAIR.size:
            number = record.number(b'conn')
            self.damage('is damaged: the topic of the messages of connection {} is lost', number)
            return
        if known.convert is None:
            return
        seconds, nanoseconds = _PAIR.unpack(time)
        try:
            data = known.convert(content[record.data : record.end])
        except Exception:  # rosbags lets the errors of its parsers through
            reason = f'holds messages on {known.topic} that are no {known.type}, at byte {{}}'
            self.damage(reason, record.begin)
            return
        yield RawMessage(known.topic, known.type, seconds * 10**9 + nanoseconds, data)

    def _define(self, record: _Record, content: 'bytes | mmap.mmap') -> None:
        number = record.number(b'conn')
        if number in self._connections:
            return
        inner = _fields(content[record.data : record.end])
        topic = record.fields.get(b'topic', b'').decode('utf-8', 'replace')
        name = inner.get(b'type', b'').decode('utf-8', 'replace')
        definition = inner.get(b'message_definition', b'').decode('utf-8', 'replace')
        topic = '/' + topic.strip('/')
        try:
            convert = conversion(name, definition)
        except Exception as error:  # rosbags lets the errors of its parsers through
            reason = f'messages of ROS 1 whose definition cannot be used ({error})'
            self.unusable[topic] = UnusableTopic(name, reason)
            self._connections[number] = _Connection(topic, name, None)
            return
        self._connections[number] = _Connection(topic, ros2_name(name), convert)


def _record(content: 'bytes | mmap.mmap', at: int) -> _Record | None:
    """Return the record at a byte; None if there is none."""
    if at + _SIZE.size > len(content):
        return None
    (size,) = _SIZE.unpack_from(content, at)
    data = at + _SIZE.size + size + _SIZE.size
    if size > _LONGEST_HEADER or data > len(content):
        return None
    fields = _fields(content[at + _SIZE.size : data - _SIZE.size])
    kind = fields.get(b'op', b'')
    if len(kind) != 1 or kind[0] not in _KINDS:
        return None
    (length,) = _SIZE.unpack_from(content, data - _SIZE.size)
    return _Record(kind[0], fields, at, data, data + length)


def _fields(header: bytes) -> dict[bytes, bytes]:
    """Return the fields `name=value` of a header; those after a damage are left out."""
    found: dict[bytes, bytes] = {}
    at = 0
    while at + _SIZE.size <= len(header):
        (size,) = _SIZE.unpack_from(header, at)
        at += _SIZE.size
        name, equals, value = header[at : at + size].partition(b'=')
        if not equals or at + size > len(header):
            break
        found[name] = value
        at += size
    return found
