"""Reading of truncated mcap files (format: mcap.dev/spec).

Readers usually need the index at the end of the file; this one reads records from the start and
stops at the first incomplete one.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from explore_slam.errors import RecordingError

MAGIC = b'\x89MCAP0\r\n'
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 0x03, 0x04, 0x05, 0x06, 0x0F
_RECORD = struct.Struct('<BQ')
_MESSAGE_HEAD = struct.Struct('<HIQQ')
_CHUNK_HEAD = struct.Struct('<QQQII')
MAX_RECORD = 2**32  # bytes; a longer record is damage


class RawMessage(NamedTuple):
    """One message as recorded: CDR data, logged at log_time (ns)."""

    topic: str
    type: str
    log_time: int
    data: bytes


class McapSalvage:
    """Reads the complete records of an mcap file from its start."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, tuple[str, str]] = {}
        self.complete = False

    def messages(self) -> Iterator[RawMessage]:
        """Yield messages in the order of the file, up to the first incomplete record."""
        self.complete = False
        with self._path.open('rb') as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise RecordingError(f'{self._path} is not an mcap file: its first bytes differ')
            while (record := _next_record(file)) is not None:
                kind, content = record
                if kind == _DATA_END:
                    self.complete = True
                    return
                yield from self._record(kind, content)

    def _record(self, kind: int, content: bytes) -> Iterator[RawMessage]:
        if kind == _SCHEMA:
            name, _ = _string(content, 2)
            self._schemas[int.from_bytes(content[:2], 'little')] = name
        elif kind == _CHANNEL:
            schema = self._schemas.get(int.from_bytes(content[2:4], 'little'), '')
            topic, _ = _string(content, 4)
            self._channels[int.from_bytes(content[:2], 'little')] = (topic, schema)
        elif kind == _CHUNK:
            yield from self._chunk(content)
        elif kind == _MESSAGE and len(content) >= _MESSAGE_HEAD.size:
            channel, _, log_time, _ = _MESSAGE_HEAD.unpack_from(content)
            if channel in self._channels:
                topic, schema = self._channels[channel]
                yield RawMessage(topic, schema, log_time, content[_MESSAGE_HEAD.size :])

    def _chunk(self, content: bytes) -> Iterator[RawMessage]:
        if len(content) < _CHUNK_HEAD.size:
            return
        size = _CHUNK_HEAD.unpack_from(content)[2]
        compression, at = _string(content, _CHUNK_HEAD.size - 4)
        records = _decompress(content[at + 8 :], compression, size)
        at = 0
        while at + _RECORD.size <= len(records):
            kind, length = _RECORD.unpack_from(records, at)
            at += _RECORD.size
            if at + length > len(records):
                return
            yield from self._record(kind, records[at : at + length])
            at += length


def _next_record(file: BinaryIO) -> tuple[int, bytes] | None:
    head = file.read(_RECORD.size)
    if len(head) < _RECORD.size:
        return None
    kind, length = _RECORD.unpack(head)
    if length > MAX_RECORD:
        return None
    content = file.read(length)
    # the complete messages of a truncated uncompressed chunk can still be used
    return (kind, content) if len(content) == length or kind == _CHUNK else None


def _string(content: bytes, at: int) -> tuple[str, int]:
    length = int.from_bytes(content[at : at + 4], 'little')
    end = at + 4 + length
    return content[at + 4 : end].decode('utf-8', 'replace'), end


def _decompress(data: bytes, compression: str, size: int) -> bytes:
    try:
        if compression == '':
            return data
        if compression == 'zstd':
            from backports import zstd

            return bytes(zstd.decompress(data))
        if compression == 'lz4':
            import lz4.frame  # type: ignore[import-untyped]

            return bytes(lz4.frame.decompress(data))
    except Exception:  # each library has its own error for truncated data
        return b''
    raise RecordingError(f'mcap chunk of {size} bytes: unknown compression {compression!r}')
