"""Landmark observations of frames without odometry: how many, and whether they agree with truth.

Observations of consecutive frames are matched by their descriptors. Where the true poses of the
vehicle are recorded, matched observations must coincide in the map within their covariances. That
tests features, depth, camera mount and noise model at once.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from explore_slam.agent.config import AgentConfig
from explore_slam.data import LandmarkObservations, RgbdFrame
from explore_slam.errors import RecordingError
from explore_slam.geometry import Array
from explore_slam.messages import seconds
from explore_slam.messages.topics import TopicKind
from explore_slam.recording.replay import Replay
from explore_slam.results.run_data import Panel, RunData, Series, VehicleRun
from explore_slam.results.spatial_trajectory import SpatialTrajectory
from explore_slam.vision import FeatureExtractor

# 99 % quantile of the chi-square distribution with three degrees of freedom.
CHI_SQUARE_99 = 11.345
# Standard deviation (m) of motion capture, its synchronisation with the camera included.
TRUTH_SIGMA = 0.01
PLACED_NOTE = 'landmarks are placed by the true poses: without odometry this run has no estimate'


@dataclass(frozen=True)
class PlacedLandmarks:
    """Single observations in the map: means (N, 3), covariances (N, 3, 3), counts (N,) of 1."""

    means: Array
    covariances: Array
    counts: NDArray[np.int64]


def evaluate_frames(replay: Replay, config: AgentConfig, until: float | None = None) -> RunData:
    """Extract landmark observations from every frame of a recording; return their statistics.

    until: time (s) after the first event at which to stop.
    """
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
        reasons = '; '.join(['', *replay.unusable()])
        raise RecordingError(
            f'{replay.bag.path} holds no frame with color, depth and camera_info{reasons}'
        )
    truths = {vehicle: true_trajectory(replay, vehicle) for vehicle in replay.vehicles}
    gate = config.slam.association.maximum_descriptor_distance
    metrics: dict[str, Any] = {
        vehicle: observation_metrics(observations, truths[vehicle], gate)
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
        {
            'vehicles': {run.name: run.metrics() for run in runs},
            'observations': metrics,
            'unusable': replay.unusable(),
        },
        landmarks=place_observations(seen, truths),
        settings=config,
        notes=(*replay.warnings, *([PLACED_NOTE] if runs else [])),
        panels=tuple(_count_panel(vehicle, found) for vehicle, found in seen.items() if found),
    )


def true_trajectory(replay: Replay, vehicle: str) -> SpatialTrajectory | None:
    """Read the ground truth of a vehicle from a recording; None where there is none."""
    rows = []
    topic = replay.topic_of(vehicle, TopicKind.GROUND_TRUTH)
    for raw in replay.bag.messages([topic]) if topic else ():
        message = replay.bag.decode(raw)
        pose = message.pose.pose
        p, q = pose.position, pose.orientation
        rows.append([seconds(message.header.stamp), p.x, p.y, p.z, q.x, q.y, q.z, q.w])
    if len({row[0] for row in rows}) < 2:
        return None
    table = np.array(rows)
    return SpatialTrajectory(table[:, 0], table[:, 1:4], table[:, 4:])


def observation_metrics(
    observations: list[LandmarkObservations], truth: SpatialTrajectory | None, gate: float
) -> dict[str, Any]:
    """Return counts per frame, matches of consecutive frames, and how well these agree.

    gate: largest squared descriptor distance of a match.
    """
    counts = np.array([len(item) for item in observations])
    found: dict[str, Any] = {
        'frames': len(observations),
        'observations_mean': float(counts.mean()),
        'observations_least': int(counts.min()),
        'frames_without_observations': int(np.count_nonzero(counts == 0)),
    }
    matched, distances, mahalanobis = [], [], []
    for first, second in pairwise(observations):
        rows, partners = mutual_matches(first, second, gate)
        matched.append(len(rows))
        pose_a = truth.at(first.stamp) if truth is not None else None
        pose_b = truth.at(second.stamp) if truth is not None else None
        if len(rows) and pose_a is not None and pose_b is not None:
            apart, squared = match_errors(
                _select(first, rows), _select(second, partners), (pose_a, pose_b)
            )
            distances.append(apart)
            mahalanobis.append(squared)
    if matched:
        found['matches_mean'] = float(np.mean(matched))
    if distances:
        apart, squared = np.concatenate(distances), np.concatenate(mahalanobis)
        found['matches_with_truth'] = len(apart)
        found['matches_that_agree'] = float(np.mean(squared <= CHI_SQUARE_99))
        found['distance_median'] = float(np.median(apart))
    return found


def squared_descriptor_distances(
    first: NDArray[np.float32], second: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the squared distances (N, M) of unit descriptors (N, D) and (M, D)."""
    distances: NDArray[np.float32] = np.maximum(2.0 - 2.0 * (first @ second.T), 0.0)
    return distances


def mutual_matches(
    first: LandmarkObservations, second: LandmarkObservations, gate: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return indices (P,), (P,) of mutual nearest neighbours within a squared distance."""
    if not len(first) or not len(second):
        return np.empty(0, np.intp), np.empty(0, np.intp)
    squared = squared_descriptor_distances(first.descriptors, second.descriptors)
    best, back = squared.argmin(axis=1), squared.argmin(axis=0)
    rows = np.arange(len(first))
    good = (back[best] == rows) & (squared[rows, best] <= gate)
    return rows[good], best[good]


def match_errors(
    first: LandmarkObservations,
    second: LandmarkObservations,
    poses: tuple[tuple[Array, Array], tuple[Array, Array]],
) -> tuple[Array, Array]:
    """Return distances (P,) m and squared Mahalanobis distances (P,) of matches in the map.

    poses: true rotation (3, 3) and position (3,) of the vehicle at each of the two stamps.
    """
    (rotation_a, position_a), (rotation_b, position_b) = poses
    apart = (first.positions @ rotation_a.T + position_a) - (
        second.positions @ rotation_b.T + position_b
    )
    covariance = (
        rotation_a @ first.covariances @ rotation_a.T
        + rotation_b @ second.covariances @ rotation_b.T
        + 2.0 * TRUTH_SIGMA**2 * np.eye(3)
    )
    solved = np.linalg.solve(covariance, apart[..., None])[..., 0]
    return np.linalg.norm(apart, axis=1), np.sum(apart * solved, axis=1)


def place_observations(
    seen: dict[str, list[LandmarkObservations]],
    truths: dict[str, SpatialTrajectory | None],
) -> PlacedLandmarks | None:
    """Transform all observations to the map by the true poses; None without any."""
    means, covariances = [], []
    for vehicle, observations in seen.items():
        truth = truths[vehicle]
        for item in observations:
            pose = truth.at(item.stamp) if truth is not None else None
            if pose is not None:
                rotation, position = pose
                means.append(item.positions @ rotation.T + position)
                covariances.append(rotation @ item.covariances @ rotation.T)
    if not means:
        return None
    points = np.concatenate(means)
    return PlacedLandmarks(
        points, np.concatenate(covariances), np.ones(len(points), dtype=np.int64)
    )


def _count_panel(vehicle: str, observations: list[LandmarkObservations]) -> Panel:
    return Panel(
        f'Landmark observations of {vehicle}',
        'Landmark observations extracted from each frame.',
        'observations',
        Series.of([(item.stamp, float(len(item))) for item in observations]),
    )


def _select(item: LandmarkObservations, rows: NDArray[np.intp]) -> LandmarkObservations:
    return LandmarkObservations(
        item.stamp, item.positions[rows], item.covariances[rows], item.descriptors[rows]
    )
