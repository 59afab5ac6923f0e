"""Tags: flat markers with a number that a camera can read (AprilTag, ArUco); tags.yaml.

A tag is known by its number. Where it is, the map finds out, unless it has been surveyed: then the
poses in tags.yaml define the frame of the map.
"""

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from explore_slam.errors import ConfigError, ExploreSlamError
from explore_slam.files import read_mapping
from explore_slam.settings import Section, setting

logger = logging.getLogger(__name__)

# family -> bits across the pattern, number of tags (OpenCV 4.7, cv2.aruco predefined dictionaries)
FAMILIES: Mapping[str, tuple[int, int]] = {
    'tag16h5': (4, 30),
    'tag25h9': (5, 35),
    'tag36h10': (6, 2320),
    'tag36h11': (6, 587),
    **{f'{bits}x{bits}_{count}': (bits, count) for bits in (4, 5, 6, 7)
       for count in (50, 100, 250, 1000)},
    'aruco_original': (5, 1024),
}  # fmt: skip
# m: edge of a tag, from one that fits a chess piece to one that fills a door
_SMALLEST, _LARGEST = 0.01, 2.0
_FARTHEST = 1e4  # m from the origin: a surveyed pose beyond it is in other units
_DEFAULT_FAMILY = 'tag36h11'


class TagPose(NamedTuple):
    """Surveyed pose of a tag in the map: centre (m), and where it faces (rad); None: unknown."""

    x: float
    y: float
    yaw: float | None = None


@dataclass(frozen=True)
class TagTable:
    """What tags.yaml says.

    family: of all tags. size: edge (m) of the black square of tags without a size of their own;
    None: they are ignored. sizes: edge (m) by number, None: not to be used. poses: of the surveyed
    tags by number.
    """

    family: str = _DEFAULT_FAMILY
    size: float | None = None
    sizes: Mapping[int, float | None] = field(default_factory=dict)
    poses: Mapping[int, TagPose] = field(default_factory=dict)

    @property
    def is_empty(self) -> bool:
        """Whether there is no tag to look for."""
        return self.size is None and not any(self.sizes.values())

    def size_of(self, tag: int) -> float | None:
        """Return the edge (m) of a tag; None for one that is not to be used."""
        return self.sizes.get(tag, self.size)


@dataclass(frozen=True)
class TagConfig(Section):
    """Detection of tags, and what they are used for."""

    tags_file: str = setting(
        '',
        'Path of tags.yaml: family, numbers, sizes and, where surveyed, poses of the tags of the '
        'site (AprilTag or ArUco); empty: no tags are looked for',
    )
    tag_corner_noise: float = setting(
        0.3,
        'Standard deviation of the position of a corner of a tag in the image; in drawn images it '
        'is 0.02 to 0.09, the rest is for the calibration of real cameras',
        unit='pixels',
        low=0.01,
        high=20.0,
    )
    tag_scale_error: float = setting(
        0.005,
        'Relative error of the distance of a tag that all frames share: of its size and of the '
        'focal length',
        low=0.0,
        high=0.2,
    )
    tag_survey_deviation: float = setting(
        0.01,
        'Standard deviation of the surveyed positions of tags',
        unit='m',
        low=1e-4,
        high=1.0,
    )
    tag_survey_heading: float = setting(
        0.02,
        'Standard deviation of the surveyed headings of tags',
        unit='rad',
        low=1e-4,
        high=1.0,
    )


def table_of(config: TagConfig) -> TagTable:
    """Return the tags of the settings; a file that cannot be used is named in one warning.

    What is wrong in a usable file is named too, and left out. The same file is read once.
    """
    if not config.tags_file:
        return TagTable()
    path = Path(config.tags_file)
    try:
        changed = path.stat().st_mtime_ns
    except (OSError, ValueError):
        changed = 0
    return _read(path, changed)


@cache
def _read(path: Path, _changed: int) -> TagTable:
    try:
        table, problems = read_tags(path)
    except ExploreSlamError as error:
        logger.warning('%s; tags are not used', error)
        return TagTable()
    for problem in problems:
        logger.warning('%s: %s', path, problem)
    return table


def read_tags(path: Path) -> tuple[TagTable, list[str]]:
    """Return the table in a file, and what is wrong with its entries, which are left out.

    ConfigError if the file cannot be read, is not YAML or has no usable family.
    """
    content = read_mapping(path, ConfigError, 'family, size and a list of tags')
    unknown = sorted(str(key) for key in content if key not in ('family', 'size', 'tags'))
    problems = [
        f'there is no entry {key!r}, expected family, size and tags: ignored' for key in unknown
    ]
    family = content.get('family', _DEFAULT_FAMILY)
    if family not in FAMILIES:
        raise ConfigError(f'{path}: family is {family!r}, expected one of {list(FAMILIES)}')
    size = None
    if 'size' in content:
        size = _size('size', content['size'], problems)
    entries = content.get('tags') or []
    if not isinstance(entries, list):
        raise ConfigError(f'{path}: tags is {entries!r}, expected a list of tags, each with an id')
    sizes: dict[int, float | None] = {}
    poses: dict[int, TagPose] = {}
    for entry in entries:
        _add(entry, family, size, sizes, poses, problems)
    return TagTable(family, size, sizes, poses), problems


def _add(
    entry: Any,
    family: str,
    usual: float | None,
    sizes: dict[int, float | None],
    poses: dict[int, TagPose],
    problems: list[str],
) -> None:
    """Add an entry of the list of tags, or what is wrong with it."""
    tag = entry.get('id') if isinstance(entry, Mapping) else None
    count = FAMILIES[family][1]
    if not isinstance(tag, int) or isinstance(tag, bool) or not 0 <= tag < count:
        problems.append(
            f'tag {entry!r} has the id {tag!r}, expected a whole number from 0 to {count - 1} '
            f'({family}): left out'
        )
        return
    if tag in sizes:
        problems.append(f'tag {tag} is listed twice: the first entry counts')
        return
    if unknown := sorted(str(key) for key in entry if key not in ('id', 'size', 'pose')):
        problems.append(f'tag {tag} has {unknown}, expected id, size and pose: ignored')
    size = usual
    if 'size' in entry:
        size = _size(f'size of tag {tag}', entry['size'], problems)
    elif usual is None:
        problems.append(f'tag {tag} has no size, and there is none for all: left out')
    sizes[tag] = size
    if size is not None and 'pose' in entry:
        pose = _pose(entry['pose'])
        if pose is None:
            problems.append(
                f'pose of tag {tag} is {entry["pose"]!r}, expected [x, y] or [x, y, yaw] in m and '
                'rad, yaw being where the tag faces: it counts as not surveyed'
            )
        else:
            poses[tag] = pose


def _size(name: str, value: Any, problems: list[str]) -> float | None:
    if _is_number(value) and _SMALLEST <= value <= _LARGEST:
        return float(value)
    problems.append(
        f'{name} is {value!r}, expected the edge of the black square, {_SMALLEST:g} to '
        f'{_LARGEST:g} m: left out'
    )
    return None


def _pose(value: Any) -> TagPose | None:
    if not isinstance(value, list) or len(value) not in (2, 3):
        return None
    if not all(_is_number(part) and abs(part) <= _FARTHEST for part in value):
        return None
    yaw = float(value[2]) if len(value) == 3 else None
    return TagPose(float(value[0]), float(value[1]), yaw)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
