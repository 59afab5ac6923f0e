"""Map files of nav2's map_server: a YAML file and a PGM image."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from explore_slam.errors import ConfigError, MappingError
from explore_slam.files import read_mapping, write_bytes
from explore_slam.mapping.config import GridConfig
from explore_slam.mapping.occupancy_grid import OccupancyGrid

FREE, UNKNOWN, OCCUPIED = 254, 205, 0  # grey values that map_saver of nav2 writes
# Thresholds of occupancy (255 - grey) / 255, the defaults of map_saver. Unknown is 50 / 255, just
# above 0.196, so that it stays unknown in every map_server.
FREE_THRESHOLD, OCCUPIED_THRESHOLD = 0.196, 0.65
_MAXIMUM_HEADER = 4096  # bytes searched for the size of the image; comments may make it long
_MAXIMUM_DIGITS = 9  # of a number in the header; longer ones are damage


def save_map(grid: OccupancyGrid, base_path: Path | str) -> Path:
    """Write base_path.pgm and base_path.yaml; return the path of the YAML file.

    Each file is written atomically, the image first, so that a YAML file never names an image
    that is missing. MappingError for an empty grid or a folder that cannot be written.
    """
    base = Path(base_path)
    if base.suffix in ('.yaml', '.pgm'):
        base = base.with_suffix('')
    if 0 in grid.shape:
        raise MappingError('the grid is empty, there is no map to save')
    image_path, yaml_path = base.with_name(base.name + '.pgm'), base.with_name(base.name + '.yaml')
    image = _to_image(grid)
    header = f'P5\n{image.shape[1]} {image.shape[0]}\n255\n'.encode('ascii')
    x, y = grid.origin
    content = {
        'image': image_path.name,
        'mode': 'trinary',
        'resolution': grid.resolution,
        'origin': [x, y, 0.0],
        'negate': 0,
        'occupied_thresh': OCCUPIED_THRESHOLD,
        'free_thresh': FREE_THRESHOLD,
    }
    text = yaml.safe_dump(content, sort_keys=False).encode('utf-8')
    try:
        base.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(image_path, header + image.tobytes())
        write_bytes(yaml_path, text)
    except OSError as error:
        raise MappingError(f'map {base} cannot be written: {error}') from error
    return yaml_path


def _to_image(grid: OccupancyGrid) -> NDArray[np.uint8]:
    """Return (H, W) grey values with the highest y in the first row, as in map files."""
    cells = grid.to_trinary()
    image = np.full(grid.shape, UNKNOWN, np.uint8)
    image[cells == 0] = FREE
    image[cells == 100] = OCCUPIED
    return np.ascontiguousarray(image[::-1])


def load_map(yaml_path: Path | str, config: GridConfig | None = None) -> OccupancyGrid:
    """Read a map (trinary, scale or raw) from a YAML file and the PGM image it names.

    config: settings of the grid; the resolution is that of the file.
    MappingError, naming the file and the entry, for what is missing, truncated or of another
    format.
    """
    path = Path(yaml_path)
    entries = read_mapping(path, MappingError, 'a mapping with the keys of a map_server map')
    resolution = _number(path, entries, 'resolution')
    origin = entries.get('origin')
    if not (
        isinstance(origin, list)
        and len(origin) == 3
        and all(isinstance(value, int | float) for value in origin)
    ):
        raise MappingError(f'{path}: origin is {origin!r}, expected [x, y, yaw]')
    if float(origin[2]) != 0.0:
        raise MappingError(f'{path}: origin has a yaw of {origin[2]}, expected 0')
    image_name = entries.get('image')
    if not isinstance(image_name, str):
        raise MappingError(f'{path}: image is {image_name!r}, expected the name of a PGM file')
    image = read_pgm(path.parent / image_name)
    probability, known = _interpret(path, entries, image)
    values = {**(config or GridConfig()).__dict__, 'resolution': resolution}
    try:
        fitted = GridConfig(**values)
    except ConfigError as error:
        raise MappingError(f'{path}: {error}') from error
    # Cell edges lie on multiples of the resolution, so the map moves by half a cell at most.
    corner = tuple(round(float(value) / resolution) * resolution for value in origin[:2])
    return OccupancyGrid.from_probability(probability, known, (corner[0], corner[1]), fitted)


def _number(path: Path, entries: dict[str, Any], name: str, default: float | None = None) -> float:
    value = entries.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise MappingError(f'{path}: {name} is {value!r}, expected a number')
    return float(value)


def _interpret(
    path: Path, entries: dict[str, Any], image: NDArray[np.uint8]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return probability and known cells (H, W), lowest y first, by the mode of the map.

    The modes trinary, scale and raw are those of map_server in nav2.
    """
    mode = entries.get('mode', 'trinary')
    occupied_from = _number(path, entries, 'occupied_thresh', OCCUPIED_THRESHOLD)
    free_to = _number(path, entries, 'free_thresh', FREE_THRESHOLD)
    if not 0.0 <= free_to < occupied_from <= 1.0:
        raise MappingError(
            f'{path}: free_thresh {free_to} and occupied_thresh {occupied_from}, expected '
            '0 <= free_thresh < occupied_thresh <= 1'
        )
    pixels = image[::-1].astype(np.float64)
    if mode == 'raw':
        return np.clip(pixels / 100.0, 0.0, 1.0), pixels <= 100.0
    shade = pixels / 255.0 if entries.get('negate', 0) else (255.0 - pixels) / 255.0
    if mode == 'scale':
        return shade, np.ones(shade.shape, np.bool_)
    if mode != 'trinary':
        raise MappingError(f'{path}: mode is {mode!r}, expected trinary, scale or raw')
    occupied, free = shade > occupied_from, shade < free_to
    return occupied.astype(np.float64), occupied | free


def read_pgm(path: Path | str) -> NDArray[np.uint8]:
    """Read a PGM image (P5 binary or P2 text, 8 bit) as (H, W), top row first."""
    name = Path(path)
    try:
        content = name.read_bytes()
    except OSError as error:
        raise MappingError(f'image {name} cannot be read: {error}') from error
    if content[:2] not in (b'P5', b'P2'):
        raise MappingError(f'image {name} starts with {content[:2]!r}, expected P5 or P2 (PGM)')
    (width, height, highest), start = _header_numbers(name, content)
    if width < 1 or height < 1 or not 1 <= highest <= 255:
        raise MappingError(
            f'image {name} is {width} x {height} with a maximum grey value of {highest}, '
            'expected an 8-bit PGM'
        )
    if content[:2] == b'P5':
        pixels = np.frombuffer(content, np.uint8, offset=start)
    else:
        try:
            pixels = np.array(content[start:].split(), np.int64)
        except ValueError as error:
            raise MappingError(f'image {name} contains text that is not a number') from error
    if pixels.size < width * height or pixels[: width * height].max() > highest:
        raise MappingError(
            f'image {name} has {pixels.size} pixels up to {pixels.max(initial=0)}, expected '
            f'{width} x {height} = {width * height} up to {highest}: truncated or damaged'
        )
    image = pixels[: width * height].reshape(height, width).astype(np.int64)
    return (image * 255 // highest).astype(np.uint8)


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
