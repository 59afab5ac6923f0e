"""What is collected while the agent runs, live or offline, and the metrics computed from it."""

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from explore_slam.data import OdometryReading
from explore_slam.errors import EvaluationError
from explore_slam.results.between_keyframes import carried_on, filled
from explore_slam.results.run_folder import LandmarkMap
from explore_slam.results.trajectory import (
    Trajectory,
    heading_errors,
    pairs,
    position_errors,
    trajectory_metrics,
)
from explore_slam.geometry import Array, Pose2
from explore_slam.settings import Section


def _empty() -> Trajectory:
    return Trajectory(np.empty(0), np.empty((0, 3)))


class KeyframeLike(Protocol):
    """What the agent tells of a keyframe (agent.KeyframeEvent)."""

    @property
    def vehicle(self) -> str:
        """Which vehicle."""

    @property
    def stamp(self) -> float:
        """When (s)."""

    @property
    def pose(self) -> Pose2:
        """Pose right after the update."""

    @property
    def update(self) -> Any:
        """Summary of the update, with effective_particles; None where motion alone was used."""


@dataclass(frozen=True)
class VehicleRun:
    """One vehicle's trajectories in the map frame; absent ones are empty.

    estimated: along the best particle at the end, between keyframes by odometry; online: as
    estimated at each time; odometry: alone, from the start pose; truth: where something outside
    the vehicle measured it.
    """

    name: str
    estimated: Trajectory = field(default_factory=_empty)
    online: Trajectory = field(default_factory=_empty)
    truth: Trajectory = field(default_factory=_empty)
    odometry: Trajectory = field(default_factory=_empty)

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
        """Return distance, duration and, against the truth, the errors of every trajectory."""
        whole = self.truth.duration > 0.9 * max(self.online.duration, self.odometry.duration)
        driven = next(
            (
                path
                for path in (self.truth if whole else _empty(), self.online, self.odometry)
                if len(path) > 1
            ),
            self.truth,
        )
        found: dict[str, Any] = {'distance': driven.length, 'duration': driven.duration}
        if not len(self.truth):
            return found
        for kind, trajectory in self.trajectories().items():
            if kind == 'true':
                continue
            try:
                found[kind] = trajectory_metrics(trajectory, self.truth)
            except EvaluationError:
                found[kind] = None
        return found


@dataclass(frozen=True)
class Series:
    """Values (N,) over time (N,) s."""

    stamps: Array
    values: Array

    @classmethod
    def of(cls, samples: list[tuple[float, float]]) -> 'Series':
        """Make a series of (stamp, value) pairs, in any order."""
        table = np.array(sorted(samples), dtype=np.float64).reshape(-1, 2)
        return cls(table[:, 0], table[:, 1])

    def __len__(self) -> int:
        return int(self.stamps.size)


@dataclass(frozen=True)
class Panel:
    """One more line chart of a report: title, caption, what is on the y axis, its values."""

    title: str
    caption: str
    label: str
    series: Series


@dataclass(frozen=True)
class RunData:
    """Everything that the run folder and its report are made of."""

    title: str
    vehicles: tuple[VehicleRun, ...]
    metrics: dict[str, Any]
    grid: Any = None
    landmarks: LandmarkMap | None = None
    coverage: Series = field(default_factory=lambda: Series.of([]))
    coverage_unit: str = '%'
    effective_particles: Series = field(default_factory=lambda: Series.of([]))
    particles: int = 0
    settings: Section | None = None
    notes: tuple[str, ...] = ()
    panels: tuple[Panel, ...] = ()


class RunRecorder:
    """Collects a run as it goes; live demo, replay and experiments fill it alike."""

    def __init__(
        self,
        title: str,
        starts: dict[str, Pose2],
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
        self._coverage: list[tuple[float, float]] = []
        self._effective: list[tuple[float, float]] = []
        self._notes: list[str] = []

    def add_truth(self, vehicle: str, stamp: float, pose: Pose2) -> None:
        """Keep a true pose in the map frame."""
        self._truth.setdefault(vehicle, []).append((stamp, pose))

    def add_odometry(self, vehicle: str, reading: OdometryReading) -> None:
        """Keep an odometry reading; its frame is moved to the start pose in the end."""
        self._odometry.setdefault(vehicle, []).append((reading.stamp, reading.pose))

    def add_pose(self, vehicle: str, stamp: float, pose: Pose2) -> None:
        """Keep the pose as estimated at this time."""
        self._online.setdefault(vehicle, []).append((stamp, pose))

    def add_coverage(self, stamp: float, share: float) -> None:
        """Keep the explored share of the reachable area (0 to 1), or with unit 'm²' the area."""
        self._coverage.append((stamp, share))

    def add_effective_particles(self, stamp: float, count: float) -> None:
        """Keep the effective number of particles after an update."""
        self._effective.append((stamp, count))

    def add_keyframe(self, event: KeyframeLike) -> None:
        """Keep pose and effective particles of a keyframe event of the agent.

        Without poses from add_pose, these carried on by odometry are the online trajectory.
        """
        self._keyframes.setdefault(event.vehicle, []).append((event.stamp, event.pose))
        if event.update is not None:
            self.add_effective_particles(event.stamp, event.update.effective_particles)

    def add_note(self, text: str) -> None:
        """Keep a sentence for the report: a warning, what was left out."""
        self._notes.append(text)

    @property
    def vehicles(self) -> list[str]:
        """Names of all vehicles that anything is known of, sorted."""
        heard = (self._starts, self._online, self._keyframes, self._truth, self._odometry)
        return sorted({name for names in heard for name in names})

    def finish(
        self,
        trajectories: dict[str, tuple[Array, Array]],
        *,
        grid: Any = None,
        landmarks: LandmarkMap | None = None,
        settings: Section | None = None,
        extra: dict[str, Any] | None = None,
    ) -> RunData:
        """Return the data of the run; trajectories: vehicle -> stamps, poses of the best lineage.

        `extra` goes into the metrics as it is (collisions, duration, counts of what was dropped).
        """
        runs = tuple(self._vehicle_run(name, trajectories.get(name)) for name in self.vehicles)
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

    def _vehicle_run(self, name: str, estimated: tuple[Array, Array] | None) -> VehicleRun:
        truth, odometry = _trajectory(self._truth.get(name)), _trajectory(self._odometry.get(name))
        online = _trajectory(self._online.get(name))
        if not len(online):
            online = carried_on(_trajectory(self._keyframes.get(name)), odometry)
        if name in self._starts:
            odometry = odometry.from_start(self._starts[name])
        path = Trajectory.of(*estimated) if estimated is not None else _empty()
        return VehicleRun(name, filled(path, odometry), online, truth, odometry)


def _trajectory(samples: list[tuple[float, Pose2]] | None) -> Trajectory:
    if not samples:
        return _empty()
    return Trajectory.of([stamp for stamp, _ in samples], [pose for _, pose in samples])


def run_metrics(runs: tuple[VehicleRun, ...]) -> dict[str, Any]:
    """Return metrics per vehicle and their means over the vehicles that have a truth."""
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
    """Return position (m) and heading (rad) errors over time; empty without a truth."""
    try:
        stamps, poses, true = pairs(estimated, truth)
    except EvaluationError:
        return Series.of([]), Series.of([])
    return (
        Series(stamps, position_errors(poses, true)),
        Series(stamps, np.abs(heading_errors(poses, true))),
    )
