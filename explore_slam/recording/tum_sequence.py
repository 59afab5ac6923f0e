"""Sequences of the TUM RGB-D benchmark as they are downloaded: frames, camera, ground truth.

Sturm, Engelhard, Endres, Burgard, Cremers: A Benchmark for the Evaluation of RGB-D SLAM Systems,
IROS 2012. The archives hold `rgb.txt` and `depth.txt`; `associations.txt`, which pairs their
images, is made from them by a script of the benchmark, or here.
"""

import logging
import re
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from explore_slam.data import Intrinsics
from explore_slam.errors import RecordingError
from explore_slam.recording.storage.file_kinds import check_not_lfs_pointer
from explore_slam.recording.tum_format import Association, read_associations, read_images
from explore_slam.settings import Section, setting

logger = logging.getLogger(__name__)

ASSOCIATIONS, TRUTH, COLORS, DEPTHS = (
    'associations.txt',
    'groundtruth.txt',
    'rgb.txt',
    'depth.txt',
)
AUTOMATIC = 'auto'
# of associate.py, the script of the benchmark
ASSOCIATION_TOLERANCE = 0.02  # s


class Calibration(NamedTuple):
    """Intrinsics (pixels) and distortion of a Kinect."""

    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...]

    def intrinsics(self, width: int, height: int) -> Intrinsics:
        """Return the intrinsics for images of a size."""
        return Intrinsics(width, height, self.fx, self.fy, self.cx, self.cy, self.distortion)


# of the three Kinects, from the data set's web page; the images of the third are rectified
CAMERAS = {
    'freiburg1': Calibration(
        517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)
    ),
    'freiburg2': Calibration(
        520.9, 521.0, 325.1, 249.7, (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)
    ),
    'freiburg3': Calibration(535.4, 539.2, 320.1, 247.6, ()),
}
_IN_NAME = re.compile(r'(?:freiburg|fr)[_-]?([123])(?!\d)', re.IGNORECASE)


@dataclass(frozen=True)
class TumOptions(Section):
    """Options for reading a sequence."""

    camera: str = setting(
        AUTOMATIC,
        'The Kinect that recorded the sequence; auto: by the name of the folder',
        choices=(AUTOMATIC, *CAMERAS),
    )
    association_tolerance: float = setting(
        ASSOCIATION_TOLERANCE,
        'Largest difference of the stamps of a colour and a depth image of one frame, where '
        'associations.txt is missing',
        unit='s',
        low=0.0,
        high=1.0,
    )
    truth_offset: float = setting(
        0.0,
        'From the stamps of the images to those of the motion capture at the same moment',
        unit='s',
        low=-10.0,
        high=10.0,
    )


def camera_of(folder: Path, camera: str = AUTOMATIC) -> Calibration:
    """Return the calibration: of the camera asked for, or by the name of the folder; log which."""
    named = _camera_in_name(folder)
    if camera != AUTOMATIC:
        if named not in (None, camera):
            logger.warning('%s is by its name of %s; --camera %s is used', folder, named, camera)
        return CAMERAS[camera]
    if named is None:
        named = next(iter(CAMERAS))
        logger.warning(
            '%s: its name does not tell the camera (freiburg1, 2 or 3); the intrinsics of %s are '
            'used, --camera takes others', folder, named,
        )  # fmt: skip
    else:
        logger.warning('%s: intrinsics of %s, by the name of the folder', folder, named)
    return CAMERAS[named]


def _camera_in_name(folder: Path) -> str | None:
    path = folder.resolve()
    for name in (path.name, path.parent.name):
        numbers = {f'freiburg{number}' for number in _IN_NAME.findall(name)}
        if len(numbers) == 1:
            return numbers.pop()
    return None


def frame_files(folder: Path, tolerance: float = ASSOCIATION_TOLERANCE) -> list[Association]:
    """Return the frames of a sequence: by associations.txt, or by the stamps of the images.

    RecordingError where neither it nor rgb.txt and depth.txt are there, and without any frame.
    """
    for name in (ASSOCIATIONS, COLORS, DEPTHS):
        check_not_lfs_pointer(folder / name)
    if (folder / ASSOCIATIONS).is_file():
        return read_associations(folder / ASSOCIATIONS)
    missing = [name for name in (COLORS, DEPTHS) if not (folder / name).is_file()]
    if missing:
        raise RecordingError(
            f'{folder} is not a TUM RGB-D data set: {", ".join(missing)} is missing, and so is '
            f'{ASSOCIATIONS}, which would do instead'
        )
    colors, depths = read_images(folder / COLORS), read_images(folder / DEPTHS)
    color_stamps = np.array([stamp for stamp, _ in colors])
    depth_stamps = np.array([stamp for stamp, _ in depths])
    pairs = associate(color_stamps, depth_stamps, tolerance)
    logger.info('%s: %d frames from %s and %s', folder, len(pairs), COLORS, DEPTHS)
    if not pairs:
        raise RecordingError(
            f'{folder}: no colour image of {len(colors)} has a depth image of {len(depths)} '
            f'within {tolerance:g} s'
        )
    if len(pairs) < len(colors):
        logger.warning(
            '%s: %d of %d colour images have no depth image within %g s: left out',
            folder, len(colors) - len(pairs), len(colors), tolerance,
        )  # fmt: skip
    return [Association(*colors[color], *depths[depth]) for color, depth in pairs]


def associate(
    first: 'np.ndarray[tuple[int], np.dtype[np.float64]]',
    second: 'np.ndarray[tuple[int], np.dtype[np.float64]]',
    tolerance: float,
) -> list[tuple[int, int]]:
    """Return pairs of numbers of stamps that differ by at most a tolerance, nearest first.

    No stamp is used twice. first (N,), second (M,) s, ascending. The pairs are sorted.
    """
    low = np.searchsorted(second, first - tolerance, 'left')
    high = np.searchsorted(second, first + tolerance, 'right')
    candidates = sorted(
        (abs(float(first[i] - second[j])), i, j)
        for i in range(len(first))
        for j in range(int(low[i]), int(high[i]))
    )
    used_first: set[int] = set()
    used_second: set[int] = set()
    pairs = []
    for _, i, j in candidates:
        if i not in used_first and j not in used_second:
            used_first.add(i)
            used_second.add(j)
            pairs.append((i, j))
    return sorted(pairs)
