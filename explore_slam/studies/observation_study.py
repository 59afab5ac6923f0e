"""Frames without odometry: how many landmark observations they give, and how true these are.

Observations of frames that follow each other are matched by their descriptors. Where the true
poses of the vehicle are recorded, matches must agree in the map within their own covariances: that
tests features, depth, mounting and noise model at once.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from explore_slam.agent.config import AgentConfig
from explore_slam.data import LandmarkObservations, RgbdFrame
from explore_slam.errors import RecordingError
from explore_slam.geometry import Array, wrap_angles
from explore_slam.messages import seconds
from explore_slam.messages.topics import TopicKind, topic_name
from explore_slam.recording.replay import Replay
from explore_slam.results.run_data import Panel, RunData, Series, VehicleRun
from explore_slam.results.trajectory import Trajectory
from explore_slam.vision import FeatureExtractor

# 99 % of a chi-square of three degrees of freedom; motion capture and stamps are true to this
GATE, TRUTH_SIGMA = 11.345, 0.01


class TruePoses:
    """True poses in space over time: positions (T, 3) m, unit quaternions (T, 4) x y z w."""

    def __init__(self, stamps: Array, positions: Array, quaternions: Array) -> None:
        self._stamps = stamps
        self._positions = positions
        signs = np.sign(np.sum(quaternions[1:] * quaternions[:-1], axis=1))
        turned = np.concatenate([[1.0], np.cumprod(np.where(signs < 0.0, -1.0, 1.0))])
        self._quaternions = quaternions * turned[:, None]

    def at(self, stamp: float, max_gap: float = 0.1) -> tuple[Array, Array] | None:
        """Return rotation (3, 3) and position (3,) at a stamp; None where the truth is silent."""
        right = int(np.searchsorted(self._stamps, stamp))
        if not 0 < right < len(self._stamps):
            return None
        span = self._stamps[right] - self._stamps[right - 1]
        if span > max_gap:
            return None
        share = (stamp - self._stamps[right - 1]) / span
        mix = (1.0 - share) * self._quaternions[right - 1] + share * self._quaternions[right]
        position = (1.0 - share) * self._positions[right - 1] + share * self._positions[right]
        return rotation_of(mix), position

    def planar(self) -> Trajectory:
        """Return the poses as seen from above."""
        x, y, z, w = self._quaternions.T
        yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        return Trajectory.of(
            self._stamps, np.column_stack([self._positions[:, :2], wrap_angles(yaw)])
        )


def rotation_of(quaternion: Array) -> Array:
    """Return the rotation (3, 3) of a quaternion (x, y, z, w) of any length but 0."""
    x, y, z, w = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def match(
    first: LandmarkObservations, second: LandmarkObservations, distance: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return indices (P,), (P,) of mutual best matches within a squared descriptor distance."""
    if not len(first) or not len(second):
        return np.empty(0, np.intp), np.empty(0, np.intp)
    squared = 2.0 - 2.0 * first.descriptors @ second.descriptors.T
    best, back = squared.argmin(axis=1), squared.argmin(axis=0)
    rows = np.arange(len(first))
    good = (back[best] == rows) & (squared[rows, best] <= distance)
    return rows[good], best[good]


def disagreement(
    first: LandmarkObservations,
    second: LandmarkObservations,
    poses: tuple[tuple[Array, Array], tuple[Array, Array]],
) -> tuple[Array, Array]:
    """Return distances (P,) m and squared Mahalanobis distances (P,) of matches in the map."""
    (turn_a, at_a), (turn_b, at_b) = poses
    apart = (first.positions @ turn_a.T + at_a) - (second.positions @ turn_b.T + at_b)
    covariance = (
        turn_a @ first.covariances @ turn_a.T
        + turn_b @ second.covariances @ turn_b.T
        + 2.0 * TRUTH_SIGMA**2 * np.eye(3)
    )
    solved = np.linalg.solve(covariance, apart[..., None])[..., 0]
    return np.linalg.norm(apart, axis=1), np.sum(apart * solved, axis=1)


