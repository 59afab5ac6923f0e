"""What a file is, by its first bytes: recordings of all formats, compressed or not, and others."""

import tempfile
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

from explore_slam.errors import RecordingError
from explore_slam.files import LFS_POINTER, is_lfs_pointer
from explore_slam.recording.storage import mcap_file, ros1_file, sqlite_file
from explore_slam.recording.storage.compression import FORMAT_OF_MAGIC, decompress_file
from explore_slam.recording.storage.storage import RawMessage, Storage

SUFFIXES = ('.mcap', '.db3', '.bag')
COMPRESSED_SUFFIXES = ('.zstd', '.zst', '.lz4', '.bz2', '.gz')
_OPENERS: dict[bytes, Callable[[Path], Storage]] = {
    mcap_file.MAGIC: mcap_file.McapFile,
    sqlite_file.MAGIC: sqlite_file.SqliteFile,
    ros1_file.MAGIC: ros1_file.Ros1File,
}
_LONGEST_MAGIC = 64  # bytes


def open_storage(path: Path) -> Storage:
    """Open a file of a recording; RecordingError names what it is instead."""
    head = first_bytes(path)
    for magic, opener in _OPENERS.items():
        if head.startswith(magic):
            return opener(path)
    for magic, compression in FORMAT_OF_MAGIC.items():
        if head.startswith(magic):
            return _Unpacked(path, compression)
    raise RecordingError(f'{path} is not a bag: {_what(head)}')


def first_bytes(path: Path) -> bytes:
    """Return the first bytes of a file; RecordingError if it cannot be read."""
    try:
        with path.open('rb') as file:
            return file.read(_LONGEST_MAGIC)
    except OSError as error:
        raise RecordingError(f'{path} cannot be read: {error.strerror}') from error


def check_not_lfs_pointer(path: Path) -> None:
    """Raise RecordingError if a file has not been fetched by Git LFS."""
    if path.is_file() and is_lfs_pointer(first_bytes(path)):
        raise RecordingError(f'{path} is {_what(first_bytes(path))}')


def _what(head: bytes) -> str:
    if not head:
        return 'it is empty (0 bytes)'
    if is_lfs_pointer(head):
        return LFS_POINTER
    if head.startswith(b'#ROSBAG V1'):
        return 'a bag of ROS 1 in format 1.x, which predates 2010; convert it with `rosbag fix`'
    if not any(head):
        return 'it begins with zeros, as if its data had never been written'
    return (
        f'it begins with {head[:12]!r}, expected an mcap file, a sqlite3 database of rosbag2 or a '
        'bag of ROS 1'
    )


class _Unpacked(Storage):
    """A file that is compressed as a whole; it is unpacked into a scratch folder."""

    def __init__(self, path: Path, compression: str) -> None:
        super().__init__(path)
        self._scratch = tempfile.TemporaryDirectory(prefix='explore_slam_')
        reason = ''
        try:
            unpacked = Path(self._scratch.name) / path.with_suffix('').name
            reason = decompress_file(path, unpacked, compression)
            self._inner = open_storage(unpacked)
        except OSError as error:
            self._scratch.cleanup()
            raise RecordingError(f'{path} cannot be unpacked: {error}') from error
        except RecordingError as error:
            self._scratch.cleanup()
            why = f'{reason}; ' if reason else ''
            raise RecordingError(f'{path}, unpacked: {why}{error}') from error
        if reason:
            self.damage(f'is read in part: {reason}')
        inner = self._inner
        self.topics, self.counts, self.declared = inner.topics, inner.counts, inner.declared
        self.unusable, self.start, self.end = inner.unusable, inner.start, inner.end

    @property
    def damages(self) -> list[str]:
        """What is wrong with the file, packed and unpacked."""
        return [*super().damages, *self._inner.damages]

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield the messages of some topics, or all, by log time."""
        return self._inner.messages(topics)

    def close(self) -> None:
        """Close the file and remove the scratch folder."""
        self._inner.close()
        self._scratch.cleanup()
