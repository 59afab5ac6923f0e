"""Relocalization of a lost vehicle by RANSAC over its recent matches.

The observations of the last updates that are similar to landmarks are kept in the odometry frame
of the vehicle. When most of these matches contradict its pose in nearly all particles, the pose
that most of them agree on is searched: two matches of different landmarks make a hypothesis, all
others vote (RANSAC: Fischler and Bolles, 1981), and a rigid transformation is fitted to the
inliers in closed form (Procrustes problem; Umeyama, 1991).

As long as the pose is trusted, only landmarks near it are considered, within what the vehicle can
have drifted since its pose was last confirmed, so that repeated textures elsewhere do not mislead
it. The pose of a vehicle that is lost, whose last updates agreed with nothing, or that has been
given a new pose is not trusted: landmarks are looked up by descriptor in the whole map, until
enough observations of different landmarks agree with its pose. A pose that is found must stand out
from all others.
"""

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.geometry import IDENTITY, Array, Pose2, compose, wrap_angles
from explore_slam.slam.checkpoint import State, part, under
from explore_slam.slam.config import RelocalizationConfig
from explore_slam.slam.storage.row_format import Places

# Hypotheses: with half of the matches right, each is right with probability 1/4, and all 300 fail
# with a probability below 1e-37; with a tenth right, 5 % of searches fail. The other values were
# chosen by hand; `benchmarks/relocalization.py` shows what a change does.
_TRIALS = 300
_MAXIMUM_MATCHES = 400  # newest matches considered, which bounds the time of a search
# standard deviation of odometry (m/m; rad/rad), generous for wheeled robots
_DRIFT_PER_METRE = 0.05
_DRIFT_PER_RADIAN = 0.05
# Similar landmarks are noted within 1 m and 0.3 m per metre driven since the pose was last
# confirmed: after a collision or slipping wheels, but not in another room.
_BASE_REACH = 1.0
_REACH_PER_METRE = 0.3
_GATE = 3.0  # deviations (sigma) within which a match is an inlier
_MINIMUM_DEVIATION = 0.03  # m: of a match, for errors not modelled by either covariance
# m between the landmarks of a hypothesis, so that its heading is determined
_MINIMUM_BASELINE = 0.3
_LANDMARKS_OF_A_POSE = 2  # that determine one
_MINIMUM_LANDMARKS = 3  # different inlier landmarks: two can agree by chance
# A vehicle is lost if less than this fraction of its matches agrees with its pose.
_LOST_FRACTION = 0.35
# Its pose is confirmed by half of an update's matches and of those of the window, but at least
# three of these, of two landmarks: a single agreement can be chance.
_CONFIRMED_FRACTION = 0.5
_CONFIRMING = 3
_CONFIRMING_LANDMARKS = 2
# Updates in succession in which nothing agrees, after which a pose is not trusted any more.
_DISAGREEING_UPDATES = 4
# A pose is accepted if at least half of the matches agree on it, and 1.5 times as many as on the
# current pose or on any rival, a pose that is farther away than this (m, rad).
_ACCEPTED_FRACTION = 0.5
_ACCEPTED_GAIN = 1.5
_RIVAL_DISTANCE = 1.0
_RIVAL_TURN = 0.5
_MINIMUM_EXTENT = 0.1  # m, of the inliers
# rad: landmarks close together or far away that leave the heading more uncertain do not decide
_LARGEST_HEADING_DEVIATION = 0.15


class _Pairs(NamedTuple):
    """Pairs (n,) of an observation and a landmark similar to it, newest first.

    points (n, 2) of the observations in the odometry frame; landmarks (n, 2) in the map;
    deviations (n,) m; owners (n,) ascending number of the observation; ids (n,) of the landmarks.
    """

    points: Array
    landmarks: Array
    deviations: Array
    owners: Places
    ids: Places


@kernel
def _votes(frame: Array, pairs: _Pairs) -> int:  # pragma: no cover - compiled
    """Return the number of inlier observations for a pose (3,) of the odometry frame."""
    points, landmarks, owners = pairs.points, pairs.landmarks, pairs.owners
    c, s = math.cos(frame[2]), math.sin(frame[2])
    votes, last = 0, -1
    for n in range(len(points)):
        x = frame[0] + c * points[n, 0] - s * points[n, 1] - landmarks[n, 0]
        y = frame[1] + s * points[n, 0] + c * points[n, 1] - landmarks[n, 1]
        if owners[n] != last and math.hypot(x, y) < _GATE * pairs.deviations[n]:
            votes += 1
            last = owners[n]
    return votes


