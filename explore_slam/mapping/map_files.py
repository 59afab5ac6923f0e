"""Map files of nav2's map_server: a YAML file and the image (PGM, PNG, BMP) that it names.

`load_map` is the one reader of them. It reads what map_server and its map_saver define, and
differs in three points, all of which keep unknown cells unknown: grey 205 of a trinary image is
unknown whatever free_thresh says, alpha is not mixed with the grey values, and transparent pixels
are unknown in every mode.
"""

import functools
import logging
import math
from pathlib import Path, PureWindowsPath
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from explore_slam.errors import ConfigError, MappingError
from explore_slam.files import read_mapping, write_bytes
from explore_slam.geometry import Array
from explore_slam.mapping.config import GridConfig
from explore_slam.mapping.map_images import (
    MAXIMUM_PIXELS,
    GreyImage,
    is_image,
    read_image,
    row_blocks,
)
from explore_slam.mapping.occupancy_grid import FARTHEST, OccupancyGrid

logger = logging.getLogger(__name__)

FREE, UNKNOWN, OCCUPIED = 254, 205, 0  # grey values that map_saver of nav2 writes
# Thresholds of occupancy (255 - grey) / 255, the defaults of map_saver. Unknown is 50 / 255, just
# above 0.196, so that it stays unknown in every map_server.
FREE_THRESHOLD, OCCUPIED_THRESHOLD = 0.196, 0.65
_UNKNOWN_SHADE = (255 - UNKNOWN) / 255.0
# Grey 205 counts as map_saver's unknown if it is that many times as frequent as all greys within
# _PEAK_WIDTH of it (of 255); in an image with a continuum of greys it is not.
_PEAK, _PEAK_WIDTH = 10, 10
_YAML_SUFFIXES, _IMAGE_SUFFIXES = ('.yaml', '.yml'), ('.pgm', '.png', '.bmp')
_MODES = ('trinary', 'scale', 'raw')
_EXPECTED = 'a mapping with the keys of a map_server map'


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
        raise MappingError(f'map {base} cannot be written: {error.strerror or error}') from error
    return yaml_path


def _to_image(grid: OccupancyGrid) -> NDArray[np.uint8]:
    """Return (H, W) grey values with the highest y in the first row, as in map files."""
    cells = grid.to_trinary()
    image = np.full(grid.shape, UNKNOWN, np.uint8)
    image[cells == 0] = FREE
    image[cells == 100] = OCCUPIED
    return np.ascontiguousarray(image[::-1])


def load_map(
    path: Path | str, config: GridConfig | None = None, resolution: float | None = None
) -> OccupancyGrid:
    """Read a map (trinary, scale or raw): a YAML file, or an image with a YAML file beside it.

    config: settings of the grid; the resolution is that of the file.
    resolution: side of a cell (m) of an image without a YAML file, whose origin is (0, 0).
    MappingError, naming the file and the entry, for what is missing, truncated or of another
    format. What is read otherwise than it is written is logged as a warning, once.
    """
    path = Path(path)
    image_path: Path | None = None
    if _is_named_image(path):
        if not path.is_file():
            raise MappingError(f'{path}: no such file')
        image_path, yaml_path = path, _yaml_beside(path)
        if yaml_path is None and resolution is None:
            raise MappingError(
                f'{path} is the image of a map, expected a YAML file of this name beside it, '
                'which holds the resolution'
            )
    else:
        yaml_path = path
    entries: dict[str, Any] = {'resolution': resolution, 'origin': [0.0, 0.0, 0.0]}
    if yaml_path is not None:
        entries = read_mapping(yaml_path, MappingError, _EXPECTED)
        path = yaml_path
    side, (x, y, yaw) = _positive(path, entries, 'resolution'), _origin(path, entries)
    image = read_image(image_path or _image_path(path, entries))
    probability = _probability_of_levels(path, entries, image)
    values = {**(config or GridConfig()).__dict__, 'resolution': side}
    try:
        fitted = GridConfig(**values)
    except ConfigError as error:
        raise MappingError(f'{path}: {error}') from error
    levels = image.levels[::-1]
    if abs(yaw) * max(levels.shape) > 0.5:
        levels, x, y = _turned(path, image, (x, y, yaw), side)
    # Cell edges lie on multiples of the resolution, so the map moves by half a cell at most.
    corner = round(x / side) * side, round(y / side) * side
    return OccupancyGrid.from_levels(levels, probability, corner, fitted)


