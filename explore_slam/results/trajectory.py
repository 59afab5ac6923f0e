"""Planar trajectories and their errors against ground truth, defined as in evo.

Absolute trajectory error (ATE): distance of positions at equal stamps, without alignment where
start poses are known, or after rigid alignment (Umeyama, Least-squares estimation of
transformation parameters between two point patterns, TPAMI 13(4), 1991). Relative pose error
(RPE): difference of motions over segments of a given path length (Sturm et al., A benchmark for
the evaluation of RGB-D SLAM systems, IROS 2012).
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from explore_slam.errors import EvaluationError
from explore_slam.geometry import (
    Array,
    Pose2,
    between,
    compose,
    interpolated,
    quaternion_from_yaw,
    wrap_angles,
    yaw_from_quaternion,
)
from explore_slam.recording.tum_format import SpatialPoses, read_poses, write_poses

# Ground truth is not interpolated over a gap (s) that is longer than this and than so many of its
# usual periods: logs of it are sometimes thinned to less than 1 Hz.
MAX_GAP, MAX_PERIODS = 1.0, 2.5


@dataclass(frozen=True)
class Trajectory:
    """Poses (T, 3) m, m, rad at strictly increasing stamps (T,) s; T may be 0."""

    stamps: Array
    poses: Array

    def __post_init__(self) -> None:
        if self.stamps.ndim != 1 or self.poses.shape != (self.stamps.size, 3):
            raise EvaluationError(
                f'Trajectory: stamps {self.stamps.shape} and poses {self.poses.shape}, '
                'expected (T,) and (T, 3)'
            )
        if not (np.isfinite(self.stamps).all() and np.isfinite(self.poses).all()):
            raise EvaluationError('Trajectory: a stamp or a pose is not finite')
        if (np.diff(self.stamps) <= 0.0).any():
            raise EvaluationError('Trajectory: stamps are not strictly increasing')

    def __len__(self) -> int:
        return int(self.stamps.size)

    @classmethod
    def of(cls, stamps: ArrayLike, poses: ArrayLike) -> 'Trajectory':
        """Make a trajectory of samples in any order; of equal stamps the last sample is kept."""
        times = np.asarray(stamps, dtype=np.float64).reshape(-1)
        samples = np.asarray(poses, dtype=np.float64).reshape(-1, 3)
        if len(times) != len(samples):
            raise EvaluationError(f'Trajectory: {len(times)} stamps for {len(samples)} poses')
        order = np.argsort(times, kind='stable')
        times, samples = times[order], samples[order]
        keep = np.append(np.diff(times) > 0.0, True) if len(times) else np.empty(0, bool)
        return cls(times[keep], samples[keep])

    @property
    def length(self) -> float:
        """Length of the path (m)."""
        return float(np.hypot(*np.diff(self.poses[:, :2], axis=0).T).sum())

    @property
    def duration(self) -> float:
        """Time from the first to the last pose (s)."""
        return float(self.stamps[-1] - self.stamps[0]) if len(self) else 0.0

    @property
    def largest_gap(self) -> float:
        """Time (s) between two poses up to which the path between them counts as known."""
        if len(self) < 2:
            return MAX_GAP
        return max(MAX_GAP, MAX_PERIODS * float(np.median(np.diff(self.stamps))))

    def at(
        self, stamps: ArrayLike, max_gap: float | None = None
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Interpolate linearly, headings along the shorter arc; return poses (N, 3), valid (N,).

        Stamps outside the trajectory, or in a gap of more than max_gap (s; default: largest_gap),
        are not valid.
        """
        times = np.asarray(stamps, dtype=np.float64)
        largest = self.largest_gap if max_gap is None else max_gap
        if not len(self):
            return np.zeros((times.size, 3)), np.zeros(times.size, bool)
        if len(self) == 1:
            return np.repeat(self.poses, times.size, axis=0), times == self.stamps[0]
        left = np.clip(np.searchsorted(self.stamps, times, 'right') - 1, 0, len(self) - 2)
        span = self.stamps[left + 1] - self.stamps[left]
        fraction = np.clip((times - self.stamps[left]) / span, 0.0, 1.0)
        poses = interpolated(self.poses[left], self.poses[left + 1], fraction)
        inside = (times >= self.stamps[0]) & (times <= self.stamps[-1])
        on_sample = (fraction == 0.0) | (fraction == 1.0)
        return poses, inside & (on_sample | (span <= largest))

    def from_start(self, start: Pose2) -> 'Trajectory':
        """Return this trajectory transformed so that its first pose is the given one."""
        if not len(self):
            return self
        return Trajectory(
            self.stamps, compose(np.asarray(start), between(self.poses[0], self.poses))
        )


