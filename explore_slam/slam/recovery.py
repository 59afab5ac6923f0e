"""The way back for a vehicle that all particles misplace.

What a vehicle matched lately is kept in its odometry frame. When most of these matches disagree
with its pose in all particles, the pose is searched that most of them agree on: two matches of
different landmarks make a pose, the others vote (RANSAC). Only poses that the vehicle can have
reached since it last agreed are considered, so that a repeated texture elsewhere does not
carry it away.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import IDENTITY, Array, Pose2
from explore_slam.slam.config import RecoveryConfig

_TRIALS = 300
_MOST_MATCHES = 400
_DRIFT_PER_METRE = 0.05
_BASE_REACH = 1.0
_REACH_PER_METRE = 0.3


@dataclass(frozen=True)
class Matches:
    """Matched observations of one update.

    points (n, 2) in the odometry frame; deviations (n,) m; alike (n, A) ids of the landmarks
    that each is like, or -1; agreed (n,); way: driven until then (m).
    """

    points: Array
    deviations: Array
    alike: NDArray[np.int64]
    agreed: NDArray[np.bool_]
    way: float


@dataclass(frozen=True)
class Relocation:
    """Where a vehicle is, by its matches: pose in the map, deviations of position and heading."""

    pose: Pose2
    position_deviation: float
    heading_deviation: float
    inliers: int


class Recovery:
    """Matches of one vehicle over its last updates."""

    def __init__(self, config: RecoveryConfig) -> None:
        self.config = config
        self.odometry = IDENTITY
        self.way = 0.0
        self.updates: deque[Matches] = deque(maxlen=config.recovery_window)
        self.way_driven = 0.0

    def move(self, increment: Pose2) -> None:
        """Follow the motion told."""
        self.odometry = self.odometry.compose(increment)
        length = math.hypot(increment.x, increment.y)
        self.way += length
        self.way_driven += length

    @property
    def reach(self) -> float:
        """How far (m) the vehicle may be from where the particles have it."""
        return _BASE_REACH + _REACH_PER_METRE * self.way

    def forget(self) -> None:
        """Drop all matches: the vehicle has been placed anew."""
        self.updates.clear()
        self.way = 0.0

    def note(
        self, z: Array, deviations: Array, alike: NDArray[np.int64], agreed: NDArray[np.bool_]
    ) -> None:
        """Take in the observations z (K, 3) of one update that are like landmarks nearby."""
        matched = (alike >= 0).any(axis=1)
        if not matched.any():
            return
        c, s = math.cos(self.odometry.theta), math.sin(self.odometry.theta)
        x = self.odometry.x + c * z[matched, 0] - s * z[matched, 1]
        y = self.odometry.y + s * z[matched, 0] + c * z[matched, 1]
        points = np.stack([x, y], axis=1)
        self.updates.append(
            Matches(points, deviations[matched], alike[matched], agreed[matched], self.way_driven)
        )
        if np.count_nonzero(agreed[matched]) >= 0.5 * len(points):
            self.way = 0.0

    @property
    def lost(self) -> bool:
        """Tell whether most of the matches disagree."""
        count = sum(len(update.points) for update in self.updates)
        agreed = sum(int(np.count_nonzero(update.agreed)) for update in self.updates)
        return count >= self.config.recovery_matches and agreed < 0.35 * count

    def matched_ids(self) -> NDArray[np.int64]:
        """Return the landmark ids that matches are like."""
        ids = np.unique(np.concatenate([update.alike.ravel() for update in self.updates]))
        return ids[ids >= 0]

    def search(
        self, positions: dict[int, Array], present: Pose2, random: np.random.Generator
    ) -> Relocation | None:
        """Return where most matches agree that the vehicle is, or None.

        positions: landmark id -> (3,) x, y and deviation in the best particle; present: the
        pose of the vehicle there.
        """
        points, marks, spreads, owners, ids = self._pairs(positions)
        if len(points) < self.config.recovery_matches:
            return None
        votes_present = self._votes(present, points, marks, spreads, owners)
        best, best_votes = None, 0
        for _ in range(_TRIALS):
            a, b = random.integers(0, len(points), 2)
            pose = self._pose_of_two(points[[a, b]], marks[[a, b]], spreads[[a, b]])
            if ids[a] == ids[b] or pose is None:
                continue
            if math.hypot(pose.x - present.x, pose.y - present.y) > self.reach:
                continue
            votes = self._votes(pose, points, marks, spreads, owners)
            if votes > best_votes:
                best, best_votes = pose, votes
        matches = int(owners.max()) + 1
        enough = max(self.config.recovery_matches, 0.5 * matches, 1.5 * votes_present)
        if best is None or best_votes < enough:
            return None
        return self._refined(best, points, marks, spreads, ids, best_votes)

    def _pairs(
        self, positions: dict[int, Array]
    ) -> tuple[Array, Array, Array, NDArray[np.int64], NDArray[np.int64]]:
        points, marks, spreads, owners, ids = [], [], [], [], []
        owner = 0
        for update in reversed(self.updates):
            drift = _DRIFT_PER_METRE * (self.way_driven - update.way)
            for n, alike in enumerate(update.alike.tolist()):
                known = [i for i in alike if i in positions]
                for i in known:
                    points.append(update.points[n])
                    marks.append(positions[i][:2])
                    spreads.append(math.hypot(update.deviations[n], positions[i][2], drift, 0.03))
                    owners.append(owner)
                    ids.append(i)
                owner += bool(known)
            if len(points) > _MOST_MATCHES:
                break
        return (
            np.array(points).reshape(-1, 2),
            np.array(marks).reshape(-1, 2),
            np.array(spreads),
            np.array(owners, np.int64),
            np.array(ids, np.int64),
        )

    def _pose_of_two(self, points: Array, marks: Array, spreads: Array) -> Pose2 | None:
        """Return the vehicle pose that puts two points of the odometry frame on two landmarks."""
        span, goal = points[1] - points[0], marks[1] - marks[0]
        length, wanted = math.hypot(*span), math.hypot(*goal)
        tolerance = 3.0 * math.hypot(*spreads)
        if min(length, wanted) < max(0.3, tolerance) or abs(length - wanted) > tolerance:
            return None
        turn = math.atan2(goal[1], goal[0]) - math.atan2(span[1], span[0])
        return self._placed(turn, points.mean(axis=0), marks.mean(axis=0))

    def _placed(self, turn: float, center: Array, goal: Array) -> Pose2:
        """Return the vehicle pose if the odometry frame is turned, and center moved to goal."""
        c, s = math.cos(turn), math.sin(turn)
        frame = Pose2(
            goal[0] - c * center[0] + s * center[1], goal[1] - s * center[0] - c * center[1], turn
        )
        return frame.compose(self.odometry)

    def _residuals(self, pose: Pose2, points: Array, marks: Array) -> Array:
        frame = pose.compose(self.odometry.inverse())
        c, s = math.cos(frame.theta), math.sin(frame.theta)
        x = frame.x + c * points[:, 0] - s * points[:, 1] - marks[:, 0]
        y = frame.y + s * points[:, 0] + c * points[:, 1] - marks[:, 1]
        lengths: Array = np.hypot(x, y)
        return lengths

    def _votes(
        self, pose: Pose2, points: Array, marks: Array, spreads: Array, owners: NDArray[np.int64]
    ) -> int:
        """Return how many observations lie on a landmark that they are like."""
        inside = self._residuals(pose, points, marks) < 3.0 * spreads
        return len(np.unique(owners[inside]))

    def _refined(
        self,
        pose: Pose2,
        points: Array,
        marks: Array,
        spreads: Array,
        ids: NDArray[np.int64],
        votes: int,
    ) -> Relocation | None:
        """Fit the pose to its inliers; None if fewer than three landmarks are among them."""
        inside = self._residuals(pose, points, marks) < 3.0 * spreads
        if len(np.unique(ids[inside])) < 3:
            return None
        weights = 1.0 / spreads[inside] ** 2
        weights /= weights.sum()
        center, goal = weights @ points[inside], weights @ marks[inside]
        p, m = points[inside] - center, marks[inside] - goal
        dot = weights @ (p[:, 0] * m[:, 0] + p[:, 1] * m[:, 1])
        cross = weights @ (p[:, 0] * m[:, 1] - p[:, 1] * m[:, 0])
        fitted = self._placed(math.atan2(cross, dot), center, goal)
        spread = float(np.sqrt(np.mean(spreads[inside] ** 2)))
        extent = math.sqrt(float(weights @ (p**2).sum(axis=1)))
        return Relocation(fitted, spread, min(spread / max(extent, 0.1), 0.3), votes)