def is_map(path: Path) -> bool:
    """Return whether a file is a map: an image, or a YAML file that names one.

    A file that is only named like an image counts, too: it may be damaged.
    """
    if _is_named_image(path):
        return True
    try:
        return 'image' in read_mapping(path, MappingError, _EXPECTED)
    except MappingError:
        return False


def _is_named_image(path: Path) -> bool:
    return is_image(path) or path.suffix.lower() in _IMAGE_SUFFIXES


def _yaml_beside(image: Path) -> Path | None:
    """Return the YAML file beside an image that has its name, or None."""
    found = [
        path
        for path in _files_in(image.parent)
        if path.stem == image.stem and path.suffix.lower() in _YAML_SUFFIXES and path.is_file()
    ]
    return found[0] if found else None


def _files_in(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except OSError as error:
        raise MappingError(f'folder {folder} cannot be read: {error.strerror or error}') from error


@functools.cache
def _note(text: str) -> None:
    """Log a warning once: one map is read for the world, for its reachable area and so on."""
    logger.warning('%s', text)


def _image_path(path: Path, entries: dict[str, Any]) -> Path:
    """Return the image that a YAML file names; the file beside it if it names one elsewhere."""
    given = entries.get('image')
    if not isinstance(given, str) or not given.strip():
        raise MappingError(f'{path}: image is {given!r}, expected the name of an image file')
    named = path.parent / given
    if named.is_file():
        return named
    name = PureWindowsPath(given).name  # also takes the slashes of other systems
    files = {item.name.lower(): item for item in _files_in(path.parent) if item.is_file()}
    beside = files.get(name.lower())
    if beside is None:
        raise MappingError(
            f'{path}: image {given} cannot be read: no such file, and there is no {name} beside '
            f'{path.name}'
        )
    _note(f'{path}: there is no image {given}; {beside.name} beside the YAML file is used')
    return beside


def _number(path: Path, entries: dict[str, Any], name: str, default: float | None = None) -> float:
    return _finite(path, name, entries.get(name, default))


def _finite(path: Path, name: str, value: Any) -> float:
    """Return a finite number; YAML of Python takes 5e-2, without a point, as text."""
    number = math.nan
    if isinstance(value, int | float | str) and not isinstance(value, bool):
        try:
            number = float(value)
        except (ValueError, OverflowError):
            number = math.nan
    if not math.isfinite(number):
        raise MappingError(f'{path}: {name} is {value!r}, expected a finite number')
    return number


def _positive(path: Path, entries: dict[str, Any], name: str) -> float:
    value = _number(path, entries, name)
    if value <= 0.0:
        raise MappingError(f'{path}: {name} is {value}, expected more than 0 (m)')
    return value


def _origin(path: Path, entries: dict[str, Any]) -> tuple[float, float, float]:
    """Return x, y (m) of the lower left corner of the image and its yaw (rad)."""
    origin = entries.get('origin')
    if not isinstance(origin, list) or len(origin) != 3:
        raise MappingError(f'{path}: origin is {origin!r}, expected [x, y, yaw]')
    x, y, yaw = (
        _finite(path, f'origin {name}', v)
        for name, v in zip(('x', 'y', 'yaw'), origin, strict=True)
    )
    if max(abs(x), abs(y)) > FARTHEST:
        raise MappingError(f'{path}: origin is {origin!r}, expected at most {FARTHEST:g} m')
    if abs(yaw) > 2.0 * math.pi:
        raise MappingError(
            f'{path}: origin has a yaw of {yaw:g} rad, expected -2π to 2π; if it is in degrees, '
            f'write {math.radians(yaw):.6f}'
        )
    return x, y, math.remainder(yaw, 2.0 * math.pi)


def _turned(
    path: Path, image: GreyImage, origin: tuple[float, float, float], side: float
) -> tuple[NDArray[Any], float, float]:
    """Return the levels of a map with a yaw in cells along x and y, and their corner (m).

    origin: pose of the image's lower left corner. Each cell has the level of the pixel under its
    centre, so that walls stay as thick as they are; cells beside the image are transparent.
    """
    x, y, yaw = origin
    levels = image.levels[::-1]
    height, width = levels.shape
    cos, sin = math.cos(yaw), math.sin(yaw)
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]], np.float64)
    ends = corners @ np.array([[cos, sin], [-sin, cos]]) + (x / side, y / side)
    low = np.floor(ends.min(axis=0) + 1e-6).astype(np.int64)
    high = np.ceil(ends.max(axis=0) - 1e-6).astype(np.int64)
    columns, rows = (high - low).tolist()
    if rows * columns > MAXIMUM_PIXELS:
        raise MappingError(
            f'{path}: turned by its yaw of {yaw:g} rad, the map has {columns} x {rows} cells, '
            f'expected at most {MAXIMUM_PIXELS // 10**6} million'
        )
    kind = np.promote_types(levels.dtype, np.min_scalar_type(image.transparent))
    turned = np.full((rows, columns), image.transparent, kind)
    dx = (low[0] + np.arange(columns) + 0.5 - x / side)[None, :]
    for block in row_blocks(turned.shape):
        dy = (low[1] + np.arange(block.start, block.stop) + 0.5 - y / side)[:, None]
        column = np.floor(cos * dx + sin * dy).astype(np.int32)
        row = np.floor(cos * dy - sin * dx).astype(np.int32)
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        turned[block][inside] = levels[row[inside], column[inside]]
    return turned, float(low[0]) * side, float(low[1]) * side


