"""TUM RGB-D: registered Kinect frames of a hand-held camera, with motion-capture truth.

Sturm et al.: A Benchmark for the Evaluation of RGB-D SLAM Systems, IROS 2012. The camera moves in
six degrees of freedom and there is no odometry, so a planar vehicle cannot be made of it honestly:
the bag holds frames and the camera's true planar pose, and a replay extracts landmark observations
(see results/landmark_agreement).
"""

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import Intrinsics, RgbdFrame
from explore_slam.errors import RecordingError, VisionError
from explore_slam.messages.topics import TopicKind
from explore_slam.recording.events import Event, TruePose3
from explore_slam.recording.importers.importing import require, write_bag
from explore_slam.recording.tum_format import Association, read_associations, read_poses
from explore_slam.vision import decode_compressed

logger = logging.getLogger(__name__)

VEHICLE = 'robot1'
UNITS_PER_MILLIMETRE = 5.0
ASSOCIATIONS, TRUTH = 'associations.txt', 'groundtruth.txt'
# fx, fy, cx, cy and lens distortion of the three Kinects, as the data set's page gives them
CAMERAS: dict[str, tuple[float, float, float, float, tuple[float, ...]]] = {
    'freiburg1': (517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    'freiburg2': (520.9, 521.0, 325.1, 249.7, (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    'freiburg3': (535.4, 539.2, 320.1, 247.6, ()),
}
# the vehicle is the camera's body itself
SETTINGS: dict[str, float | str] = {
    'camera_x': 0.0,
    'camera_y': 0.0,
    'camera_z': 0.0,
    'camera_roll': 0.0,
    'camera_pitch': 0.0,
    'camera_yaw': 0.0,
}
# turns the body frame (x forward, z up) into the optical one (z forward, y down); x, y, z, w
BODY_FROM_OPTICAL = (0.5, -0.5, 0.5, 0.5)


def import_tum(folder: Path, out: Path, camera: str = 'freiburg1') -> dict[str, int]:
    """Write the data set in the folder as a bag; return messages per topic."""
    require(folder, [ASSOCIATIONS, 'rgb', 'depth'], 'a TUM RGB-D data set')
    if camera not in CAMERAS:
        raise RecordingError(f'camera is {camera!r}, expected one of {sorted(CAMERAS)}')
    pairs = read_associations(folder / ASSOCIATIONS)
    streams: list[Iterator[Event]] = [_frames(folder, pairs, camera)]
    if (folder / TRUTH).exists():
        streams.append(_truth(folder / TRUTH, pairs[0].color_stamp, pairs[-1].color_stamp))
    else:
        logger.warning('%s is missing: the bag has no ground truth', folder / TRUTH)
    return write_bag(out, streams, SETTINGS)


def _frames(folder: Path, pairs: list[Association], camera: str) -> Iterator[Event]:
    fx, fy, cx, cy, distortion = CAMERAS[camera]
    for stamp, color_name, _, depth_name in pairs:
        color, depth = _image(folder / color_name), _image(folder / depth_name)
        if depth.dtype != np.uint16 or color.dtype != np.uint8:
            raise RecordingError(
                f'{folder / depth_name} is of type {depth.dtype} and {folder / color_name} of '
                f'type {color.dtype}, expected uint16 and uint8'
            )
        height, width = depth.shape
        intrinsics = Intrinsics(width, height, fx, fy, cx, cy, distortion)
        yield Event(
            stamp,
            VEHICLE,
            TopicKind.COLOR,
            RgbdFrame(stamp, color, depth_millimetres(depth), intrinsics),
        )


def depth_millimetres(depth: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Return depth in units of 1/5000 m as mm, rounded; 0 (no data) stays 0."""
    return np.rint(depth / UNITS_PER_MILLIMETRE).astype(np.uint16)


def _image(path: Path) -> NDArray[Any]:
    try:
        return decode_compressed(path.read_bytes())
    except (OSError, VisionError) as error:
        raise RecordingError(f'{path} cannot be read as an image: {error}') from error


def _truth(path: Path, begin: float, end: float) -> Iterator[Event]:
    """Yield the camera body's true pose around the frames."""
    stamps, positions, quaternions = read_poses(path)
    inside = (stamps >= begin - 0.1) & (stamps <= end + 0.1)
    for stamp, position, optical in zip(
        stamps[inside].tolist(),
        positions[inside].tolist(),
        quaternions[inside].tolist(),
        strict=True,
    ):
        record = TruePose3(tuple(position), multiply(optical, BODY_FROM_OPTICAL))
        yield Event(stamp, VEHICLE, TopicKind.GROUND_TRUTH, record)


def multiply(a: Sequence[float], b: Sequence[float]) -> tuple[float, float, float, float]:
    """Return the product of two quaternions (x, y, z, w)."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )
