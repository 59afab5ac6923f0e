"""Decompression that gives as much as can be read of truncated or damaged data."""

import bz2
from collections.abc import Callable
from pathlib import Path
from typing import Any

from explore_slam.errors import RecordingError

ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'
LZ4_MAGIC = b'\x04\x22\x4d\x18'
BZ2_MAGIC = b'BZh'
GZIP_MAGIC = b'\x1f\x8b'
_PIECE = 4096  # bytes: what a damage costs at most, apart from the blocks of the format
_FILE_PIECE = 2**16  # bytes of a whole file that are decompressed at a time


def _zstd() -> Any:
    from backports import zstd

    return zstd.ZstdDecompressor()


def _lz4() -> Any:
    import lz4.frame  # type: ignore[import-untyped]

    return lz4.frame.LZ4FrameDecompressor()


def _gzip() -> Any:
    import zlib

    return zlib.decompressobj(wbits=31)


_DECOMPRESSORS: dict[str, Callable[[], Any]] = {
    'zstd': _zstd,
    'lz4': _lz4,
    'bz2': bz2.BZ2Decompressor,
    'gzip': _gzip,
}
FORMAT_OF_MAGIC = {ZSTD_MAGIC: 'zstd', LZ4_MAGIC: 'lz4', BZ2_MAGIC: 'bz2', GZIP_MAGIC: 'gzip'}


def decompress(data: bytes, compression: str) -> tuple[bytes, str]:
    """Return what can be decompressed, and '' or why it ended early.

    RecordingError for an unknown format.
    """
    if compression in ('', 'none'):
        return data, ''
    if compression not in _DECOMPRESSORS:
        raise RecordingError(
            f'compression {compression!r} is unknown, expected one of {sorted(_DECOMPRESSORS)}'
        )
    try:
        whole = _DECOMPRESSORS[compression]()
        content = bytes(whole.decompress(data))
    except Exception:  # each library has its own error
        content = b''
    else:
        return content, '' if whole.eof else f'its {compression} data end too early'
    found, decompressor = bytearray(), _DECOMPRESSORS[compression]()
    try:
        for at in range(0, len(data), _PIECE):
            found += decompressor.decompress(data[at : at + _PIECE])
    except Exception as error:  # as above
        return bytes(found), f'its {compression} data are damaged ({error})'
    return bytes(found), ''


def decompress_file(source: Path, target: Path, compression: str) -> str:
    """Write what can be decompressed of a file; return '' or why it ended early."""
    decompressor = _DECOMPRESSORS[compression]()
    with source.open('rb') as file, target.open('wb') as out:
        while data := file.read(_FILE_PIECE):
            while data:
                if decompressor.eof:  # several frames, one after the other
                    decompressor = _DECOMPRESSORS[compression]()
                try:
                    out.write(decompressor.decompress(data))
                except Exception as error:  # as above
                    return f'its {compression} data are damaged ({error})'
                data = decompressor.unused_data if decompressor.eof else b''
    return '' if decompressor.eof else f'its {compression} data end too early'
