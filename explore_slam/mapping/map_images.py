"""Images of map files: PGM (P2 and P5, up to 16 bit), PNG and BMP as grey levels.

The first row is the top of the image. Colours are averaged as map_server of nav2 does it; the
alpha channel is not mixed with them: a pixel that is mostly transparent is a level of its own.
"""

import re
import struct
import zlib
from pathlib import Path
from string import whitespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.errors import MappingError
from explore_slam.files import LFS_POINTER, is_lfs_pointer

# Pixels of the largest image (10000 x 10000: 500 m at 0.05 m) and bytes of its decoded channels.
# A larger one is refused before it is decoded.
MAXIMUM_PIXELS, _MAXIMUM_BYTES = 100_000_000, 200_000_000
_MAXIMUM_TEXT_PIXELS = 16_000_000  # of P2, which takes 20 times as long to read
PIXELS_AT_ONCE = 1 << 20  # pixels that are converted at a time, which bounds the memory for it
_MAXIMUM_HEADER = 4096  # bytes searched for the size of a PGM image; comments may make it long
_MAXIMUM_DIGITS = 9  # of a number in the header; longer ones are damage
_MAXIMUM_GREY = 65535  # of PGM
_PNG, _BMP, _PGM = b'\x89PNG\r\n\x1a\n', b'BM', (b'P2', b'P5')
_PNG_CHANNELS = {0: 1, 2: 3, 3: 4, 4: 4, 6: 4}  # colour type -> channels as they are decoded
_OPAQUE_FROM = 0.5  # of the highest alpha


class GreyImage(NamedTuple):
    """An image of grey levels, the first row on top.

    levels: (H, W) uint8, uint16 or uint32; 0 is black, `white` is white, white + 1 transparent.
    """

    levels: NDArray[Any]
    white: int

    @property
    def transparent(self) -> int:
        """Level of a pixel without colour."""
        return self.white + 1


def is_image(path: Path) -> bool:
    """Return whether a file begins like an image that `read_image` takes; False without a file."""
    try:
        with path.open('rb') as file:
            begin = file.read(len(_PNG))
    except OSError:
        return False
    return begin == _PNG or begin[:2] == _BMP or (begin[:2] in _PGM and begin[2:3].strip() == b'')


def read_image(path: Path | str) -> GreyImage:
    """Read a PGM, PNG or BMP image; the content decides, not the name.

    MappingError, naming the file, for what is missing, truncated, too large or of another format.
    """
    name = Path(path)
    try:
        content = name.read_bytes()
    except OSError as error:
        raise MappingError(f'image {name} cannot be read: {error.strerror or error}') from error
    if content[:2] in _PGM:
        return _read_pgm(name, content)
    if content.startswith(_PNG):
        _check_png(name, content)
    elif content.startswith(_BMP):
        _check_bmp(name, content)
    elif is_lfs_pointer(content[:64]):
        raise MappingError(f'image {name} is {LFS_POINTER}')
    else:
        raise MappingError(
            f'image {name} starts with {content[:8]!r}, expected a PGM (P2, P5), PNG or BMP image'
        )
    return _decode(name, content)


def _check_size(name: Path, width: int, height: int, pixel_size: int) -> None:
    """Refuse an image without pixels, or one that would not fit into memory."""
    if width < 1 or height < 1:
        raise MappingError(f'image {name} has {width} x {height} pixels, expected at least one')
    if width * height > MAXIMUM_PIXELS or width * height * pixel_size > _MAXIMUM_BYTES:
        raise MappingError(
            f'image {name} has {width} x {height} pixels of {pixel_size} bytes, expected at most '
            f'{MAXIMUM_PIXELS // 10**6} million and {_MAXIMUM_BYTES // 10**6} MB: cut off its '
            'margins, make it grey, or reduce its resolution'
        )


def _check_png(name: Path, content: bytes) -> None:
    """See that all parts of a PNG file are there and undamaged: decoders accept half an image."""
    position, ended = len(_PNG), False
    while position + 12 <= len(content) and not ended:
        length, kind = struct.unpack_from('>I4s', content, position)
        end = position + 8 + length
        if end + 4 > len(content):
            break
        if zlib.crc32(content[position + 4 : end]) != struct.unpack_from('>I', content, end)[0]:
            raise MappingError(f'image {name} is damaged at byte {position} (checksum of PNG)')
        if kind == b'IHDR' and length == 13:
            width, height, depth, colors = struct.unpack_from('>IIBB', content, position + 8)
            channels = _PNG_CHANNELS.get(colors, 4)
            _check_size(name, width, height, channels * (2 if depth == 16 else 1))
        ended = kind == b'IEND'
        position = end + 4
    if not ended:
        raise MappingError(f'image {name} ends within the image: truncated PNG')


