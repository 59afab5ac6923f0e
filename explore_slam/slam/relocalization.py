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

from explore_slam.compiled import kernel
from explore_slam.geometry import IDENTITY, Array, Pose2
from explore_slam.slam.config import RelocalizationConfig

_TRIALS = 300
_MOST_MATCHES = 400
_DRIFT_PER_METRE = 0.05
_BASE_REACH = 1.0
_REACH_PER_METRE = 0.3


@kernel
def _votes(
    frame: Array, points: Array, marks: Array, spreads: Array, owners: NDArray[np.int64]
) -> int:  # pragma: no cover - compiled
    """Return how many observations lie on a landmark that they are like.

    frame (3,): the odometry frame in the map; owners (n,) ascending number of the observation.
    """
    c, s = math.cos(frame[2]), math.sin(frame[2])
    votes, last = 0, -1
    for n in range(len(points)):
        x = frame[0] + c * points[n, 0] - s * points[n, 1] - marks[n, 0]
        y = frame[1] + s * points[n, 0] + c * points[n, 1] - marks[n, 1]
        if owners[n] != last and math.hypot(x, y) < 3.0 * spreads[n]:
            votes += 1
            last = owners[n]
    return votes


@kernel
def _vote(
    pairs: NDArray[np.int64],
    points: Array,
    marks: Array,
    spreads: Array,
    owners: NDArray[np.int64],
    ids: NDArray[np.int64],
    odometry: Array,
    present: Array,
    reach: float,
) -> tuple[int, Array]:  # pragma: no cover - compiled
    """Return the most votes, and the odometry frame (3,) in the map that has them.

    Each of pairs (T, 2) puts two points on two landmarks; frames that take the vehicle, at
    odometry (3,) in its frame, farther than reach (m) from present (2,) are passed over.
    """
    most, best, frame = 0, np.zeros(3), np.zeros(3)
    for t in range(len(pairs)):
        a, b = pairs[t]
        px, py = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
        mx, my = marks[b, 0] - marks[a, 0], marks[b, 1] - marks[a, 1]
        length, wanted = math.hypot(px, py), math.hypot(mx, my)
        tolerance = 3.0 * math.hypot(spreads[a], spreads[b])
        near = min(length, wanted) < max(0.3, tolerance)
        if ids[a] == ids[b] or near or abs(length - wanted) > tolerance:
            continue
        frame[2] = math.atan2(my, mx) - math.atan2(py, px)
        c, s = math.cos(frame[2]), math.sin(frame[2])
        x, y = 0.5 * (points[a] + points[b])
        frame[0] = 0.5 * (marks[a, 0] + marks[b, 0]) - c * x + s * y
        frame[1] = 0.5 * (marks[a, 1] + marks[b, 1]) - s * x - c * y
        x = frame[0] + c * odometry[0] - s * odometry[1] - present[0]
        y = frame[1] + s * odometry[0] + c * odometry[1] - present[1]
        if math.hypot(x, y) > reach:
            continue
        votes = _votes(frame, points, marks, spreads, owners)
        if votes > most:
            most = votes
            best[:] = frame
    return most, best


def warm_up() -> None:
    """Compile the search, which otherwise happens when the first vehicle is lost."""
    two, ids = np.eye(2), np.arange(2)
    _vote(ids[None], two, two, np.ones(2), ids, ids, np.zeros(3), np.zeros(2), 1.0)


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

    def __init__(self, config: RelocalizationConfig) -> None:
        self.config = config
        self.odometry = IDENTITY
        self.way = 0.0
        self.updates: deque[Matches] = deque(maxlen=config.relocalization_window)
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
        return count >= self.config.relocalization_matches and agreed < 0.35 * count

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
        if len(points) < self.config.relocalization_matches:
            return None
        odometry = np.asarray(self.odometry, np.float64)
        frame = np.asarray(present.compose(self.odometry.inverse()), np.float64)
        votes_present = _votes(frame, points, marks, spreads, owners)
        pairs = random.integers(0, len(points), (_TRIALS, 2))
        goal = np.array([present.x, present.y])
        votes, best = _vote(
            pairs, points, marks, spreads, owners, ids, odometry, goal, self.reach
        )  # fmt: skip
        matches = int(owners.max()) + 1
        if votes < max(self.config.relocalization_matches, 0.5 * matches, 1.5 * votes_present):
            return None
        return self._refined(Pose2.from_array(best), points, marks, spreads, ids, votes)

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

    def _placed(self, turn: float, center: Array, goal: Array) -> Pose2:
        """Return the vehicle pose if the odometry frame is turned, and center moved to goal."""
        c, s = math.cos(turn), math.sin(turn)
        frame = Pose2(
            goal[0] - c * center[0] + s * center[1], goal[1] - s * center[0] - c * center[1], turn
        )
        return frame.compose(self.odometry)

    def _refined(
        self,
        frame: Pose2,
        points: Array,
        marks: Array,
        spreads: Array,
        ids: NDArray[np.int64],
        votes: int,
    ) -> Relocation | None:
        """Fit the odometry frame to its inliers; None if they are fewer than three landmarks."""
        c, s = math.cos(frame.theta), math.sin(frame.theta)
        x = frame.x + c * points[:, 0] - s * points[:, 1] - marks[:, 0]
        y = frame.y + s * points[:, 0] + c * points[:, 1] - marks[:, 1]
        inside = np.hypot(x, y) < 3.0 * spreads
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
