"""Closures: relative poses measured by laser between keyframes far apart along the path."""

import math
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from explore_slam.geometry import Array, Pose2, compose, planar_rotation, wrap_angle
from explore_slam.registration import Alignment, LocalMap
from explore_slam.slam.closures.anchors import Anchor, Query
from explore_slam.slam.closures.config import ClosureConfig

# m, m, rad: relative pose errors within the scans of a query and a region where no covariance is
# given: the drift of the front end over half their length (Intel, against the optimized path;
# benchmarks/laser_graph_slam.py).
_INTERNAL_DEVIATIONS = (0.02, 0.02, 0.003)
_PROFILE: Array = np.linspace(-2.0, 2.0, 81)  # m along the weakest direction
# m from the best score within which the width of the profile is that of the likelihood of a single
# return, and the alignment is more accurate
_PEAK_HALF = 0.1
_TEMPERATURE = 0.02  # of the scores: smaller differences are not significant
_MINIMUM_INFORMATION = 1e-2  # 1/m², 1/rad²: a deviation of 10 m


class ClosureEnds(NamedTuple):
    """The vehicles at both ends of a closure, and the distances (m) that they had driven."""

    vehicle_a: int
    distance_a: float
    vehicle_b: int
    distance_b: float

    @classmethod
    def of(cls, a: Anchor, b: Anchor) -> Self:
        """Return the ends of a closure between two anchors."""
        return cls(a.vehicle, a.distance_driven, b.vehicle, b.distance_driven)


@dataclass(frozen=True, eq=False)
class Closure:
    """The pose of keyframe b in the frame of keyframe a, as measured with their scans.

    information (3, 3): of its components, in the axes of a. score: mean likelihood of the
    returns; overlap: fraction of the returns on surfaces of a's region; rms (m) of their
    distances.
    """

    keyframe_a: int
    keyframe_b: int
    pose: Pose2
    information: Array
    score: float
    overlap: float
    rms: float

    def query_pose(self, poses: Array) -> Array:
        """Return the pose (3,) of b that the closure predicts, given the pose of a."""
        predicted: Array = compose(poses[self.keyframe_a], np.asarray(self.pose))
        return predicted

    def row(self) -> Array:
        """Return all values as one row (17,)."""
        information = self.information.ravel()
        keyframes = (self.keyframe_a, self.keyframe_b)
        return np.array([*keyframes, *self.pose, *information, self.score, self.overlap, self.rms])

    @classmethod
    def from_row(cls, row: Array) -> Self:
        """Make a closure of the values that `row` returned."""
        pose = Pose2(float(row[2]), float(row[3]), float(row[4]))
        information = row[5:14].reshape(3, 3).copy()
        score, overlap, rms = row[14:17].tolist()
        return cls(int(row[0]), int(row[1]), pose, information, score, overlap, rms)


def acceptable(found: Alignment | None, config: ClosureConfig) -> bool:
    """Return whether overlap and residual of an alignment are within the configured limits."""
    return (
        found is not None
        and found.overlap >= config.closure_overlap
        and found.rms <= config.closure_rms
    )


def closure_information(
    local_map: LocalMap, query: Query, found: Alignment, internal_covariance: Array | None = None
) -> Array:
    """Return the information (3, 3) of the query's pose in the frame of the map.

    The covariance has three parts: that of the returns; internal_covariance (3, 3): relative pose
    errors within the scans of the query and map, in the axes of the map; and, along the weakest
    direction, that of the profile of the score, which shows how far the query can slide.
    """
    information = found.information + _MINIMUM_INFORMATION * np.eye(3)
    turn = planar_rotation(found.pose.theta)
    weakest, _ = found.weakest_direction()
    u = turn[:2, :2] @ weakest
    scores = local_map.score_profile(
        query.points, found.pose, (float(u[0]), float(u[1])), _PROFILE
    )
    weights = np.exp((scores - scores.max()) / _TEMPERATURE)
    weights /= weights.sum()
    off = np.abs(_PROFILE - _PROFILE[np.argmax(scores)])
    slide = weights @ np.maximum(off - _PEAK_HALF, 0.0) ** 2
    covariance = turn @ np.linalg.inv(information) @ turn.T
    covariance += (
        np.diag(_INTERNAL_DEVIATIONS) ** 2 if internal_covariance is None else internal_covariance
    )
    covariance[:2, :2] += slide * np.outer(u, u)
    result: Array = np.linalg.inv(covariance)
    return result


def poses_differ(a: Array, b: Array, distance: float, turn: float) -> bool:
    """Return whether two poses (3,) differ by more than a distance (m) or a turn (rad)."""
    far = math.hypot(a[0] - b[0], a[1] - b[1]) > distance
    return far or abs(wrap_angle(float(a[2] - b[2]))) > turn