def pairs(
    estimated: Trajectory, truth: Trajectory, max_gap: float | None = None
) -> tuple[Array, Array, Array]:
    """Associate an estimate with ground truth: stamps (N,), estimated and true poses (N, 3).

    Ground truth is interpolated to the stamps of the estimate.
    """
    poses, valid = truth.at(estimated.stamps, max_gap)
    if not valid.any():
        raise EvaluationError(
            f'no pose of the estimate ({len(estimated)} poses) lies within the ground truth '
            f'({len(truth)} poses): their times do not overlap'
        )
    return estimated.stamps[valid], estimated.poses[valid], poses[valid]


def align(poses: Array, reference: Array) -> Array:
    """Align poses (N, 3) rigidly to a reference by least squares of positions (Umeyama, 1991)."""
    if len(poses) < 2:
        return poses.copy()
    mean, mean_reference = poses[:, :2].mean(axis=0), reference[:, :2].mean(axis=0)
    centered, centered_reference = poses[:, :2] - mean, reference[:, :2] - mean_reference
    dot = float((centered * centered_reference).sum())
    cross = float(
        (
            centered[:, 0] * centered_reference[:, 1] - centered[:, 1] * centered_reference[:, 0]
        ).sum()
    )
    angle = math.atan2(cross, dot)
    c, s = math.cos(angle), math.sin(angle)
    moved = centered @ np.array([[c, s], [-s, c]]) + mean_reference
    return np.column_stack([moved, wrap_angles(poses[:, 2] + angle)])


@dataclass(frozen=True)
class ErrorStatistics:
    """Root mean square, mean, median and maximum of errors (N,), in their unit."""

    rms: float
    mean: float
    median: float
    maximum: float

    @classmethod
    def of(cls, errors: Array) -> 'ErrorStatistics':
        """Return the statistics of errors (N,), N >= 1."""
        if not errors.size:
            raise EvaluationError('error statistics: no errors, expected at least one')
        size = np.abs(errors)
        rms = float(np.sqrt(np.mean(np.square(size))))
        return cls(rms, float(size.mean()), float(np.median(size)), float(size.max()))


def position_errors(poses: Array, truth: Array) -> Array:
    """Return the position errors (N,) m of poses (N, 3) against true poses (N, 3)."""
    return np.hypot(poses[:, 0] - truth[:, 0], poses[:, 1] - truth[:, 1])


def heading_errors(poses: Array, truth: Array) -> Array:
    """Return the heading errors (N,) rad in (-pi, pi]."""
    return wrap_angles(poses[:, 2] - truth[:, 2])


def path_segments(truth: Array, length: float) -> list[int]:
    """Return the indices that cut a path (N, 3) into segments of at least this length (m)."""
    steps = np.hypot(*np.diff(truth[:, :2], axis=0).T)
    cuts, distance = [0], 0.0
    for index, step in enumerate(steps, start=1):
        distance += float(step)
        if distance >= length:
            cuts.append(index)
            distance = 0.0
    return cuts


def relative_errors(poses: Array, truth: Array, length: float = 1.0) -> tuple[Array, Array]:
    """Return the RPE over segments of the true path: translations (P,) m, rotations (P,) rad."""
    cuts = path_segments(truth, length)
    moved = between(poses[cuts[:-1]], poses[cuts[1:]])
    true = between(truth[cuts[:-1]], truth[cuts[1:]])
    error = between(true, moved)
    return np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2])


def trajectory_metrics(
    estimated: Trajectory, truth: Trajectory, max_gap: float | None = None
) -> dict[str, float]:
    """Return the errors of one trajectory by name (m, rad), and the number of poses compared."""
    _, poses, true = pairs(estimated, truth, max_gap)
    position = ErrorStatistics.of(position_errors(poses, true))
    heading = ErrorStatistics.of(heading_errors(poses, true))
    aligned = ErrorStatistics.of(position_errors(align(poses, true), true))
    translation, rotation = relative_errors(poses, true)
    metrics = {
        'poses': len(poses),
        'position_rms': position.rms,
        'position_mean': position.mean,
        'position_median': position.median,
        'position_max': position.maximum,
        'position_rms_aligned': aligned.rms,
        'heading_rms': heading.rms,
        'heading_max': heading.maximum,
    }
    if translation.size:
        metrics['relative_translation_rms'] = ErrorStatistics.of(translation).rms
        metrics['relative_rotation_rms'] = ErrorStatistics.of(rotation).rms
    return metrics


def save_tum(path: Path, trajectory: Trajectory) -> None:
    """Write a TUM trajectory file; z, qx and qy are 0."""
    positions = np.column_stack([trajectory.poses[:, :2], np.zeros(len(trajectory))])
    quaternions = [quaternion_from_yaw(theta) for theta in trajectory.poses[:, 2].tolist()]
    write_poses(
        path,
        SpatialPoses(trajectory.stamps, positions, np.reshape(quaternions, (-1, 4))),
    )


def load_tum(path: Path) -> Trajectory:
    """Read a TUM trajectory file and project it onto the plane: x, y and yaw."""
    stamps, positions, quaternions = read_poses(path)
    yaw = [yaw_from_quaternion(*q) for q in quaternions.tolist()]
    return Trajectory.of(stamps, np.column_stack([positions[:, :2], yaw]))