def observe_recording(replay: Replay, config: AgentConfig, until: float | None = None) -> RunData:
    """Extract observations from every frame of the recording; return counts and agreement."""
    extractor = FeatureExtractor(config.vision)
    seen: dict[str, list[LandmarkObservations]] = {vehicle: [] for vehicle in replay.vehicles}
    begin: float | None = None
    for event in replay.events():
        begin = event.stamp if begin is None else begin
        if until is not None and event.stamp > begin + until:
            break
        if isinstance(event.record, RgbdFrame):
            seen[event.vehicle].append(extractor.extract(event.record))
    if not any(seen.values()):
        raise RecordingError(
            f'{replay.bag.path} holds no frame with colour, depth and camera_info'
        )
    truths = {vehicle: true_poses(replay, vehicle) for vehicle in replay.vehicles}
    gate = config.slam.association.maximum_descriptor_distance
    metrics: dict[str, Any] = {
        vehicle: study(observations, truths[vehicle], gate)
        for vehicle, observations in seen.items()
        if observations
    }
    runs = tuple(
        VehicleRun(vehicle, truth=truth.planar())
        for vehicle, truth in truths.items()
        if truth is not None
    )
    return RunData(
        f'Landmark observations in {replay.bag.path.name}',
        runs,
        {'vehicles': {run.name: run.metrics() for run in runs}, 'observations': metrics},
        landmarks=placed(seen, truths),
        settings=config,
        notes=(*replay.warnings, *([PLACED] if runs else [])),
        panels=tuple(_panel(vehicle, found) for vehicle, found in seen.items() if found),
    )


PLACED = 'landmarks are drawn where the true poses put them: there is no estimate in this run'


@dataclass(frozen=True)
class PlacedLandmarks:
    """Observations in the map: means (N, 3), covariances (N, 3, 3), counts (N,), all one."""

    means: Array
    covariances: Array
    counts: NDArray[np.int64]


def placed(
    seen: dict[str, list[LandmarkObservations]], truths: dict[str, TruePoses | None]
) -> PlacedLandmarks | None:
    """Return all observations moved to the map by the true poses; None without any."""
    means, covariances = [], []
    for vehicle, observations in seen.items():
        truth = truths[vehicle]
        for item in observations:
            pose = truth.at(item.stamp) if truth is not None else None
            if pose is not None:
                turn, at = pose
                means.append(item.positions @ turn.T + at)
                covariances.append(turn @ item.covariances @ turn.T)
    if not means:
        return None
    points = np.concatenate(means)
    return PlacedLandmarks(
        points, np.concatenate(covariances), np.ones(len(points), dtype=np.int64)
    )


def _panel(vehicle: str, observations: list[LandmarkObservations]) -> Panel:
    return Panel(
        f'Landmarks seen by {vehicle}',
        'Landmark observations extracted from each frame.',
        'observations',
        Series.of([(item.stamp, float(len(item))) for item in observations]),
    )


def true_poses(replay: Replay, vehicle: str) -> TruePoses | None:
    """Read the ground truth of a vehicle in space; None without it."""
    rows = []
    for raw in replay.bag.messages([topic_name(vehicle, TopicKind.GROUND_TRUTH)]):
        message = replay.bag.decode(raw)
        pose = message.pose.pose
        p, q = pose.position, pose.orientation
        rows.append([seconds(message.header.stamp), p.x, p.y, p.z, q.x, q.y, q.z, q.w])
    if len(rows) < 2:
        return None
    table = np.array(rows)
    table = table[np.argsort(table[:, 0], kind='stable')]
    table = table[np.concatenate([[True], np.diff(table[:, 0]) > 0.0])]
    return TruePoses(table[:, 0], table[:, 1:4], table[:, 4:])


def study(
    observations: list[LandmarkObservations], truth: TruePoses | None, gate: float
) -> dict[str, Any]:
    """Return counts per frame, matches of frames that follow each other, and their agreement."""
    counts = np.array([len(item) for item in observations])
    found: dict[str, Any] = {
        'frames': len(observations),
        'observations_mean': float(counts.mean()),
        'observations_least': int(counts.min()),
        'frames_without_observations': int(np.count_nonzero(counts == 0)),
    }
    matched, apart, squared = [], [], []
    for first, second in pairwise(observations):
        rows, partners = match(first, second, gate)
        matched.append(len(rows))
        pose_a = truth.at(first.stamp) if truth is not None else None
        pose_b = truth.at(second.stamp) if truth is not None else None
        if len(rows) and pose_a is not None and pose_b is not None:
            distances, mahalanobis = disagreement(
                _pick(first, rows), _pick(second, partners), (pose_a, pose_b)
            )
            apart.append(distances)
            squared.append(mahalanobis)
    if matched:
        found['matches_mean'] = float(np.mean(matched))
    if apart:
        distances, mahalanobis = np.concatenate(apart), np.concatenate(squared)
        found['matches_with_truth'] = len(distances)
        found['matches_that_agree'] = float(np.mean(mahalanobis <= GATE))
        found['distance_median'] = float(np.median(distances))
    return found


def _pick(item: LandmarkObservations, rows: NDArray[np.intp]) -> LandmarkObservations:
    return LandmarkObservations(
        item.stamp, item.positions[rows], item.covariances[rows], item.descriptors[rows]
    )