@kernel
def _evaluate_hypotheses(
    samples: Places, pairs: _Pairs
) -> tuple[Places, Array]:  # pragma: no cover - compiled
    """Return the votes (T,) for poses (T, 3) of the odometry frame in the map.

    Each of samples (T, 2) places two points on two landmarks; without votes if these do not fit.
    """
    points, landmarks = pairs.points, pairs.landmarks
    deviations, ids = pairs.deviations, pairs.ids
    votes, frames = np.zeros(len(samples), np.int64), np.zeros((len(samples), 3))
    for t in range(len(samples)):
        frame = frames[t]
        a, b = samples[t]
        px, py = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
        mx, my = landmarks[b, 0] - landmarks[a, 0], landmarks[b, 1] - landmarks[a, 1]
        length, wanted = math.hypot(px, py), math.hypot(mx, my)
        tolerance = _GATE * math.hypot(deviations[a], deviations[b])
        near = min(length, wanted) < max(_MINIMUM_BASELINE, tolerance)
        if ids[a] == ids[b] or near or abs(length - wanted) > tolerance:
            continue
        frame[2] = math.atan2(my, mx) - math.atan2(py, px)
        c, s = math.cos(frame[2]), math.sin(frame[2])
        x, y = 0.5 * (points[a] + points[b])
        frame[0] = 0.5 * (landmarks[a, 0] + landmarks[b, 0]) - c * x + s * y
        frame[1] = 0.5 * (landmarks[a, 1] + landmarks[b, 1]) - s * x - c * y
        votes[t] = _votes(frame, pairs)
    return votes, frames


def warm_up() -> None:
    """Compile the search, which otherwise happens when the first vehicle is lost."""
    two, ids = np.eye(2), np.arange(2)
    pairs = _Pairs(two, two, np.ones(2), ids, ids)
    _evaluate_hypotheses(ids[None], pairs)
    _votes(np.zeros(3), pairs)


@dataclass(frozen=True)
class Matches:
    """Observations of one update that are similar to landmarks.

    points (n, 2) in the odometry frame; deviations (n,) m; similar_ids (n, A) of the landmarks, or
    -1; agreed (n,): associated in most of the particles; distance and turn: driven (m) and turned
    (rad) until then.
    """

    points: Array
    deviations: Array
    similar_ids: Places
    agreed: NDArray[np.bool_]
    distance: float
    turn: float

    def state_dict(self) -> State:
        """Return the arrays."""
        return vars(self) | {
            'distance': np.array(self.distance),
            'turn': np.array(self.turn),
        }

    @classmethod
    def from_state(cls, state: State) -> 'Matches':
        """Return matches as saved."""
        return cls(**(state | {name: float(state[name]) for name in ('distance', 'turn')}))


@dataclass(frozen=True)
class RelocalizedPose:
    """Pose of a vehicle in the map according to its matches, with deviations (m, rad).

    ids (n,): landmarks of the observations that agree with it.
    """

    pose: Pose2
    position_deviation: float
    heading_deviation: float
    ids: Places

    def deviations(self) -> Array:
        """Return the standard deviations (3,) of x, y (m) and heading (rad)."""
        return np.array([self.position_deviation] * 2 + [self.heading_deviation])

    def moved(self, ids: Places, positions: Array, new_ids: Places, new: Array) -> Self:
        """Return the same pose relative to its landmarks after these have moved.

        ids (L,) and positions (L, 3) m of landmarks before; new_ids (N,) and new (N, 3) after. The
        landmarks move as a rigid body (least squares); with fewer than two of them in both, the
        pose remains.
        """
        common, at, new_at = np.intersect1d(ids, new_ids, return_indices=True)
        mine = np.isin(common, self.ids)
        if np.count_nonzero(mine) < _LANDMARKS_OF_A_POSE:
            return self
        old, moved = positions[at[mine], :2], new[new_at[mine], :2]
        centre, goal = old.mean(axis=0), moved.mean(axis=0)
        p, m = old - centre, moved - goal
        turn = math.atan2((p[:, 0] * m[:, 1] - p[:, 1] * m[:, 0]).sum(), (p * m).sum())
        motion = Pose2(goal[0], goal[1], turn).compose(Pose2(-centre[0], -centre[1], 0.0))
        return replace(self, pose=motion.compose(self.pose))


