"""Consistency of pose estimates: whether errors lie within the published covariances.

The measure is the normalized estimation error squared (NEES), eᵀ C⁻¹ e. For a consistent Gaussian
estimate its mean is the number of dimensions: 3 for a pose, 2 for a position (Bar-Shalom, Li,
Kirubarajan: Estimation with Applications to Tracking and Navigation, 2001, section 5.4; for
FastSLAM: Bailey, Nieto, Nebot: Consistency of the FastSLAM algorithm, ICRA 2006).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from explore_slam.errors import EvaluationError
from explore_slam.geometry import Array, between, wrap_angles
from explore_slam.results.trajectory import Trajectory

# 95 % quantile of the chi-square distribution with two degrees of freedom.
CHI_SQUARE_95_2D = 5.991
# Smallest ratio of eigenvalues of a regular correlation matrix: below, rounding errors dominate.
SINGULAR_RATIO = 1e-12
# Variance (m², rad²) that counts as zero: the mean over particles of an exact pose has rounding
# errors of 1e-16 m, any sensor an error above a micrometre.
ZERO_VARIANCE = 1e-18
# A vehicle stands at its start until all variances exceed that of a micrometre (wheels that stand
# still report motions of nanometres), or until the truth has moved by a centimetre or 0.01 rad.
STARTED_VARIANCE, STARTED_MOTION = 1e-12, (0.01, 0.01)


@dataclass(frozen=True)
class PoseEstimates:
    """Mean poses (T, 3) m, m, rad and covariances (T, 3, 3) published at stamps (T,) s.

    Stamps may repeat: each estimate counts.
    """

    stamps: Array
    poses: Array
    covariances: Array

    def __post_init__(self) -> None:
        count = self.stamps.size
        shapes = (self.stamps.shape, self.poses.shape, self.covariances.shape)
        if shapes != ((count,), (count, 3), (count, 3, 3)):
            raise EvaluationError(
                f'PoseEstimates: shapes {shapes}, expected (T,), (T, 3) and (T, 3, 3)'
            )

    def __len__(self) -> int:
        return int(self.stamps.size)

    @classmethod
    def empty(cls) -> 'PoseEstimates':
        """Make a record without estimates."""
        return cls(np.empty(0), np.empty((0, 3)), np.empty((0, 3, 3)))


@dataclass(frozen=True)
class EstimationErrors:
    """Errors (T, 3) m, m, rad of published estimates in the map frame, with covariances."""

    stamps: Array
    errors: Array
    covariances: Array

    def __len__(self) -> int:
        return int(self.stamps.size)

    @property
    def pose_nees(self) -> Array:
        """NEES (T,) of the pose, expected 3."""
        return nees(self.errors, self.covariances)

    @property
    def position_nees(self) -> Array:
        """NEES (T,) of the position, expected 2."""
        return nees(self.errors[:, :2], self.covariances[:, :2, :2])

    @property
    def sigmas(self) -> Array:
        """Published standard deviations (T, 3) m, m, rad."""
        variances = np.diagonal(self.covariances, axis1=1, axis2=2)
        deviations: Array = np.sqrt(np.maximum(variances, 0.0))
        return deviations


def estimation_errors(
    estimates: PoseEstimates, truth: Trajectory, max_gap: float | None = None
) -> EstimationErrors:
    """Compare published estimates with ground truth interpolated to their stamps.

    Left out are estimates outside the ground truth or in a gap of more than max_gap (s), as in
    Trajectory.at, and those until the vehicle has left its given start pose, at which nothing is
    estimated.
    """
    poses, valid = truth.at(estimates.stamps, max_gap)
    variances = np.diagonal(estimates.covariances, axis1=1, axis2=2)
    moved = (variances > STARTED_VARIANCE).all(axis=1) | _has_moved(poses, valid)
    valid = valid & (np.cumsum(moved) > 0)
    errors = estimates.poses[valid] - poses[valid]
    errors[:, 2] = wrap_angles(errors[:, 2])
    return EstimationErrors(estimates.stamps[valid], errors, estimates.covariances[valid])


def nees(errors: Array, covariances: Array) -> Array:
    """Return eᵀ C⁻¹ e (T,) of errors (T, D) with covariances (T, D, D); inf if C is singular."""
    regular, deviations = _regular(covariances)
    found = np.full(len(errors), np.inf)
    scaled = errors[regular] / deviations[regular]
    correlation = _correlation(covariances[regular], deviations[regular])
    solved = np.linalg.solve(correlation, scaled[..., None])[..., 0]
    found[regular] = np.sum(scaled * solved, axis=1)
    return found


def _regular(covariances: Array) -> tuple[NDArray[np.bool_], Array]:
    """Return which covariances are positive definite, and all standard deviations (T, D).

    Tested is the correlation matrix, which does not depend on the units of position and heading.
    """
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    regular = np.isfinite(covariances).all(axis=(1, 2)) & (variances > ZERO_VARIANCE).all(axis=1)
    deviations = np.sqrt(np.where(regular[:, None], variances, 1.0))
    values = np.linalg.eigvalsh(_correlation(covariances[regular], deviations[regular]))
    regular[regular] = values[:, 0] > SINGULAR_RATIO * values[:, -1]
    return regular, deviations


def _correlation(covariances: Array, deviations: Array) -> Array:
    correlation: Array = covariances / (deviations[:, :, None] * deviations[:, None, :])
    return correlation


def _has_moved(poses: Array, valid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return (N,) whether true poses (N, 3), where they are valid, have left the first of them."""
    if not valid.any():
        return valid
    along, across, turn = between(poses[np.argmax(valid)], poses).T
    distance, heading = STARTED_MOTION
    moved: NDArray[np.bool_] = (np.hypot(along, across) > distance) | (np.abs(turn) > heading)
    return valid & moved


def consistency_metrics(
    estimates: PoseEstimates, truth: Trajectory, max_gap: float | None = None
) -> dict[str, float]:
    """Return mean and median NEES, and the fraction of positions within the 95 % ellipse.

    Empty where no estimate can be compared with ground truth.
    """
    found = estimation_errors(estimates, truth, max_gap)
    if not len(found):
        return {}
    pose, position = found.pose_nees, found.position_nees
    return {
        'pose_nees_mean': float(pose.mean()),
        'pose_nees_median': float(np.median(pose)),
        'position_nees_mean': float(position.mean()),
        'position_in_95': float(np.mean(position <= CHI_SQUARE_95_2D)),
    }