def _check_bmp(name: Path, content: bytes) -> None:
    """See that the pixels of a BMP file are all there."""
    if len(content) < 30:
        raise MappingError(f'image {name} ends within its header: truncated BMP')
    start, header = struct.unpack_from('<II', content, 10)
    if header < 40:
        raise MappingError(f'image {name} has a BMP header of {header} bytes, expected 40 or more')
    width, height, _, depth = struct.unpack_from('<iiHH', content, 18)
    (compression,) = struct.unpack_from('<I', content, 30)
    _check_size(name, width, abs(height), max(1, depth // 8))
    if compression == 0 and len(content) < start + (width * depth + 31) // 32 * 4 * abs(height):
        raise MappingError(
            f'image {name} has {len(content)} bytes, too few for {width} x {abs(height)} pixels '
            f'of {depth} bit: truncated BMP'
        )


def _decode(name: Path, content: bytes) -> GreyImage:
    """Decode a PNG or BMP image with OpenCV."""
    import cv2

    try:
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise MappingError(f'image {name} cannot be decoded: {error}') from error
    if image is None or image.dtype not in (np.uint8, np.uint16):
        raise MappingError(f'image {name} cannot be decoded: damaged, or of an unknown kind')
    white = int(np.iinfo(image.dtype).max)
    if image.ndim == 2:
        return GreyImage(image, white)
    alpha = image[..., 3] if image.shape[2] == 4 else None
    # BMP images of 32 bit often have zeros where alpha would be
    if alpha is not None and content.startswith(_BMP) and not alpha.any():
        alpha = None
    clear = False if alpha is None else int(alpha.min()) < _OPAQUE_FROM * white
    kind = np.min_scalar_type(white + 1) if clear else image.dtype
    levels = np.empty(image.shape[:2], kind)
    mean = np.zeros((1, image.shape[2]))
    mean[0, :3] = 1.0 / 3.0
    for rows in row_blocks(levels.shape):
        levels[rows] = cv2.transform(image[rows], mean)  # rounded to the nearest level
        if clear and alpha is not None:
            levels[rows][alpha[rows] < _OPAQUE_FROM * white] = white + 1
    return GreyImage(levels, white)


def row_blocks(shape: tuple[int, ...]) -> list[slice]:
    """Return slices of rows that together are an array of this shape (H, W)."""
    step = max(1, PIXELS_AT_ONCE // max(1, shape[1]))
    return [slice(first, min(first + step, shape[0])) for first in range(0, shape[0], step)]


def _read_pgm(name: Path, content: bytes) -> GreyImage:
    (width, height, white), start = _header_numbers(name, content)
    if not 1 <= white <= _MAXIMUM_GREY:
        raise MappingError(
            f'image {name} has a maximum grey value of {white}, expected 1 to {_MAXIMUM_GREY}'
        )
    size = 1 if white < 256 else 2
    _check_size(name, width, height, size)
    count = width * height
    if content[:2] == b'P5':
        # editors of other systems end the header with two characters, which are one line end
        if content[start - 1 : start + 1] == b'\r\n' and len(content) - start == count * size + 1:
            start += 1
        kind = np.dtype(np.uint8) if size == 1 else np.dtype('>u2')
        found = (len(content) - start) // size
        pixels = np.frombuffer(content, kind, min(found, count), start)
    else:
        pixels = _text_pixels(name, content[start:], count)
        found = pixels.size
    highest = int(pixels.max(initial=0))
    if found < count or highest > white:
        raise MappingError(
            f'image {name} has {found} pixels up to {highest}, expected '
            f'{width} x {height} = {count} up to {white}: truncated or damaged'
        )
    levels = pixels.reshape(height, width)
    return GreyImage(levels.astype(np.uint8 if size == 1 else np.uint16, copy=False), white)


def _text_pixels(name: Path, text: bytes, count: int) -> NDArray[Any]:
    """Return the numbers of a P2 image, at most `count`; comments may stand between them."""
    if count > _MAXIMUM_TEXT_PIXELS:
        raise MappingError(
            f'image {name} has {count} pixels as text, expected at most '
            f'{_MAXIMUM_TEXT_PIXELS // 10**6} million: save it as binary PGM (P5) or PNG'
        )
    text = re.sub(rb'#[^\r\n]*', b' ', text)
    if text.translate(None, b'0123456789' + whitespace.encode()):
        raise MappingError(f'image {name} contains text that is not a grey value')
    return np.fromstring(text, np.int64, sep=' ')[:count]


def _header_numbers(name: Path, content: bytes) -> tuple[tuple[int, int, int], int]:
    """Return width, height and maximum grey value, and the offset of the pixels (bytes)."""
    numbers: list[int] = []
    position = 2
    while len(numbers) < 3 and position < min(len(content), _MAXIMUM_HEADER):
        if content[position : position + 1] == b'#':
            end = content.find(b'\n', position)
            position = len(content) if end < 0 else end
        elif content[position : position + 1].isspace():
            position += 1
        else:
            end = position
            while end < len(content) and content[end : end + 1].isdigit():
                end += 1
            if end == position or end - position > _MAXIMUM_DIGITS:
                break
            numbers.append(int(content[position:end]))
            position = end
    if len(numbers) < 3:
        raise MappingError(f'image {name} has no header with width, height and grey values')
    return (numbers[0], numbers[1], numbers[2]), position + 1
