"""Reference method: iSAM2 (GTSAM), an incremental smoother, on the data of the filter.

Kaess et al., iSAM2: Incremental smoothing and mapping using the Bayes tree, IJRR 31(2), 2012.
Data association is given: observations come with the identities of their landmarks. GTSAM is an
optional dependency, imported on first use.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import LandmarkObservations
from explore_slam.errors import EvaluationError
from explore_slam.geometry import IDENTITY, Array, Pose2, planar_rotation, rotated, to_world
from explore_slam.slam import compound

_POSE, _LANDMARK = 'x', 'l'
# Change of a variable (m, rad) at which it is linearized again (default of GTSAM: 0.1): far below
# the noise, so that the smoother is as accurate as batch optimization.
RELINEARIZE_THRESHOLD = 0.001
# Keys of different vehicles are this far apart, more than any run has poses.
_KEYS_PER_VEHICLE = 10_000_000


def load_gtsam() -> Any:
    """Return the module gtsam; EvaluationError where it is not installed."""
    try:
        import gtsam
    except ImportError as error:
        raise EvaluationError(
            f'iSAM2 needs the Python package gtsam ({error}): install it with pip, or run '
            'with --without-isam2'
        ) from error
    return gtsam


class Isam2:
    """Planar poses of all vehicles and landmarks in space, smoothed after every update.

    Methods are those of the filter, with the identities (K,) of the observed landmarks.
    """

    def __init__(self, start_poses: Mapping[str, Pose2]) -> None:
        self._gtsam = load_gtsam()
        parameters = self._gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(RELINEARIZE_THRESHOLD)
        parameters.relinearizeSkip = 1
        self._isam = self._gtsam.ISAM2(parameters)
        self._clear_new()
        self._names = list(start_poses)
        self._counts = dict.fromkeys(self._names, 0)
        self._stamps: dict[str, list[float]] = {name: [0.0] for name in self._names}
        self._pending = dict.fromkeys(self._names, (IDENTITY, np.zeros((3, 3))))
        self._known: set[int] = set()
        for name, pose in start_poses.items():
            key = self._pose_key(name, 0)
            noise = self._gtsam.noiseModel.Diagonal.Sigmas(np.full(3, 1e-6))
            self._graph.add(self._gtsam.PriorFactorPose2(key, self._gtsam.Pose2(*pose), noise))
            self._values.insert(key, self._gtsam.Pose2(*pose))
        self._smooth()

    def predict(self, vehicle: str, increment: Pose2, covariance: Array) -> None:
        """Propagate by an odometry increment (vehicle frame) with covariance (3, 3).

        Increments accumulate and enter the graph at the next update.
        """
        self._check(vehicle)
        self._pending[vehicle] = compound(*self._pending[vehicle], increment, covariance)

    def update(
        self, vehicle: str, observations: LandmarkObservations, identities: Sequence[int]
    ) -> None:
        """Add a pose with its observations and their landmark identities, then smooth."""
        if len(identities) != len(observations):
            raise EvaluationError(
                f'iSAM2: {len(identities)} identities for {len(observations)} observations'
            )
        pose = self._add_pose(vehicle, observations.stamp)
        key = self._newest_key(vehicle)
        placed = to_world(pose, observations.positions)
        for row, identity in enumerate(int(number) for number in identities):
            landmark = self._landmark_key(identity)
            if identity not in self._known:
                self._known.add(identity)
                self._values.insert(landmark, placed[row])
            noise = self._gtsam.noiseModel.Gaussian.Covariance(observations.covariances[row])
            self._graph.add(
                self._gtsam.CustomFactor(
                    noise, [key, landmark], _position_error(observations.positions[row])
                )
            )
        self._smooth()

    def estimate(self, vehicle: str) -> tuple[Pose2, Array]:
        """Return the pose with pending increments; covariance (3, 3) of the newest graph pose."""
        key = self._newest_key(vehicle)
        pose = _pose_of(self._estimate.atPose2(key)).compose(self._pending[vehicle][0])
        # GTSAM gives the covariance in the vehicle frame; the filter uses the map frame.
        return pose, rotated(self._isam.marginalCovariance(key), -pose.theta)

    def trajectory(self, vehicle: str) -> tuple[Array, Array]:
        """Return stamps (T,) and smoothed poses (T, 3), beginning with the start pose."""
        self._check(vehicle)
        poses = [
            _pose_of(self._estimate.atPose2(self._pose_key(vehicle, number)))
            for number in range(self._counts[vehicle] + 1)
        ]
        return np.array(self._stamps[vehicle]), np.array(poses)

    def landmarks(self) -> tuple[NDArray[np.int64], Array]:
        """Return identities (N,), ascending, and positions (N, 3) m."""
        identities = np.array(sorted(self._known), dtype=np.int64)
        places = [self._estimate.atPoint3(self._landmark_key(int(n))) for n in identities]
        return identities, np.array(places).reshape(-1, 3)

    def _add_pose(self, vehicle: str, stamp: float) -> Pose2:
        before = self._newest_key(vehicle)
        increment, covariance = self._pending[vehicle]
        pose = _pose_of(self._estimate.atPose2(before)).compose(increment)
        self._counts[vehicle] += 1
        self._stamps[vehicle].append(stamp)
        key = self._newest_key(vehicle)
        # Rotate into the frame at the end of the motion; keep an exact motion regular.
        at_end = rotated(covariance, increment.theta) + 1e-12 * np.eye(3)
        noise = self._gtsam.noiseModel.Gaussian.Covariance(at_end)
        step = self._gtsam.Pose2(*increment)
        self._graph.add(self._gtsam.BetweenFactorPose2(before, key, step, noise))
        self._values.insert(key, self._gtsam.Pose2(*pose))
        self._pending[vehicle] = (IDENTITY, np.zeros((3, 3)))
        return pose

    def _smooth(self) -> None:
        self._isam.update(self._graph, self._values)
        self._isam.update()
        self._estimate = self._isam.calculateEstimate()
        self._clear_new()

    def _clear_new(self) -> None:
        self._graph = self._gtsam.NonlinearFactorGraph()
        self._values = self._gtsam.Values()

    def _check(self, vehicle: str) -> None:
        if vehicle not in self._counts:
            raise EvaluationError(
                f'iSAM2: unknown vehicle {vehicle!r}, expected one of {self._names}'
            )

    def _newest_key(self, vehicle: str) -> int:
        self._check(vehicle)
        return self._pose_key(vehicle, self._counts[vehicle])

    def _pose_key(self, vehicle: str, number: int) -> int:
        index = self._names.index(vehicle) * _KEYS_PER_VEHICLE + number
        return int(self._gtsam.symbol(_POSE, index))

    def _landmark_key(self, identity: int) -> int:
        return int(self._gtsam.symbol(_LANDMARK, identity))


def _pose_of(pose: Any) -> Pose2:
    return Pose2(pose.x(), pose.y(), pose.theta())


def _position_error(measured: Array) -> Any:
    """Return the error function of a measured landmark position (3,) m in the vehicle frame."""

    def error(factor: Any, values: Any, jacobians: list[Array] | None) -> Array:
        keys = factor.keys()
        pose, landmark = values.atPose2(keys[0]), values.atPoint3(keys[1])
        back = planar_rotation(-pose.theta())
        seen = back @ (landmark - np.array([pose.x(), pose.y(), 0.0]))
        if jacobians is not None:
            # Right perturbation of Pose2: (forward, left, heading) in the vehicle frame.
            jacobians[0] = np.array([[-1.0, 0.0, seen[1]], [0.0, -1.0, -seen[0]], [0.0, 0.0, 0.0]])
            jacobians[1] = back
        difference: Array = seen - measured
        return difference

    return error