def _probability_of_levels(path: Path, entries: dict[str, Any], image: GreyImage) -> Array:
    """Return the probability (K,) that a cell is occupied, by its level; NaN: unknown.

    The modes trinary, scale and raw are those of map_server in nav2.
    """
    mode = entries.get('mode', 'trinary')
    if mode not in _MODES:
        raise MappingError(f'{path}: mode is {mode!r}, expected one of {", ".join(_MODES)}')
    negate = entries.get('negate', 0)
    if negate not in (0, 1):
        raise MappingError(f'{path}: negate is {negate!r}, expected 0 or 1')
    occupied_from = _number(path, entries, 'occupied_thresh', OCCUPIED_THRESHOLD)
    free_to = _number(path, entries, 'free_thresh', FREE_THRESHOLD)
    if not 0.0 <= free_to < occupied_from <= 1.0:
        raise MappingError(
            f'{path}: free_thresh {free_to} and occupied_thresh {occupied_from}, expected '
            '0 <= free_thresh < occupied_thresh <= 1'
        )
    brightness = np.arange(image.white + 1) / image.white
    if mode == 'raw':
        percent = np.rint(255.0 * brightness)
        probability = np.where(percent <= 100.0, percent / 100.0, np.nan)
    else:
        shade = brightness if negate else 1.0 - brightness
        between = (shade - free_to) / (occupied_from - free_to)
        if mode == 'trinary':
            between = np.full(shade.shape, np.nan)
        probability = np.where(shade > occupied_from, 1.0, between)
        probability[shade < free_to] = 0.0
        if mode == 'trinary' and free_to > _UNKNOWN_SHADE:
            unknown = _unknown_of_map_saver(shade, image)
            if unknown.any():
                probability[unknown] = np.nan
                _note(
                    f'{path}: grey {UNKNOWN} is unknown, as map_saver writes it, although '
                    f'free_thresh {free_to:g} says that it is free'
                )
    return np.append(probability, np.nan)


def _unknown_of_map_saver(shade: Array, image: GreyImage) -> NDArray[np.bool_]:
    """Return the levels (K,) that are the grey with which map_saver marks unknown cells.

    map_saver of nav2 writes 0, 205 and 254, and a free_thresh of 0.25 above the shade of 205.
    shade (K,): 0 (free) to 1 (occupied), of each level.
    """
    counts = np.zeros(image.white + 2, np.int64)
    for rows in row_blocks(image.levels.shape):
        counts += np.bincount(image.levels[rows].ravel(), minlength=len(counts))
    distance = np.abs(shade - _UNKNOWN_SHADE) * 255.0
    marks = distance < 1.01  # 16-bit images of other programs have 205 * 256
    around = (distance < _PEAK_WIDTH) & ~marks
    marked, others = counts[:-1][marks].sum(), counts[:-1][around].sum()
    if marked == 0 or marked < _PEAK * others:
        return np.zeros(shade.shape, np.bool_)
    return marks
