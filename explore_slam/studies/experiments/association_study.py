"""Precision of descriptor matching on real frames with ground truth; tables IV and V.

A match is correct when the two observed points, transformed to the world by the true poses, lie
within TOLERANCE of each other.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array, Pose2, planar_rotation
from explore_slam.results.landmark_agreement import squared_descriptor_distances
from explore_slam.studies.experiments.tum_frames import TumFrame

# Largest distance (m) of the two points of a correct match: depth noise of a Kinect at 3 m.
TOLERANCE = 0.10
# 99.9 % quantile of the chi-square distribution with three degrees of freedom.
CHI_SQUARE_999 = 16.27
# Ratio test (Lowe, Distinctive image features from scale-invariant keypoints, IJCV 60(2), 2004,
# section 7.1), here on squared distances.
RATIO_SQUARED = 0.8**2
RULES = ('descriptor', 'gated', 'mutual', 'ratio test')


@dataclass
class MatchCount:
    """Numbers of correct matches and of all matches, by rule and E0."""

    correct: dict[tuple[str, float], int] = field(default_factory=dict)
    total: dict[tuple[str, float], int] = field(default_factory=dict)

    def add(self, rule: str, e0: float, correct: NDArray[np.bool_]) -> None:
        """Count the matches of a pair of frames; correct (N,) marks the correct ones."""
        key = (rule, e0)
        self.correct[key] = self.correct.get(key, 0) + int(correct.sum())
        self.total[key] = self.total.get(key, 0) + len(correct)

    def precision(self, rule: str, e0: float) -> float:
        """Return the fraction of correct matches; NaN without any match."""
        total = self.total.get((rule, e0), 0)
        return self.correct[rule, e0] / total if total else float('nan')


@dataclass(frozen=True)
class PoseError:
    """Standard deviations (m, rad) of the pose of the second frame.

    Defaults: one step of 1 m with the odometry noise of table I at σ = 0.5.
    """

    position: float = 0.025
    heading: float = 0.026


def count_matches(
    frames: Sequence[TumFrame],
    stride: int,
    thresholds: Iterable[float],
    rng: np.random.Generator,
    error: PoseError | None = None,
) -> MatchCount:
    """Match each frame with the one `stride` before it, at each threshold E0, by four rules.

    descriptor: nearest descriptor; gated: nearest of the landmarks inside the Mahalanobis gate;
    mutual: additionally nearest in the other direction; ratio test: additionally distinctive.
    """
    count = MatchCount()
    error = error or PoseError()
    for before, now in zip(frames, frames[stride:], strict=False):
        if not len(before.observations) or not len(now.observations):
            continue
        distances = squared_descriptor_distances(
            now.observations.descriptors, before.observations.descriptors
        )
        gated = np.where(_inside_gate(before, now, rng, error), distances, np.inf)
        for rule in RULES:
            table = distances if rule == 'descriptor' else gated
            rows, columns, values = _matches(table, rule)
            apart = np.linalg.norm(now.points[rows] - before.points[columns], axis=1)
            for e0 in thresholds:
                count.add(rule, e0, apart[values <= e0] <= TOLERANCE)
    return count


def _inside_gate(
    before: TumFrame, now: TumFrame, rng: np.random.Generator, error: PoseError
) -> NDArray[np.bool_]:
    """Return (N, M): is landmark m of the first frame in the gate of observation n of the second.

    The pose of the second frame has a random error, whose covariance enters the gate.
    """
    noise = rng.standard_normal(3) * (error.position, error.position, error.heading)
    pose = now.pose.compose(Pose2.from_array(noise))
    here, there = _placed(now, pose), _placed(before, before.pose)
    dx, dy = here.points[:, 0] - pose.x, here.points[:, 1] - pose.y
    turn = np.stack([-dy, dx, np.zeros_like(dx)], axis=1) * error.heading
    spread = here.covariances + turn[:, :, None] * turn[:, None, :]
    spread[:, [0, 1], [0, 1]] += error.position**2
    total = spread[:, None] + there.covariances[None]
    apart = here.points[:, None] - there.points[None]
    solved = np.linalg.solve(total, apart[..., None])[..., 0]
    inside: NDArray[np.bool_] = (apart * solved).sum(axis=2) <= CHI_SQUARE_999
    return inside


@dataclass(frozen=True)
class _Placed:
    points: Array
    covariances: Array


def _placed(frame: TumFrame, pose: Pose2) -> _Placed:
    turn = planar_rotation(pose.theta)
    points = frame.observations.positions @ turn.T + (pose.x, pose.y, 0.0)
    return _Placed(points, turn @ frame.observations.covariances @ turn.T)


def _matches(
    table: NDArray[np.floating], rule: str
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.floating]]:
    """Return rows, columns and distances of the matches of a rule in distances (N, M)."""
    rows = np.arange(len(table))
    columns = table.argmin(axis=1)
    values = table[rows, columns]
    keep = np.isfinite(values)
    if rule in ('mutual', 'ratio test'):
        keep &= table.argmin(axis=0)[columns] == rows
    if rule == 'ratio test':
        others = table.copy()
        others[rows, columns] = np.inf
        keep &= values <= RATIO_SQUARED * others.min(axis=1)
    return rows[keep], columns[keep], values[keep]


def distance_shares(
    descriptors: NDArray[np.float32], limits: Sequence[float], block: int = 1000
) -> dict[float, float]:
    """Return, for each limit, the percentage of distances between descriptors that lie below."""
    count = np.zeros(len(limits), np.int64)
    total = len(descriptors) * (len(descriptors) - 1)
    for first in range(0, len(descriptors), block):
        part = descriptors[first : first + block]
        distances = squared_descriptor_distances(part, descriptors)
        distances[np.arange(len(part)), first + np.arange(len(part))] = np.inf
        count += [int(np.count_nonzero(distances < limit)) for limit in limits]
    return {limit: 100.0 * n / total for limit, n in zip(limits, count.tolist(), strict=True)}
