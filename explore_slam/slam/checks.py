"""Validation of the inputs of the filter; all checks precede any change of its state."""

import math

import numpy as np

from explore_slam.data import InterRobotObservation, LandmarkObservations
from explore_slam.errors import SlamError
from explore_slam.geometry import Array, Pose2
from explore_slam.slam.descriptors.kinds import DescriptorKind

# Relative to the largest entry of a matrix: beyond rounding, so that it is a mistake.
_ASYMMETRY = 1e-6
_NEGATIVE = 1e-9  # smallest eigenvalue of a covariance that may be singular
# smallest eigenvalue, to the largest, of a covariance that is inverted; the joint graph takes half
_SINGULAR = 2e-10
_TINY = 1e-300


def check_pose(what: str, pose: Pose2) -> Pose2:
    """Return the pose; SlamError unless it has three finite numbers."""
    if len(pose) != 3 or not all(math.isfinite(value) for value in pose):
        raise SlamError(f'{what} is {tuple(pose)}, expected finite x, y, theta')
    return Pose2(float(pose[0]), float(pose[1]), float(pose[2]))


def check_motion_covariance(what: str, covariance: Array) -> Array:
    """Return a covariance (3, 3); SlamError unless it is positive semidefinite."""
    matrix = np.asarray(covariance, np.float64)
    if matrix.shape != (3, 3):
        raise SlamError(f'{what} has shape {matrix.shape}, expected (3, 3)')
    if not np.isfinite(matrix).all():
        raise SlamError(f'{what} is {matrix.tolist()}, expected finite values')
    scale = max(float(np.abs(matrix).max()), _TINY)
    if np.abs(matrix - matrix.T).max() > _ASYMMETRY * scale:
        raise SlamError(f'{what} is {matrix.tolist()}, expected a symmetric matrix')
    matrix = 0.5 * (matrix + matrix.T)
    least = float(np.linalg.eigvalsh(matrix)[0])
    if least < -_NEGATIVE * scale:
        raise SlamError(f'{what} has the eigenvalue {least:.3g}, expected none below 0')
    return matrix


def check_observations(
    observations: LandmarkObservations, kind: DescriptorKind, maximum: int
) -> None:
    """Raise SlamError for no or too many observations, bad covariances and bad descriptors."""
    count = len(observations)
    if count == 0:
        raise SlamError('observations: there are 0, expected 1 or more')
    if count > maximum:
        raise SlamError(
            f'observations: there are {count}, expected at most maximum_observations = {maximum}'
        )
    for name in ('positions', 'covariances', 'descriptors'):
        if not np.isfinite(getattr(observations, name)).all():
            raise SlamError(f'observations: {name} contain values that are not finite')
    R = observations.covariances
    scale = np.abs(R).max(axis=(1, 2))
    skew = np.abs(R - R.transpose(0, 2, 1)).max(axis=(1, 2))
    bad = np.flatnonzero(skew > _ASYMMETRY * scale)
    if len(bad):
        raise SlamError(
            f'observations: covariance {bad[0]} is {R[bad[0]].tolist()}, not symmetric'
        )
    eigenvalues = np.linalg.eigvalsh(R, UPLO='U')  # the triangle that rows contain
    least, largest = eigenvalues[:, 0], eigenvalues[:, 2]
    bad = np.flatnonzero(least <= _SINGULAR * np.maximum(largest, _TINY))
    if len(bad):
        raise SlamError(
            f'observations: covariance {bad[0]} is {R[bad[0]].tolist()} with the smallest '
            f'eigenvalue {least[bad[0]]:.3g}, expected a positive definite matrix'
        )
    kind.check(observations.descriptors)


def check_inter_robot(observer: str, observation: InterRobotObservation) -> None:
    """Raise SlamError for an observation of the observer itself or with a bad covariance."""
    covariance = observation.covariance
    if abs(covariance[0, 1] - covariance[1, 0]) > _ASYMMETRY * np.abs(covariance).max():
        raise SlamError(
            f'observation of {observation.vehicle!r}: covariance {covariance.tolist()} is not '
            'symmetric'
        )
    least, most = np.linalg.eigvalsh(0.5 * (covariance + covariance.T))
    if least <= _SINGULAR * max(most, _TINY):
        raise SlamError(
            f'observation of {observation.vehicle!r}: covariance {covariance.tolist()} has the '
            f'smallest eigenvalue {least:.3g}, expected a positive definite matrix'
        )
    if observation.vehicle == observer:
        raise SlamError(f'vehicle {observer!r} cannot observe itself')


def check_order(vehicle: str, stamp: float, last: float, *, predicted: bool) -> None:
    """Raise SlamError for an update at a stamp (s) before the last one, or before any predict."""
    if stamp < last:
        raise SlamError(f'update({vehicle!r}): stamp {stamp} lies before the last one, {last}')
    if not predicted:
        raise SlamError(
            f'update({vehicle!r}) at stamp {stamp} comes before any predict: '
            'predict the motion since the start first, even if it is zero'
        )
