"""Where two frames lie relative to each other, according to tags that are known in both.

Tags have an identity, so that there is nothing to search; but one may have been read wrong, moved
or put up twice. Those count that agree: distances between them are the same in both frames, but
for drift, and one rigid motion brings all of them into place.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from explore_slam.geometry import Array, Pose2, compose, wrap_angle

# What correct pairs may differ by, beside their deviations: drift between them in either frame.
# The same as for closures by laser (slam.closures.agreement).
_POSITION = (0.15, 0.03)  # m, m per m
_HEADING = 0.1  # rad
_GATE = 3.0  # standard deviations
# rad: a heading with a larger deviation is left out of tests; it hardly helps the fit
_USEFUL_HEADING = 0.3
_MINIMUM_BASELINE = 1.0  # m between tags whose positions show a heading
_ITERATIONS = 10  # of Gauss-Newton, which converges in 3 or 4


class TagPlace(NamedTuple):
    """Pose (3,) of a tag in a frame, with standard deviations of position (m) and heading (rad).

    The heading is unknown where its deviation is large.
    """

    pose: Array
    position_deviation: float
    heading_deviation: float


class TagPair(NamedTuple):
    """One tag in two frames: here, and there."""

    tag: int
    here: TagPlace
    there: TagPlace

    @property
    def position_deviation(self) -> float:
        """Standard deviation (m) of the difference of the positions."""
        return math.hypot(self.here.position_deviation, self.there.position_deviation)

    @property
    def heading_deviation(self) -> float:
        """Standard deviation (rad) of the difference of the headings."""
        return math.hypot(self.here.heading_deviation, self.there.heading_deviation)


class FrameFit(NamedTuple):
    """Pose of the frame here in the frame there, and the pairs that agree with it.

    heading_deviation (rad): of that pose. contradicting: number of pairs that do not agree.
    """

    frame: Pose2
    pairs: tuple[TagPair, ...]
    heading_deviation: float
    contradicting: int


def fit_frame(pairs: Sequence[TagPair]) -> FrameFit | None:
    """Return the frame that most pairs agree with; None if no pair determines one."""
    best: tuple[tuple[int, float], Pose2, list[TagPair]] | None = None
    for hypothesis in _hypotheses(pairs):
        group = [pair for pair in pairs if _agrees(pair, hypothesis, pairs)]
        if not group:
            continue
        frame = _refined(hypothesis, group)
        cost = sum(_off(pair, frame)[0] for pair in group)
        rank = (len(group), -cost)
        if best is None or rank > best[0]:
            best = rank, frame, group
    if best is None:
        return None
    _, frame, group = best
    return FrameFit(frame, tuple(group), _heading_deviation(frame, group), len(pairs) - len(group))


def _hypotheses(pairs: Sequence[TagPair]) -> list[Pose2]:
    """Return the frames that single tags with a heading, and tags in twos, determine."""
    found = []
    for n, one in enumerate(pairs):
        if one.heading_deviation < _USEFUL_HEADING:
            there, here = (Pose2.from_array(p.pose) for p in (one.there, one.here))
            found.append(there.compose(here.inverse()))
        for other in pairs[:n]:
            step_here = other.here.pose[:2] - one.here.pose[:2]
            step_there = other.there.pose[:2] - one.there.pose[:2]
            length, wanted = math.hypot(*step_here), math.hypot(*step_there)
            spread = math.hypot(one.position_deviation, other.position_deviation)
            tolerance = _POSITION[0] + _POSITION[1] * wanted + _GATE * spread
            if min(length, wanted) < _MINIMUM_BASELINE or abs(length - wanted) > tolerance:
                continue
            turn = math.atan2(step_there[1], step_there[0])
            turn = wrap_angle(turn - math.atan2(step_here[1], step_here[0]))
            middle = 0.5 * (one.here.pose[:2] + other.here.pose[:2])
            goal = 0.5 * (one.there.pose[:2] + other.there.pose[:2])
            c, s = math.cos(turn), math.sin(turn)
            found.append(
                Pose2(
                    float(goal[0] - c * middle[0] + s * middle[1]),
                    float(goal[1] - s * middle[0] - c * middle[1]),
                    turn,
                )
            )
    return found


def _off(pair: TagPair, frame: Pose2) -> tuple[float, float]:
    """Return by how much (m, rad) a frame misses a pair."""
    at = compose(np.asarray(frame), pair.here.pose)
    turn = abs(wrap_angle(float(at[2] - pair.there.pose[2])))
    return math.dist(at[:2], pair.there.pose[:2]), turn


def _agrees(pair: TagPair, frame: Pose2, pairs: Sequence[TagPair]) -> bool:
    """Return whether a frame that some pairs determine brings a pair into place.

    Drift grows with the distance from the nearest other pair.
    """
    distance, turn = _off(pair, frame)
    others = [math.dist(pair.there.pose[:2], other.there.pose[:2]) for other in pairs]
    reach = max(others, default=0.0)
    limit = _POSITION[0] + _POSITION[1] * reach + _GATE * pair.position_deviation
    if distance > limit:
        return False
    spread = pair.heading_deviation
    return spread >= _USEFUL_HEADING or turn <= _HEADING + _GATE * spread


def _normal_equations(frame: Pose2, pairs: Sequence[TagPair]) -> tuple[Array, Array]:
    """Return information (3, 3) and gradient (3,) of a frame given pairs (least squares)."""
    H, g = np.zeros((3, 3)), np.zeros(3)
    c, s = math.cos(frame.theta), math.sin(frame.theta)
    for pair in pairs:
        x, y = pair.here.pose[:2].tolist()
        at = compose(np.asarray(frame), pair.here.pose)
        J = np.array([[1.0, 0.0, -s * x - c * y], [0.0, 1.0, c * x - s * y], [0.0, 0.0, 1.0]])
        e = at - pair.there.pose
        e[2] = wrap_angle(float(e[2]))
        heading = pair.heading_deviation
        deviations = [max(pair.position_deviation, 1e-3)] * 2 + [max(heading, 1e-3)]
        weights = np.array(deviations) ** -2.0
        if heading >= _USEFUL_HEADING:
            weights[2] = 0.0
        H += J.T @ (weights[:, None] * J)
        g += J.T @ (weights * e)
    return H, g


def _refined(frame: Pose2, pairs: Sequence[TagPair]) -> Pose2:
    """Return the frame that fits pairs best, from one nearby."""
    for _ in range(_ITERATIONS):
        H, g = _normal_equations(frame, pairs)
        step = np.linalg.lstsq(H, -g, rcond=None)[0]
        x, y, theta = (np.asarray(frame) + step).tolist()
        frame = Pose2(x, y, wrap_angle(theta))
    return frame


def _heading_deviation(frame: Pose2, pairs: Sequence[TagPair]) -> float:
    """Return the standard deviation (rad) of the heading of a frame given pairs."""
    H, _ = _normal_equations(frame, pairs)
    if np.linalg.matrix_rank(H) < len(H):
        return math.inf
    return math.sqrt(float(np.linalg.inv(H)[2, 2]))
