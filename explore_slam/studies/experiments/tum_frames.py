"""Real Kinect frames with motion-capture truth (TUM RGB-D), as observations of a planar vehicle.

The camera is hand-held: roll, pitch and height are taken from the truth (as from an inertial
sensor), so that x, y and heading are what is left to estimate.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from explore_slam.data import Intrinsics, LandmarkObservations, RgbdFrame
from explore_slam.errors import EvaluationError
from explore_slam.geometry import Array, Pose2
from explore_slam.vision import FeatureExtractor, VisionConfig, decode_compressed
from explore_slam.vision.camera_mount import OPTICAL_TO_BODY, CameraMount

logger = logging.getLogger(__name__)

DEPTH_SCALE = np.float32(1.0 / 5000.0)
# calibration of the freiburg1 Kinect as its page gives it, with the lens distortion
FREIBURG1 = Intrinsics(
    640, 480, 517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)
)
# stamps of the images lie this much (s) behind the motion capture's: the shift that lets static
# points agree best over fr1_rpy, found once by a search in steps of 5 ms
TRUTH_SHIFT = -0.015


@dataclass(frozen=True)
class TumFrame:
    """One frame: observations in the planar vehicle frame, true planar pose, true world points.

    descriptors (A, 128) are those of the whole image, whatever the depth.
    """

    stamp: float
    pose: Pose2
    observations: LandmarkObservations
    points: Array
    descriptors: NDArray[np.float32]


class TruePath:
    """Camera poses of groundtruth.txt: t tx ty tz qx qy qz qw, interpolated."""

    def __init__(self, path: Path) -> None:
        try:
            table = np.loadtxt(path, ndmin=2)
        except (OSError, ValueError) as error:
            raise EvaluationError(f'{path} cannot be read as a true path: {error}') from error
        if table.shape[1] != 8 or len(table) < 2:
            raise EvaluationError(f'{path} has shape {table.shape}, expected (N, 8) with N >= 2')
        self._table = table
        self._turns = Slerp(table[:, 0], Rotation.from_quat(table[:, 4:8]))

    def at(self, stamp: float) -> tuple[Array, Array]:
        """Return rotation (3, 3) of the camera body (x forward) and position (3,) m."""
        first, last = self._table[0, 0], self._table[-1, 0]
        if not first <= stamp <= last:
            raise EvaluationError(
                f'true path: {stamp:.3f} s, expected {first:.3f} to {last:.3f} s'
            )
        turn: Array = self._turns(stamp).as_matrix() @ OPTICAL_TO_BODY.T
        place = [np.interp(stamp, self._table[:, 0], self._table[:, k]) for k in (1, 2, 3)]
        return turn, np.array(place)


def read_tum(
    folder: Path, config: VisionConfig, every: int = 1, limit: int | None = None
) -> list[TumFrame]:
    """Return the frames of a TUM RGB-D folder (rgb, depth, associations.txt, groundtruth.txt)."""
    if not (folder / 'associations.txt').is_file():
        raise EvaluationError(
            f'{folder} holds no associations.txt, expected a TUM RGB-D data set such as fr1_rpy '
            '(--data FOLDER)'
        )
    path = TruePath(folder / 'groundtruth.txt')
    extractor = FeatureExtractor(config, CameraMount())
    frames = []
    lines = (folder / 'associations.txt').read_text(encoding='utf-8').splitlines()
    named = [text for text in lines if text.strip() and not text.startswith('#')]
    for line in named[::every][:limit]:
        words = line.split()
        if len(words) != 4:
            raise EvaluationError(f'{folder}/associations.txt: {line!r}, expected 4 columns')
        frames.append(_frame(folder, words, path, extractor))
    logger.info('%s: %d frames', folder, len(frames))
    return frames


def _frame(
    folder: Path, words: Sequence[str], path: TruePath, extractor: FeatureExtractor
) -> TumFrame:
    try:
        color = decode_compressed((folder / words[1]).read_bytes())
        depth = decode_compressed((folder / words[3]).read_bytes())
    except OSError as error:
        raise EvaluationError(f'{folder}: {error}') from error
    stamp = float(words[0])
    metres = depth.astype(np.float32) * DEPTH_SCALE
    seen = extractor.extract(RgbdFrame(stamp, color, metres, FREIBURG1))
    turn, place = path.at(float(words[2]) + TRUTH_SHIFT)
    heading = float(np.arctan2(turn[1, 0], turn[0, 0]))
    c, s = np.cos(heading), np.sin(heading)
    level = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ turn
    observations = LandmarkObservations(
        stamp,
        seen.positions @ level.T + np.array([0.0, 0.0, place[2]]),
        level @ seen.covariances @ level.T,
        seen.descriptors,
    )
    pose = Pose2(float(place[0]), float(place[1]), heading)
    points = seen.positions @ turn.T + place
    return TumFrame(stamp, pose, observations, points, extractor.detect(color).descriptors)