class Relocalizer:
    """Keeps the recent matches of one vehicle and searches for its pose."""

    def __init__(self, config: RelocalizationConfig) -> None:
        self.config = config
        self.odometry = IDENTITY
        self.distance = 0.0
        self.turn = 0.0
        self.distance_since_confirmed = 0.0
        self.is_trusted = True
        self.is_placed = False  # given a pose that no landmark has confirmed since
        self._disagreeing = 0
        self.updates: deque[Matches] = deque(maxlen=config.relocalization_window)

    def predict(self, increment: Pose2) -> None:
        """Propagate the vehicle by an odometry increment."""
        self.odometry = self.odometry.compose(increment)
        length = math.hypot(increment.x, increment.y)
        self.distance_since_confirmed += length
        self.distance += length
        self.turn += abs(increment.theta)

    @property
    def reach(self) -> float:
        """How far (m) the vehicle may be from its pose in the particles."""
        if not self.is_trusted:
            return math.inf
        return _BASE_REACH + _REACH_PER_METRE * self.distance_since_confirmed

    def reset(self, *, placed: bool = True) -> None:
        """Discard all matches: the vehicle was given a new pose, which is not confirmed yet.

        placed: the pose is unrelated to its path so far, unlike that of a closed loop.
        """
        self.updates.clear()
        self.distance_since_confirmed = 0.0
        self.is_trusted = False
        self.is_placed = placed
        self._disagreeing = 0

    def add(
        self, z: Array, deviations: Array, similar_ids: Places, agreed: NDArray[np.bool_]
    ) -> None:
        """Add the observations z (K, 3) of one update; see Matches for the others."""
        matched = (similar_ids >= 0).any(axis=1)
        self._disagreeing = 0 if agreed.any() else self._disagreeing + 1
        if self._disagreeing >= _DISAGREEING_UPDATES:
            self.is_trusted = False
        if not matched.any():
            return
        c, s = math.cos(self.odometry.theta), math.sin(self.odometry.theta)
        x = self.odometry.x + c * z[matched, 0] - s * z[matched, 1]
        y = self.odometry.y + s * z[matched, 0] + c * z[matched, 1]
        self.updates.append(
            Matches(
                np.stack([x, y], axis=1),
                deviations[matched],
                similar_ids[matched],
                agreed[matched],
                self.distance,
                self.turn,
            )
        )
        if self.is_lost:
            self.is_trusted = False
        elif self._is_confirmed():
            self.distance_since_confirmed = 0.0
            self.is_trusted = True
            self.is_placed = False

    def _is_confirmed(self) -> bool:
        """Return whether the newest update and most of the window agree with the pose."""
        newest = self.updates[-1].agreed
        if np.count_nonzero(newest) < max(1.0, _CONFIRMED_FRACTION * len(newest)):
            return False
        agreed = np.concatenate([update.agreed for update in self.updates])
        if np.count_nonzero(agreed) < max(_CONFIRMING, _CONFIRMED_FRACTION * len(agreed)):
            return False
        nearest = np.concatenate([update.similar_ids[:, 0] for update in self.updates])
        return len(np.unique(nearest[agreed])) >= _CONFIRMING_LANDMARKS

    @property
    def is_lost(self) -> bool:
        """Whether most of the recent matches contradict the pose."""
        count = sum(len(update.points) for update in self.updates)
        agreed = sum(int(np.count_nonzero(update.agreed)) for update in self.updates)
        return count >= self.config.relocalization_matches and agreed < _LOST_FRACTION * count

    def similar_ids(self) -> Places:
        """Return the ids of all landmarks that recent observations are similar to."""
        ids = np.unique(np.concatenate([update.similar_ids.ravel() for update in self.updates]))
        return ids[ids >= 0]

    def search(
        self, positions: dict[int, Array], current: Pose2, random: np.random.Generator
    ) -> RelocalizedPose | None:
        """Return the pose that most matches agree on; None if there is no such pose.

        positions: landmark id -> (3,) x, y and deviation (m) in the best particle; current: pose
        of the vehicle there.
        """
        pairs = self._pairs(positions)
        least = self.config.relocalization_matches
        if len(pairs.points) < least:
            return None
        frame = np.asarray(current.compose(self.odometry.inverse()), np.float64)
        current_votes = _votes(frame, pairs)
        samples = random.integers(0, len(pairs.points), (_TRIALS, 2))
        votes, frames = _evaluate_hypotheses(samples, pairs)
        best = int(np.argmax(votes))
        observations = int(pairs.owners.max()) + 1
        rivals = max(current_votes, self._most_votes_elsewhere(votes, frames, frames[best]))
        if votes[best] < max(least, _ACCEPTED_FRACTION * observations, _ACCEPTED_GAIN * rivals):
            return None
        return self._refine(Pose2.from_array(frames[best]), pairs)

    def _most_votes_elsewhere(self, votes: Places, frames: Array, best: Array) -> int:
        """Return the most votes of a frame that places the vehicle elsewhere than the best one.

        votes (T,) for frames (T, 3); best (3,).
        """
        poses = compose(frames, np.asarray(self.odometry, np.float64))
        chosen = compose(best, np.asarray(self.odometry, np.float64))
        off = np.hypot(poses[:, 0] - chosen[0], poses[:, 1] - chosen[1])
        turned = np.abs(wrap_angles(poses[:, 2] - chosen[2]))
        elsewhere = (off > _RIVAL_DISTANCE) | (turned > _RIVAL_TURN)
        return int(votes[elsewhere].max(initial=0))

    def _pairs(self, positions: dict[int, Array]) -> _Pairs:
        points, landmarks, deviations, owners, ids = [], [], [], [], []
        owner = 0
        for update in reversed(self.updates):
            driven = _DRIFT_PER_METRE * (self.distance - update.distance)
            turned = _DRIFT_PER_RADIAN * (self.turn - update.turn)
            away = np.hypot(*(update.points - [self.odometry.x, self.odometry.y]).T)
            drifts = np.hypot(driven, turned * away).tolist()
            for n, similar in enumerate(update.similar_ids.tolist()):
                known = [i for i in similar if i in positions]
                for i in known:
                    points.append(update.points[n])
                    landmarks.append(positions[i][:2])
                    deviations.append(
                        math.hypot(
                            update.deviations[n], positions[i][2], drifts[n], _MINIMUM_DEVIATION
                        )
                    )
                    owners.append(owner)
                    ids.append(i)
                owner += bool(known)
            if len(points) > _MAXIMUM_MATCHES:
                break
        return _Pairs(
            np.array(points).reshape(-1, 2),
            np.array(landmarks).reshape(-1, 2),
            np.array(deviations),
            np.array(owners, np.int64),
            np.array(ids, np.int64),
        )

    def _refine(self, frame: Pose2, pairs: _Pairs) -> RelocalizedPose | None:
        """Fit the pose of the odometry frame to the inliers; None if they do not determine it."""
        points, landmarks, deviations = pairs.points, pairs.landmarks, pairs.deviations
        c, s = math.cos(frame.theta), math.sin(frame.theta)
        x = frame.x + c * points[:, 0] - s * points[:, 1] - landmarks[:, 0]
        y = frame.y + s * points[:, 0] + c * points[:, 1] - landmarks[:, 1]
        inside = np.hypot(x, y) < _GATE * deviations
        ids = np.unique(pairs.ids[inside])
        if len(ids) < _MINIMUM_LANDMARKS:
            return None
        weights = 1.0 / deviations[inside] ** 2
        weights /= weights.sum()
        centre, goal = weights @ points[inside], weights @ landmarks[inside]
        p, m = points[inside] - centre, landmarks[inside] - goal
        dot = weights @ (p[:, 0] * m[:, 0] + p[:, 1] * m[:, 1])
        cross = weights @ (p[:, 0] * m[:, 1] - p[:, 1] * m[:, 0])
        fitted = self._pose_of_vehicle(math.atan2(cross, dot), centre, goal)
        deviation = float(np.sqrt(np.mean(deviations[inside] ** 2)))
        extent = math.sqrt(float(weights @ (p**2).sum(axis=1)))
        heading = deviation / max(extent, _MINIMUM_EXTENT)
        if heading > _LARGEST_HEADING_DEVIATION:
            return None
        away = math.hypot(fitted.x - goal[0], fitted.y - goal[1])
        return RelocalizedPose(fitted, math.hypot(deviation, heading * away), heading, ids)

    def _pose_of_vehicle(self, turn: float, centre: Array, goal: Array) -> Pose2:
        """Return the pose if the odometry frame is rotated, and its point centre moved to goal."""
        c, s = math.cos(turn), math.sin(turn)
        frame = Pose2(
            goal[0] - c * centre[0] + s * centre[1], goal[1] - s * centre[0] - c * centre[1], turn
        )
        return frame.compose(self.odometry)

    def state_dict(self) -> State:
        """Return odometry and recent matches."""
        state: State = {
            'odometry': np.array(self.odometry),
            'driven': np.array([self.distance_since_confirmed, self.distance, self.turn]),
            'trust': np.array([self.is_trusted, self._disagreeing], np.int64),
            'placed': np.array(self.is_placed),
            'updates': np.array(len(self.updates)),
        }
        for number, update in enumerate(self.updates):
            state |= under(str(number), update.state_dict())
        return state

    def restore(self, state: State) -> None:
        """Restore odometry and recent matches."""
        self.odometry = Pose2(*state['odometry'].tolist())
        self.distance_since_confirmed, self.distance, self.turn = state['driven'].tolist()
        trusted, self._disagreeing = state['trust'].tolist()
        self.is_trusted = bool(trusted)
        self.is_placed = bool(state.get('placed', False))
        self.updates.clear()
        for number in range(int(state['updates'])):
            self.updates.append(Matches.from_state(part(str(number), state)))
