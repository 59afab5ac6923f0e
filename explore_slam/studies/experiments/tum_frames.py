"""Real Kinect frames with motion-capture ground truth as observations of a planar vehicle.

The frames are of the TUM RGB-D benchmark (Sturm et al., IROS 2012). The camera is hand-held: roll,
pitch and height are taken from ground truth, as from an inertial sensor; x, y and heading remain
to be estimated.
"""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import LandmarkObservations, RgbdFrame
from explore_slam.errors import EvaluationError, RecordingError
from explore_slam.geometry import Array, Pose2, planar_rotation
from explore_slam.recording.tum_format import Association, read_poses
from explore_slam.recording.tum_sequence import (
    TRUTH,
    Calibration,
    TumOptions,
    camera_of,
    frame_files,
)
from explore_slam.results.spatial_trajectory import SpatialTrajectory
from explore_slam.vision import FeatureExtractor, VisionConfig, decode_compressed
from explore_slam.vision.camera_mount import OPTICAL_TO_BODY, CameraMount

logger = logging.getLogger(__name__)

# Metres per unit of the depth images (Sturm et al., section III).
DEPTH_SCALE = np.float32(1.0 / 5000.0)
# Offset (s) from the stamps of images to those of motion capture: the one at which static points
# of fr1_rpy agree best, found by a search in steps of 5 ms.
DEFAULTS = TumOptions(truth_offset=-0.015)


@dataclass(frozen=True)
class TumFrame:
    """One frame: observations in the planar vehicle frame, true pose and true points.

    pose: true planar pose. points (K, 3): observed points in the world by the true pose (m).
    descriptors (A, 128): of all features of the image, with or without depth.
    """

    stamp: float
    pose: Pose2
    observations: LandmarkObservations
    points: Array
    descriptors: NDArray[np.float32]


class CameraTruth:
    """True poses of the camera body (x forward) over time, from groundtruth.txt."""

    def __init__(self, path: Path) -> None:
        self._trajectory = SpatialTrajectory(*read_poses(path))

    def at(self, stamp: float) -> tuple[Array, Array]:
        """Return rotation (3, 3) and position (3,) m at a stamp (s)."""
        pose = self._trajectory.at(stamp, max_gap=np.inf)
        if pose is None:
            first, last = self._trajectory.span
            raise EvaluationError(
                f'ground truth: no pose at {stamp:.3f} s, expected {first:.3f} to {last:.3f} s'
            )
        rotation, position = pose
        return rotation @ OPTICAL_TO_BODY.T, position


def read_tum(
    folder: Path,
    config: VisionConfig,
    every: int = 1,
    limit: int | None = None,
    options: TumOptions = DEFAULTS,
) -> list[TumFrame]:
    """Read frames of a TUM RGB-D folder (rgb, depth, their lists, groundtruth.txt).

    every: use each `every`-th frame. limit: largest number of frames.
    """
    try:
        associations = frame_files(folder, options.association_tolerance)[::every][:limit]
    except RecordingError as error:
        raise EvaluationError(f'{error} (--data FOLDER)') from error
    truth = CameraTruth(folder / TRUTH)
    sequence = _Sequence(folder, truth, camera_of(folder, options.camera), options.truth_offset)
    extractor = FeatureExtractor(config, CameraMount())
    frames = [_frame(sequence, association, extractor) for association in associations]
    logger.info('%s: %d frames', folder, len(frames))
    return frames


class _Sequence(NamedTuple):
    folder: Path
    truth: CameraTruth
    camera: Calibration
    truth_offset: float


def _frame(sequence: _Sequence, association: Association, extractor: FeatureExtractor) -> TumFrame:
    folder, truth = sequence.folder, sequence.truth
    try:
        color = decode_compressed((folder / association.color_file).read_bytes())
        depth = decode_compressed((folder / association.depth_file).read_bytes())
    except OSError as error:
        raise EvaluationError(f'{folder}: {error}') from error
    stamp = association.color_stamp
    height, width = depth.shape
    intrinsics = sequence.camera.intrinsics(width, height)
    metres = depth.astype(np.float32) * DEPTH_SCALE
    seen = extractor.extract(RgbdFrame(stamp, color, metres, intrinsics))
    rotation, position = truth.at(association.depth_stamp + sequence.truth_offset)
    heading = float(np.arctan2(rotation[1, 0], rotation[0, 0]))
    # From the camera body to the planar vehicle frame: undo the heading, keep roll and pitch.
    level = planar_rotation(-heading) @ rotation
    observations = LandmarkObservations(
        stamp,
        seen.positions @ level.T + np.array([0.0, 0.0, position[2]]),
        level @ seen.covariances @ level.T,
        seen.descriptors,
        seen.delays,
    )
    pose = Pose2(float(position[0]), float(position[1]), heading)
    points = seen.positions @ rotation.T + position
    return TumFrame(stamp, pose, observations, points, extractor.detect(color).descriptors)
