"""Importer of TUM RGB-D: registered Kinect frames of a hand-held camera, motion-capture truth.

Sturm, Engelhard, Endres, Burgard and Cremers, "A benchmark for the evaluation of RGB-D SLAM
systems", IROS 2012. The camera moves in six degrees of freedom and there is no odometry, so it
cannot represent a planar vehicle: the bag holds frames and true poses only, which is what
results.landmark_agreement needs.
"""

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import RgbdFrame
from explore_slam.errors import RecordingError, VisionError
from explore_slam.geometry import Quaternion, multiply_quaternions
from explore_slam.messages.topics import TopicKind
from explore_slam.recording.events import Event, TruePose3
from explore_slam.recording.importers.importing import require, write_bag
from explore_slam.recording.importers.registry import importer
from explore_slam.recording.tum_format import Association, read_poses
from explore_slam.recording.tum_sequence import (
    ASSOCIATION_TOLERANCE,
    AUTOMATIC,
    TRUTH,
    Calibration,
    TumOptions,
    camera_of,
    frame_files,
)
from explore_slam.vision import decode_compressed

logger = logging.getLogger(__name__)

VEHICLE = 'robot1'
TRUTH_MARGIN = 0.1  # s before the first and after the last frame
UNITS_PER_MILLIMETRE = 5.0  # of the depth images: 5000 per metre
# the vehicle frame is the camera's body frame
SETTINGS: dict[str, float | str] = {
    'camera_x': 0.0,
    'camera_y': 0.0,
    'camera_z': 0.0,
    'camera_roll': 0.0,
    'camera_pitch': 0.0,
    'camera_yaw': 0.0,
}
# rotation of the body frame (x forward, z up) against the optical frame (z forward, y down)
BODY_IN_OPTICAL: Quaternion = (0.5, -0.5, 0.5, 0.5)


@importer('tum', 'TUM RGB-D: frames of a hand-held Kinect', options=TumOptions)
def import_tum(
    folder: Path,
    out: Path,
    camera: str = AUTOMATIC,
    association_tolerance: float = ASSOCIATION_TOLERANCE,
    truth_offset: float = 0.0,
) -> dict[str, int]:
    """Write the data set in the folder as a bag; return the messages per topic."""
    options = TumOptions(camera, association_tolerance, truth_offset)
    require(folder, ['rgb', 'depth'], 'a TUM RGB-D data set')
    pairs = frame_files(folder, options.association_tolerance)
    calibration = camera_of(folder, options.camera)
    streams: list[Iterator[Event]] = [_frames(folder, pairs, calibration)]
    if (folder / TRUTH).exists():
        begin, end = pairs[0].color_stamp, pairs[-1].color_stamp
        streams.append(_truth(folder / TRUTH, begin, end, options.truth_offset))
    else:
        logger.warning('%s is missing: the bag has no ground truth', folder / TRUTH)
    return write_bag(out, streams, SETTINGS)


def _frames(folder: Path, pairs: list[Association], camera: Calibration) -> Iterator[Event]:
    for stamp, color_name, _, depth_name in pairs:
        color, depth = _image(folder / color_name), _image(folder / depth_name)
        if depth.dtype != np.uint16 or color.dtype != np.uint8:
            raise RecordingError(
                f'{folder / depth_name} is of type {depth.dtype} and {folder / color_name} of '
                f'type {color.dtype}, expected uint16 and uint8'
            )
        height, width = depth.shape
        frame = RgbdFrame(stamp, color, depth_millimetres(depth), camera.intrinsics(width, height))
        yield Event(stamp, VEHICLE, TopicKind.COLOR, frame)


def depth_millimetres(depth: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Return depth in mm, rounded, from units of 1/5000 m; 0 (no data) stays 0."""
    return np.rint(depth / UNITS_PER_MILLIMETRE).astype(np.uint16)


def _image(path: Path) -> NDArray[Any]:
    try:
        return decode_compressed(path.read_bytes())
    except (OSError, VisionError) as error:
        raise RecordingError(f'{path} cannot be read as an image: {error}') from error


def _truth(path: Path, begin: float, end: float, offset: float) -> Iterator[Event]:
    """Yield the true poses of the camera's body frame while there are frames."""
    captured, positions, quaternions = read_poses(path)
    stamps = captured - offset
    inside = (stamps >= begin - TRUTH_MARGIN) & (stamps <= end + TRUTH_MARGIN)
    for stamp, (x, y, z), optical in zip(
        stamps[inside].tolist(),
        positions[inside].tolist(),
        quaternions[inside].tolist(),
        strict=True,
    ):
        record = TruePose3((x, y, z), multiply_quaternions(optical, BODY_IN_OPTICAL))
        yield Event(stamp, VEHICLE, TopicKind.GROUND_TRUTH, record)
