"""Text files of the TUM RGB-D benchmark: trajectories, and associations of image files.

Sturm, Engelhard, Endres, Burgard, Cremers: A Benchmark for the Evaluation of RGB-D SLAM Systems,
IROS 2012. A trajectory has one pose per line, `timestamp tx ty tz qx qy qz qw`, which evo and
other evaluation tools read too; '#' starts a comment.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from explore_slam.errors import RecordingError
from explore_slam.files import atomic
from explore_slam.geometry import Array

HEADER = '# timestamp tx ty tz qx qy qz qw'
COLUMNS = 8


class SpatialPoses(NamedTuple):
    """Stamps (T,) s, positions (T, 3) m and quaternions (T, 4) x, y, z, w."""

    stamps: Array
    positions: Array
    quaternions: Array


class Association(NamedTuple):
    """One line of associations.txt: a colour image and the depth image that belongs to it."""

    color_stamp: float
    color_file: str
    depth_stamp: float
    depth_file: str


def read_poses(path: Path) -> SpatialPoses:
    """Read a trajectory file; a file without poses gives empty arrays."""
    lines = [line for _, line in _data_lines(path)]
    if not lines:
        return SpatialPoses(np.empty(0), np.empty((0, 3)), np.empty((0, 4)))
    try:
        table = np.loadtxt(lines, ndmin=2, dtype=np.float64)
    except ValueError as error:
        raise RecordingError(f'{path} is not a TUM trajectory: {error}') from error
    if table.shape[1] != COLUMNS:
        raise RecordingError(
            f'{path} has {table.shape[1]} columns, expected {COLUMNS} (TUM trajectory)'
        )
    if not np.isfinite(table).all():
        raise RecordingError(f'{path} holds a number that is not finite')
    return SpatialPoses(table[:, 0], table[:, 1:4], table[:, 4:])


def write_poses(path: Path, poses: SpatialPoses) -> None:
    """Write a trajectory file atomically: stamps to 1 ns, positions to 1 µm."""
    table = np.column_stack(poses)
    with atomic(path) as partial, partial.open('w', encoding='utf-8') as file:
        file.write(HEADER + '\n')
        np.savetxt(file, table, fmt=['%.9f', *['%.6f'] * 3, *['%.9f'] * 4])


def read_associations(path: Path) -> list[Association]:
    """Read `stamp color_file stamp depth_file` lines, sorted by the stamp of the colour image.

    Files in which the depth images come first are read as well.
    """
    found = []
    for number, line in _data_lines(path):
        try:
            first_stamp, first_file, second_stamp, second_file = line.split()
            pair = Association(float(first_stamp), first_file, float(second_stamp), second_file)
        except ValueError as error:
            raise RecordingError(
                f'{path} line {number} is {line!r}, expected: stamp file stamp file'
            ) from error
        if first_file.startswith('depth/') and second_file.startswith('rgb/'):
            pair = Association(*pair[2:], *pair[:2])  # associated in the other order
        found.append(pair)
    if not found:
        raise RecordingError(f'{path} names no frames')
    return sorted(found)


def read_images(path: Path) -> list[tuple[float, str]]:
    """Read `stamp file` lines of rgb.txt or depth.txt, sorted by stamp."""
    found = []
    for number, line in _data_lines(path):
        stamp, _, file = line.partition(' ')
        try:
            found.append((float(stamp), file.strip()))
        except ValueError as error:
            raise RecordingError(
                f'{path} line {number} is {line!r}, expected: stamp file'
            ) from error
    if not found:
        raise RecordingError(f'{path} names no images')
    return sorted(found)


def _data_lines(path: Path) -> list[tuple[int, str]]:
    """Return number and text of the lines that are neither empty nor comments."""
    try:
        text = path.read_text(encoding='utf-8')
    except (OSError, UnicodeDecodeError) as error:
        raise RecordingError(f'{path} cannot be read: {error}') from error
    lines = ((number, line.strip()) for number, line in enumerate(text.splitlines(), start=1))
    return [(number, line) for number, line in lines if line and not line.startswith('#')]
