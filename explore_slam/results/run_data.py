"""Data of a run, live or offline: how they are recorded, and the metrics computed from them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import OdometryReading
from explore_slam.errors import EvaluationError
from explore_slam.geometry import Array, Pose2
from explore_slam.mapping import OccupancyGrid
from explore_slam.results.consistency import PoseEstimates, consistency_metrics
from explore_slam.results.keyframe_interpolation import (
    calibrated_path,
    extrapolate,
    interpolate,
)
from explore_slam.results.trajectory import (
    Trajectory,
    heading_errors,
    pairs,
    position_errors,
    trajectory_metrics,
)
from explore_slam.settings import Section
from explore_slam.slam import OdometryCalibration


def _empty() -> Trajectory:
    return Trajectory(np.empty(0), np.empty((0, 3)))


class KeyframeLike(Protocol):
    """A keyframe as the agent reports it (agent.KeyframeEvent)."""

    @property
    def vehicle(self) -> str:
        """Name of the vehicle."""

    @property
    def stamp(self) -> float:
        """Time of the keyframe (s)."""

    @property
    def pose(self) -> Pose2:
        """Estimated pose right after the update."""

    @property
    def covariance(self) -> Array:
        """Covariance (3, 3) of the pose, in the map frame."""

    @property
    def update(self) -> Any:
        """Summary of the update, with effective_particles; None where only odometry was used."""


class LandmarkCloud(Protocol):
    """Landmarks with uncertainty, such as `slam` returns of the best particle."""

    @property
    def means(self) -> Array:
        """Positions (N, 3) m in the map frame."""

    @property
    def covariances(self) -> Array:
        """Covariances (N, 3, 3) m²."""

    @property
    def counts(self) -> NDArray[Any]:
        """Number of observations (N,) of each landmark."""


@dataclass(frozen=True)
class VehicleRun:
    """The trajectories of one vehicle in the map frame; those that are not known are empty.

    estimated: most likely path at the end, interpolated by odometry between keyframes;
    online: pose as estimated at each time; odometry: dead reckoning from the start pose; truth:
    as measured from outside the vehicle. estimates: mean and covariance as published.
    """

    name: str
    estimated: Trajectory = field(default_factory=_empty)
    online: Trajectory = field(default_factory=_empty)
    truth: Trajectory = field(default_factory=_empty)
    odometry: Trajectory = field(default_factory=_empty)
    estimates: PoseEstimates = field(default_factory=PoseEstimates.empty)

    def trajectories(self) -> dict[str, Trajectory]:
        """Return the trajectories that are not empty, by kind."""
        kinds = {
            'estimated': self.estimated,
            'online': self.online,
            'true': self.truth,
            'odometry': self.odometry,
        }
        return {kind: trajectory for kind, trajectory in kinds.items() if len(trajectory)}

    def metrics(self) -> dict[str, Any]:
        """Return distance, duration and, with ground truth, the errors of every trajectory.

        Errors of the online trajectory include its consistency (`consistency_metrics`).
        """
        whole = self.truth.duration > 0.9 * max(self.online.duration, self.odometry.duration)
        reference = next(
            (
                path
                for path in (self.truth if whole else _empty(), self.online, self.odometry)
                if len(path) > 1
            ),
            self.truth,
        )
        found: dict[str, Any] = {'distance': reference.length, 'duration': reference.duration}
        if not len(self.truth):
            return found
        for kind, trajectory in self.trajectories().items():
            if kind == 'true':
                continue
            try:
                found[kind] = trajectory_metrics(trajectory, self.truth)
            except EvaluationError:
                found[kind] = None
        if found.get('online'):
            found['online'] |= consistency_metrics(self.estimates, self.truth)
        return found


@dataclass(frozen=True)
class Series:
    """A time series: values (N,) at stamps (N,) s."""

    stamps: Array
    values: Array

    @classmethod
    def of(cls, samples: list[tuple[float, float]]) -> 'Series':
        """Make a series of (stamp, value) pairs in any order."""
        table = np.array(sorted(samples), dtype=np.float64).reshape(-1, 2)
        return cls(table[:, 0], table[:, 1])

    def __len__(self) -> int:
        return int(self.stamps.size)


@dataclass(frozen=True)
class Panel:
    """An additional line chart of a report; label: of the y axis."""

    title: str
    caption: str
    label: str
    series: Series


@dataclass(frozen=True)
class RunData:
    """Everything that a run folder and its report are made of."""

    title: str
    vehicles: tuple[VehicleRun, ...]
    metrics: dict[str, Any]
    grid: OccupancyGrid | None = None
    landmarks: LandmarkCloud | None = None
    coverage: Series = field(default_factory=lambda: Series.of([]))
    coverage_unit: str = '%'
    effective_particles: Series = field(default_factory=lambda: Series.of([]))
    particles: int = 0
    settings: Section | None = None
    notes: tuple[str, ...] = ()
    panels: tuple[Panel, ...] = ()


class RunRecorder:
    """Records a run while it is in progress: live, in a replay or in a closed loop."""

    def __init__(
        self,
        title: str,
        starts: Mapping[str, Pose2 | None],
        particles: int = 0,
        coverage_unit: str = '%',
    ) -> None:
        self._title = title
        self._coverage_unit = coverage_unit
        self._starts = dict(starts)
        self._particles = particles
        self._online: dict[str, list[tuple[float, Pose2]]] = {}
        self._keyframes: dict[str, list[tuple[float, Pose2]]] = {}
        self._truth: dict[str, list[tuple[float, Pose2]]] = {}
        self._odometry: dict[str, list[tuple[float, Pose2]]] = {}
        self._estimates: dict[str, list[tuple[float, Pose2, Array]]] = {}
        self._coverage: list[tuple[float, float]] = []
        self._effective: list[tuple[float, float]] = []
        self._notes: list[str] = []

    def add_truth(self, vehicle: str, stamp: float, pose: Pose2) -> None:
        """Record a true pose in the map frame."""
        self._truth.setdefault(vehicle, []).append((stamp, pose))

    def add_odometry(self, vehicle: str, reading: OdometryReading) -> None:
        """Record an odometry reading; `finish` aligns its frame with the start pose."""
        self._odometry.setdefault(vehicle, []).append((reading.stamp, reading.pose))

    def add_pose(self, vehicle: str, stamp: float, pose: Pose2) -> None:
        """Record the pose as estimated at this time."""
        self._online.setdefault(vehicle, []).append((stamp, pose))

    def add_estimate(self, vehicle: str, stamp: float, pose: Pose2, covariance: Array) -> None:
        """Record mean and covariance (3, 3) of a pose as published at a keyframe."""
        self._estimates.setdefault(vehicle, []).append((stamp, pose, covariance))

    def add_coverage(self, stamp: float, explored: float) -> None:
        """Record the explored fraction (0 to 1) of the reachable area; with unit 'm²' the area."""
        self._coverage.append((stamp, explored))

    def add_effective_particles(self, stamp: float, count: float) -> None:
        """Record the effective sample size after an update."""
        self._effective.append((stamp, count))

    def add_keyframe(self, event: KeyframeLike) -> None:
        """Record pose, covariance and effective sample size of a keyframe.

        Where add_pose is not called, keyframe poses extrapolated by odometry are the online
        trajectory.
        """
        self._keyframes.setdefault(event.vehicle, []).append((event.stamp, event.pose))
        self.add_estimate(event.vehicle, event.stamp, event.pose, event.covariance)
        if event.update is not None:
            self.add_effective_particles(event.stamp, event.update.effective_particles)

    def add_note(self, text: str) -> None:
        """Record a sentence for the report, such as a warning."""
        self._notes.append(text)

    @property
    def vehicles(self) -> list[str]:
        """Names of all vehicles with any data, sorted."""
        sources = (self._starts, self._online, self._keyframes, self._truth, self._odometry)
        return sorted({name for names in sources for name in names})

    def finish(
        self,
        trajectories: dict[str, tuple[Array, Array]],
        *,
        calibrations: Mapping[str, OdometryCalibration] | None = None,
        grid: OccupancyGrid | None = None,
        landmarks: LandmarkCloud | None = None,
        settings: Section | None = None,
        extra: dict[str, Any] | None = None,
    ) -> RunData:
        """Return the data of the run.

        trajectories: vehicle -> stamps (T,) and keyframe poses (T, 3) on the most likely path.
        calibrations: of the wheel odometry, which leads from keyframe to keyframe.
        extra: further metrics (collisions, duration, counts of dropped records).
        """
        known = calibrations or {}
        runs = tuple(
            self._vehicle_run(name, trajectories.get(name), known.get(name))
            for name in self.vehicles
        )
        metrics = run_metrics(runs)
        if self._coverage:
            metrics['coverage'] = self._coverage[-1][1]
        if self._effective:
            counts = np.array([count for _, count in self._effective])
            metrics['effective_particles_median'] = float(np.median(counts))
        if landmarks is not None:
            metrics['landmarks'] = len(landmarks.means)
        metrics.update(extra or {})
        return RunData(
            self._title,
            runs,
            metrics,
            grid,
            landmarks,
            coverage=Series.of(self._coverage),
            coverage_unit=self._coverage_unit,
            effective_particles=Series.of(self._effective),
            particles=self._particles,
            settings=settings,
            notes=tuple(self._notes),
        )

    def _vehicle_run(
        self,
        name: str,
        estimated: tuple[Array, Array] | None,
        calibration: OdometryCalibration | None,
    ) -> VehicleRun:
        truth, odometry = _trajectory(self._truth.get(name)), _trajectory(self._odometry.get(name))
        online = _trajectory(self._online.get(name))
        if not len(online):
            online = extrapolate(_trajectory(self._keyframes.get(name)), odometry)
        start = self._starts.get(name)
        if start is not None:
            odometry = odometry.from_start(start)
        path = Trajectory.of(*estimated) if estimated is not None else _empty()
        estimates = _pose_estimates(self._estimates.get(name))
        between = odometry if calibration is None else calibrated_path(odometry, calibration)
        return VehicleRun(name, interpolate(path, between), online, truth, odometry, estimates)


def _trajectory(samples: list[tuple[float, Pose2]] | None) -> Trajectory:
    if not samples:
        return _empty()
    return Trajectory.of([stamp for stamp, _ in samples], [pose for _, pose in samples])


def _pose_estimates(samples: list[tuple[float, Pose2, Array]] | None) -> PoseEstimates:
    if not samples:
        return PoseEstimates.empty()
    ordered = sorted(samples, key=lambda sample: sample[0])
    return PoseEstimates(
        np.array([stamp for stamp, _, _ in ordered]),
        np.array([pose for _, pose, _ in ordered]),
        np.array([covariance for _, _, covariance in ordered]),
    )


def run_metrics(runs: tuple[VehicleRun, ...]) -> dict[str, Any]:
    """Return metrics per vehicle, and means over the vehicles that have ground truth."""
    vehicles = {run.name: run.metrics() for run in runs}
    metrics: dict[str, Any] = {}
    for kind in ('estimated', 'online', 'odometry'):
        for name in ('position_rms', 'heading_rms'):
            values = [found[kind][name] for found in vehicles.values() if found.get(kind)]
            if values:
                metrics[f'mean_{kind}_{name}'] = float(np.mean(values))
    metrics['vehicles'] = vehicles
    return metrics


def error_series(estimated: Trajectory, truth: Trajectory) -> tuple[Series, Series]:
    """Return position (m) and heading (rad) errors over time; empty without ground truth."""
    try:
        stamps, poses, true = pairs(estimated, truth)
    except EvaluationError:
        return Series.of([]), Series.of([])
    return (
        Series(stamps, position_errors(poses, true)),
        Series(stamps, np.abs(heading_errors(poses, true))),
    )
