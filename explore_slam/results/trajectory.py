"""Trajectories in the plane and their errors against the truth; defined as in the tool `evo`.

Absolute trajectory error (ATE) compares positions at equal stamps, without alignment where the
start poses are known, or after the rigid alignment of Umeyama (TPAMI 13(4), 1991). Relative pose
error (RPE) compares motions over pieces of a given path length (Sturm et al., IROS 2012).
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from explore_slam.errors import EvaluationError
from explore_slam.geometry import Array, Pose2, between, compose, wrap_angles

MAX_GAP = 1.0


@dataclass(frozen=True)
class Trajectory:
    """Poses (T, 3) m, m, rad at strictly rising stamps (T,) s; T may be 0."""

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
            raise EvaluationError('Trajectory: stamps do not rise strictly')

    def __len__(self) -> int:
        return int(self.stamps.size)

    @classmethod
    def of(cls, stamps: ArrayLike, poses: ArrayLike) -> 'Trajectory':
        """Make a trajectory of samples in any order; of equal stamps the last sample stays."""
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

    def at(self, stamps: ArrayLike, max_gap: float = MAX_GAP) -> tuple[Array, Array]:
        """Return (poses (N, 3), valid (N,) bool): linear interpolation, the turn the short way.

        Not valid are stamps outside the trajectory and inside a gap of more than max_gap (s).
        """
        times = np.asarray(stamps, dtype=np.float64)
        if not len(self):
            return np.zeros((times.size, 3)), np.zeros(times.size, bool)
        if len(self) == 1:
            return np.repeat(self.poses, times.size, axis=0), times == self.stamps[0]
        left = np.clip(np.searchsorted(self.stamps, times, 'right') - 1, 0, len(self) - 2)
        span = self.stamps[left + 1] - self.stamps[left]
        share = np.clip((times - self.stamps[left]) / span, 0.0, 1.0)
        step = self.poses[left + 1] - self.poses[left]
        step[:, 2] = wrap_angles(step[:, 2])
        poses = self.poses[left] + share[:, None] * step
        poses[:, 2] = wrap_angles(poses[:, 2])
        inside = (times >= self.stamps[0]) & (times <= self.stamps[-1])
        on_sample = (share == 0.0) | (share == 1.0)
        return poses, inside & (on_sample | (span <= max_gap))

    def from_start(self, start: Pose2) -> 'Trajectory':
        """Return this trajectory moved so that its first pose is the given one."""
        if not len(self):
            return self
        return Trajectory(
            self.stamps, compose(np.asarray(start), between(self.poses[0], self.poses))
        )


def pairs(
    estimated: Trajectory, truth: Trajectory, max_gap: float = MAX_GAP
) -> tuple[Array, Array, Array]:
    """Return (stamps (N,), estimated (N, 3), true poses (N, 3)) at the stamps of the estimate."""
    poses, valid = truth.at(estimated.stamps, max_gap)
    if not valid.any():
        raise EvaluationError(
            f'no pose of the estimate ({len(estimated)} poses) lies within the truth '
            f'({len(truth)} poses): their times do not overlap'
        )
    return estimated.stamps[valid], estimated.poses[valid], poses[valid]


def align(poses: Array, reference: Array) -> Array:
    """Return poses (N, 3) moved rigidly so that positions fit the reference best (Umeyama)."""
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
        """Summarize errors (N,), N >= 1."""
        if not errors.size:
            raise EvaluationError('there are no errors to summarize')
        size = np.abs(errors)
        rms = float(np.sqrt(np.mean(np.square(size))))
        return cls(rms, float(size.mean()), float(np.median(size)), float(size.max()))


def position_errors(poses: Array, truth: Array) -> Array:
    """Return the distances (N,) m between poses (N, 3) and true poses (N, 3)."""
    return np.hypot(poses[:, 0] - truth[:, 0], poses[:, 1] - truth[:, 1])


def heading_errors(poses: Array, truth: Array) -> Array:
    """Return the heading errors (N,) rad in (-pi, pi]."""
    return wrap_angles(poses[:, 2] - truth[:, 2])


def path_pieces(truth: Array, length: float) -> list[int]:
    """Return indices that cut the path (N, 3) in pieces of at least the length (m)."""
    steps = np.hypot(*np.diff(truth[:, :2], axis=0).T)
    cuts, driven = [0], 0.0
    for index, step in enumerate(steps, start=1):
        driven += float(step)
        if driven >= length:
            cuts.append(index)
            driven = 0.0
    return cuts


def relative_errors(poses: Array, truth: Array, length: float = 1.0) -> tuple[Array, Array]:
    """Return the RPE over pieces of the true path: translations (P,) m and rotations (P,) rad."""
    cuts = path_pieces(truth, length)
    moved = between(poses[cuts[:-1]], poses[cuts[1:]])
    true = between(truth[cuts[:-1]], truth[cuts[1:]])
    error = between(true, moved)
    return np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2])


def trajectory_metrics(
    estimated: Trajectory, truth: Trajectory, max_gap: float = MAX_GAP
) -> dict[str, float]:
    """Return the errors of one trajectory by name: m, rad, `poses` a count."""
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
    """Write `stamp x y z qx qy qz qw` lines (TUM format); z, qx and qy are 0."""
    x, y, theta = trajectory.poses.T
    zero = np.zeros(len(trajectory))
    columns = [trajectory.stamps, x, y, zero, zero, zero, np.sin(theta / 2), np.cos(theta / 2)]
    with path.open('w', encoding='utf-8') as file:
        file.write('# timestamp tx ty tz qx qy qz qw\n')
        np.savetxt(file, np.column_stack(columns), fmt=['%.9f', *['%.6f'] * 3, *['%.9f'] * 4])


def load_tum(path: Path) -> Trajectory:
    """Read a TUM trajectory and keep what lies in the plane: x, y and the heading (yaw)."""
    try:
        table = np.loadtxt(path, ndmin=2)
    except (OSError, ValueError) as error:
        raise EvaluationError(f'{path} is not a TUM trajectory: {error}') from error
    if table.size == 0:
        return Trajectory(np.empty(0), np.empty((0, 3)))
    if table.shape[1] != 8:
        raise EvaluationError(f'{path} has {table.shape[1]} columns, expected 8 (TUM format)')
    _, x, y, _, qx, qy, qz, qw = table.T
    yaw = np.arctan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
    return Trajectory.of(table[:, 0], np.column_stack([x, y, yaw]))
