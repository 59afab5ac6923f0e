"""Real Kinect frames with motion-capture ground truth as observations of a planar vehicle.

The frames are of the TUM RGB-D benchmark (Sturm et al., IROS 2012). The camera is hand-held: roll,
pitch and height are taken from ground truth, as from an inertial sensor; x, y and heading remain
to be estimated.
"""

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import Intrinsics, LandmarkObservations, RgbdFrame
from explore_slam.errors import EvaluationError
from explore_slam.geometry import Array, Pose2, planar_rotation
from explore_slam.recording.tum_format import Association, read_associations, read_poses
from explore_slam.results.spatial_trajectory import SpatialTrajectory
from explore_slam.vision import FeatureExtractor, VisionConfig, decode_compressed
from explore_slam.vision.camera_mount import OPTICAL_TO_BODY, CameraMount

logger = logging.getLogger(__name__)

# Metres per unit of the depth images (Sturm et al., section III).
DEPTH_SCALE = np.float32(1.0 / 5000.0)
# Calibration of the freiburg1 Kinect with its lens distortion, from the page of the data set.
FREIBURG1 = Intrinsics(
    640, 480, 517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)
)
# Offset (s) from the stamps of images to those of motion capture: the one at which static points
# of fr1_rpy agree best, found by a search in steps of 5 ms.
TRUTH_OFFSET = -0.015


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
    folder: Path, config: VisionConfig, every: int = 1, limit: int | None = None
) -> list[TumFrame]:
    """Read frames of a TUM RGB-D folder (rgb, depth, associations.txt, groundtruth.txt).

    every: use each `every`-th frame. limit: largest number of frames.
    """
    if not (folder / 'associations.txt').is_file():
        raise EvaluationError(
            f'{folder} holds no associations.txt, expected a TUM RGB-D data set such as fr1_rpy '
            '(--data FOLDER)'
        )
    truth = CameraTruth(folder / 'groundtruth.txt')
    extractor = FeatureExtractor(config, CameraMount())
    associations = read_associations(folder / 'associations.txt')[::every][:limit]
    frames = [_frame(folder, association, truth, extractor) for association in associations]
    logger.info('%s: %d frames', folder, len(frames))
    return frames


def _frame(
    folder: Path, association: Association, truth: CameraTruth, extractor: FeatureExtractor
) -> TumFrame:
    try:
        color = decode_compressed((folder / association.color_file).read_bytes())
        depth = decode_compressed((folder / association.depth_file).read_bytes())
    except OSError as error:
        raise EvaluationError(f'{folder}: {error}') from error
    stamp = association.color_stamp
    metres = depth.astype(np.float32) * DEPTH_SCALE
    seen = extractor.extract(RgbdFrame(stamp, color, metres, FREIBURG1))
    rotation, position = truth.at(association.depth_stamp + TRUTH_OFFSET)
    heading = float(np.arctan2(rotation[1, 0], rotation[0, 0]))
    # From the camera body to the planar vehicle frame: undo the heading, keep roll and pitch.
    level = planar_rotation(-heading) @ rotation
    observations = LandmarkObservations(
        stamp,
        seen.positions @ level.T + np.array([0.0, 0.0, position[2]]),
        level @ seen.covariances @ level.T,
        seen.descriptors,
    )
    pose = Pose2(float(position[0]), float(position[1]), heading)
    points = seen.positions @ rotation.T + position
    return TumFrame(stamp, pose, observations, points, extractor.detect(color).descriptors)
