"""What the belief refuses, with the reason; nothing is changed before these have passed."""

import math

import numpy as np

from explore_slam.data import InterRobotObservation, LandmarkObservations
from explore_slam.errors import SlamError
from explore_slam.geometry import Array, Pose2

NORM_TOLERANCE = 0.01


def check_pose(what: str, pose: Pose2) -> Pose2:
    """Return the pose as Pose2, or refuse one that is not three finite numbers."""
    if len(pose) != 3 or not all(math.isfinite(value) for value in pose):
        raise SlamError(f'{what} is {tuple(pose)}, expected finite x, y, theta')
    return Pose2(float(pose[0]), float(pose[1]), float(pose[2]))


def check_motion_covariance(what: str, covariance: Array) -> Array:
    """Return a covariance (3, 3) that is finite, symmetric and not negative (zero is allowed)."""
    matrix = np.asarray(covariance, np.float64)
    if matrix.shape != (3, 3):
        raise SlamError(f'{what} has shape {matrix.shape}, expected (3, 3)')
    if not np.isfinite(matrix).all():
        raise SlamError(f'{what} is {matrix.tolist()}, expected finite values')
    scale = max(float(np.abs(matrix).max()), 1e-300)
    if np.abs(matrix - matrix.T).max() > 1e-6 * scale:
        raise SlamError(f'{what} is {matrix.tolist()}, expected a symmetric matrix')
    matrix = 0.5 * (matrix + matrix.T)
    least = float(np.linalg.eigvalsh(matrix)[0])
    if least < -1e-9 * scale:
        raise SlamError(f'{what} has the eigenvalue {least:.3g}, expected none below 0')
    return matrix


def check_observations(observations: LandmarkObservations, maximum: int) -> None:
    """Refuse no observations, too many, and covariances or descriptors that cannot be used."""
    count = len(observations)
    if count == 0:
        raise SlamError('observations: there are 0, expected 1 or more')
    if count > maximum:
        raise SlamError(
            f'observations: there are {count}, expected at most maximum_observations = {maximum}'
        )
    for name in ('positions', 'covariances', 'descriptors'):
        if not np.isfinite(getattr(observations, name)).all():
            raise SlamError(f'observations: {name} hold values that are not finite')
    R = observations.covariances
    scale = np.abs(R).max(axis=(1, 2))
    skew = np.abs(R - R.transpose(0, 2, 1)).max(axis=(1, 2))
    bad = np.flatnonzero(skew > 1e-6 * scale)
    if len(bad):
        raise SlamError(
            f'observations: covariance {bad[0]} is {R[bad[0]].tolist()}, not symmetric'
        )
    least = np.linalg.eigvalsh(R)[:, 0]
    bad = np.flatnonzero(least <= 1e-10 * np.maximum(scale, 1e-300))
    if len(bad):
        raise SlamError(
            f'observations: covariance {bad[0]} is {R[bad[0]].tolist()} with the least eigenvalue '
            f'{least[bad[0]]:.3g}, expected a positive definite matrix'
        )
    norms = np.linalg.norm(observations.descriptors, axis=1)
    bad = np.flatnonzero(np.abs(norms - 1.0) > NORM_TOLERANCE)
    if len(bad):
        raise SlamError(
            f'observations: descriptor {bad[0]} has length {norms[bad[0]]:.4g}, expected 1'
        )


def check_sighting(seer: str, sighting: InterRobotObservation) -> None:
    """Refuse a sighting of the seer itself, or whose covariance cannot be used."""
    covariance = sighting.covariance
    least, most = np.linalg.eigvalsh(0.5 * (covariance + covariance.T))
    if least <= 1e-10 * max(most, 1e-300):
        raise SlamError(
            f'sighting of {sighting.vehicle!r}: covariance {covariance.tolist()} has the least '
            f'eigenvalue {least:.3g}, expected a positive definite matrix'
        )
    if sighting.vehicle == seer:
        raise SlamError(f'sighting: vehicle {seer!r} cannot see itself')


def check_turn(vehicle: str, stamp: float, last: float, *, moved: bool) -> None:
    """Refuse an update at a stamp (s) before the last one, or before any motion was told."""
    if stamp < last:
        raise SlamError(f'update({vehicle!r}): stamp {stamp} lies before the last one, {last}')
    if not moved:
        raise SlamError(
            f'update({vehicle!r}) at stamp {stamp} comes before any predict: '
            'tell the motion since the start first, even if it is zero'
        )
