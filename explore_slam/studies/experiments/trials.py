"""One run of an estimator on one scenario: errors, landmark updates, effective sample size."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import LandmarkObservations
from explore_slam.geometry import Array, Pose2, wrap_angles
from explore_slam.slam import FastSlamConfig, TeamBelief
from explore_slam.studies.experiments.scenarios import Scenario
from explore_slam.studies.isam2 import Isam2


@dataclass(frozen=True)
class Outcome:
    """Result of an update: landmarks updated, landmarks in the map, effective sample size."""

    updated: int
    landmarks: int
    effective: float = float('nan')


class Estimator(Protocol):
    """Interface of filters and smoothers in a trial."""

    def predict(self, vehicle: str, increment: Pose2, covariance: Array) -> None:
        """Propagate by an odometry increment with covariance (3, 3)."""

    def update(
        self, vehicle: str, observations: LandmarkObservations, identities: NDArray[np.int64]
    ) -> Outcome:
        """Update with observations; identities (K,) are true, for smoothers only."""

    def pose(self, vehicle: str) -> Pose2:
        """Return the current pose estimate of a vehicle."""


class FilterEstimator:
    """The filter of this package, with common or dedicated maps."""

    def __init__(self, start_poses: dict[str, Pose2], config: FastSlamConfig, seed: int) -> None:
        self.belief = TeamBelief(start_poses, config, seed)
        # In the paper the pose estimate is that of the best particle (section III).
        self._best = config.engine == 'paper'
        self._landmarks = 0

    def predict(self, vehicle: str, increment: Pose2, covariance: Array) -> None:
        """See Estimator."""
        self.belief.predict(vehicle, increment, covariance)

    def update(
        self, vehicle: str, observations: LandmarkObservations, identities: NDArray[np.int64]
    ) -> Outcome:
        """See Estimator; identities are not used."""
        del identities
        summary = self.belief.update(vehicle, observations)
        self._landmarks += summary.inserted - summary.removed
        return Outcome(summary.associated, self._landmarks, summary.effective_particles)

    def pose(self, vehicle: str) -> Pose2:
        """Return the pose of the best particle (engine paper) or the mean."""
        if self._best:
            return self.belief.best_pose(vehicle)
        return self.belief.estimate(vehicle)[0]

    def estimate(self, vehicle: str) -> tuple[Pose2, Array]:
        """Return mean and covariance (3, 3) of a pose."""
        return self.belief.estimate(vehicle)


class SmootherEstimator:
    """iSAM2 with one graph for all vehicles (common) or one for each (dedicated)."""

    def __init__(self, start_poses: dict[str, Pose2], maps: str) -> None:
        if maps == 'common':
            joint = Isam2(start_poses)
            self._of = dict.fromkeys(start_poses, joint)
        else:
            self._of = {name: Isam2({name: pose}) for name, pose in start_poses.items()}
        self._seen: dict[int, set[int]] = {id(graph): set() for graph in self._of.values()}

    def predict(self, vehicle: str, increment: Pose2, covariance: Array) -> None:
        """See Estimator."""
        self._of[vehicle].predict(vehicle, increment, covariance)

    def update(
        self, vehicle: str, observations: LandmarkObservations, identities: NDArray[np.int64]
    ) -> Outcome:
        """See Estimator."""
        graph = self._of[vehicle]
        graph.update(vehicle, observations, identities.tolist())
        seen = self._seen[id(graph)]
        again = len(seen.intersection(identities.tolist()))
        seen.update(identities.tolist())
        return Outcome(again, sum(map(len, self._seen.values())))

    def pose(self, vehicle: str) -> Pose2:
        """See Estimator."""
        return self._of[vehicle].estimate(vehicle)[0]

    def estimate(self, vehicle: str) -> tuple[Pose2, Array]:
        """Return the newest pose and its covariance (3, 3)."""
        return self._of[vehicle].estimate(vehicle)


@dataclass
class VehicleTrial:
    """One vehicle in one run: errors (x, y, heading) of the online estimate by step, counts."""

    errors: list[tuple[float, float, float]] = field(default_factory=list)
    estimates: int = 0
    updates: int = 0

    @property
    def table(self) -> Array:
        """Errors (T, 3) m, m, rad."""
        return np.array(self.errors).reshape(-1, 3)


@dataclass
class Trial:
    """One run: results by vehicle; after each update sample size, landmarks, time (s)."""

    vehicles: dict[str, VehicleTrial]
    effective: list[float] = field(default_factory=list)
    landmarks: list[int] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    @property
    def position_rms(self) -> float:
        """RMS position error (m) over all vehicles and steps."""
        return rms(np.concatenate([np.hypot(*v.table[:, :2].T) for v in self.vehicles.values()]))

    @property
    def heading_rms(self) -> float:
        """RMS heading error (rad) over all vehicles and steps."""
        return rms(np.concatenate([v.table[:, 2] for v in self.vehicles.values()]))

    @property
    def updates(self) -> int:
        """Number of landmark updates of all vehicles."""
        return sum(v.updates for v in self.vehicles.values())

    @property
    def estimates(self) -> int:
        """Number of steps of all vehicles with at least one landmark update."""
        return sum(v.estimates for v in self.vehicles.values())


def rms(values: Array | Sequence[float]) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def run_trial(scenario: Scenario, estimator: Estimator) -> Trial:
    """Run an estimator on a scenario and compare its online estimate with truth at each step."""
    trial = Trial({name: VehicleTrial() for name in scenario.start_poses})
    for step in scenario.steps:
        began = time.perf_counter()
        estimator.predict(step.vehicle, step.increment, step.covariance)
        seen = step.observations
        # A frame without features is no update.
        outcome = estimator.update(step.vehicle, seen, step.identities) if len(seen) else None
        pose = estimator.pose(step.vehicle)
        seconds = time.perf_counter() - began
        true = step.true_pose
        mine = trial.vehicles[step.vehicle]
        turn = float(wrap_angles(pose.theta - true.theta))
        mine.errors.append((pose.x - true.x, pose.y - true.y, turn))
        if outcome is None:
            before = trial.landmarks[-1] if trial.landmarks else 0
            outcome = Outcome(0, before)
        mine.updates += outcome.updated
        mine.estimates += outcome.updated > 0
        trial.seconds.append(seconds)
        trial.effective.append(outcome.effective)
        trial.landmarks.append(outcome.landmarks)
    return trial
