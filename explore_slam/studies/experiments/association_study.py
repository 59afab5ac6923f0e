"""How often a match of descriptors is right, on real frames against true poses; tables IV and V.

A match is right when the two observed points lie within TOLERANCE of each other after the true
poses have put them into the world.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array, Pose2
from explore_slam.studies.experiments.tum_frames import TumFrame

TOLERANCE = 0.10
GATE = 16.27  # chi² of 3 degrees of freedom that 99.9 % of right matches stay below
DISTINCT = 0.8**2  # Lowe's ratio, on squared distances
RULES = ('descriptor', 'gated', 'one to one', 'distinct')


@dataclass
class MatchCount:
    """Matches made and right ones, per rule and E0."""

    right: dict[tuple[str, float], int] = field(default_factory=dict)
    total: dict[tuple[str, float], int] = field(default_factory=dict)

    def add(self, rule: str, e0: float, right: NDArray[np.bool_]) -> None:
        """Count the matches of one pair of frames; right (N,) tells which are right."""
        key = (rule, e0)
        self.right[key] = self.right.get(key, 0) + int(right.sum())
        self.total[key] = self.total.get(key, 0) + len(right)

    def precision(self, rule: str, e0: float) -> float:
        """Return the share of right matches; NaN without any match."""
        total = self.total.get((rule, e0), 0)
        return self.right[rule, e0] / total if total else float('nan')


@dataclass(frozen=True)
class PoseError:
    """How well the pose of the second frame is known: standard deviations, m and rad.

    The defaults are a step of table I with σ = 0.5: 2.5 % of 1 m, 3π/180 · σ.
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
    """Match each frame with the one stride before it, at each threshold E0, by four rules.

    descriptor: the nearest descriptor of all; gated: the nearest of those where the erring pose
    lets expect them; one to one: and no observation is nearer to it; distinct: and no other
    candidate is nearly as near.
    """
    count = MatchCount()
    error = error or PoseError()
    for before, now in zip(frames, frames[stride:], strict=False):
        if not len(before.observations) or not len(now.observations):
            continue
        distances = descriptor_distances(
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


def descriptor_distances(a: NDArray[np.float32], b: NDArray[np.float32]) -> Array:
    """Return the squared distances (N, M) of unit descriptors (N, 128) and (M, 128)."""
    distances: Array = np.maximum(2.0 - 2.0 * (a @ b.T), 0.0)
    return distances


def _inside_gate(
    before: TumFrame, now: TumFrame, rng: np.random.Generator, error: PoseError
) -> NDArray[np.bool_]:
    """Tell (N, M) which landmarks of the first frame agree with observations of the second.

    The pose of the second frame is off by a drawn error, whose covariance opens the gate.
    """
    off = rng.standard_normal(3) * (error.position, error.position, error.heading)
    pose = now.pose.compose(Pose2.from_array(off))
    here, there = _placed(now, pose), _placed(before, before.pose)
    dx, dy = here.points[:, 0] - pose.x, here.points[:, 1] - pose.y
    turn = np.stack([-dy, dx, np.zeros_like(dx)], axis=1) * error.heading
    spread = here.covariances + turn[:, :, None] * turn[:, None, :]
    spread[:, [0, 1], [0, 1]] += error.position**2
    total = spread[:, None] + there.covariances[None]
    apart = here.points[:, None] - there.points[None]
    solved = np.linalg.solve(total, apart[..., None])[..., 0]
    inside: NDArray[np.bool_] = (apart * solved).sum(axis=2) <= GATE
    return inside


@dataclass(frozen=True)
class _Placed:
    points: Array
    covariances: Array


def _placed(frame: TumFrame, pose: Pose2) -> _Placed:
    c, s = np.cos(pose.theta), np.sin(pose.theta)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    points = frame.observations.positions @ turn.T + (pose.x, pose.y, 0.0)
    return _Placed(points, turn @ frame.observations.covariances @ turn.T)


def _matches(table: Array, rule: str) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Return rows, columns and distances of the matches that a rule makes of a table (N, M)."""
    rows = np.arange(len(table))
    columns = table.argmin(axis=1)
    values = table[rows, columns]
    keep = np.isfinite(values)
    if rule in ('one to one', 'distinct'):
        keep &= table.argmin(axis=0)[columns] == rows
    if rule == 'distinct':
        others = table.copy()
        others[rows, columns] = np.inf
        keep &= values <= DISTINCT * others.min(axis=1)
    return rows[keep], columns[keep], values[keep]


def distance_shares(
    descriptors: NDArray[np.float32], limits: Sequence[float], block: int = 1000
) -> dict[float, float]:
    """Return per limit the per cent of all distances between different descriptors below it."""
    count = np.zeros(len(limits), np.int64)
    total = len(descriptors) * (len(descriptors) - 1)
    for first in range(0, len(descriptors), block):
        part = descriptors[first : first + block]
        distances = descriptor_distances(part, descriptors)
        distances[np.arange(len(part)), first + np.arange(len(part))] = np.inf
        count += [int(np.count_nonzero(distances < limit)) for limit in limits]
    return {limit: 100.0 * n / total for limit, n in zip(limits, count.tolist(), strict=True)}
