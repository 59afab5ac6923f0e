"""Inter-robot observations: one relative position corrects the poses of both vehicles.

Only the pose of the observer is sampled. The measured position is linear in the pose of the
observed vehicle, which therefore stays Gaussian given the sample: its heading, mostly unknown
then, is not depleted by resamplings until its own observations need it.
"""

import math
from typing import NamedTuple

import numpy as np

from explore_slam.compiled import kernel
from explore_slam.data import InterRobotObservation
from explore_slam.geometry import Array
from explore_slam.slam.config import FastSlamConfig
from explore_slam.slam.update.gaussian import sample_gaussian
from explore_slam.slam.update.robust_weights import robust_cost

# Largest Mahalanobis distance (sigma) that counts: the observed vehicle is known by its name, so
# that only gross errors are left out, unlike landmarks, which have copies. Chosen by hand;
# test_inter_robot shows what it decides.
_GATE = 8.0


@kernel
def _condition(
    P: Array, H: Array, W: Array, nu: Array, delta: Array, posterior: Array
) -> None:  # pragma: no cover - compiled
    """Set delta = P Hᵀ W ν and posterior = P − P Hᵀ W H P for H (2, 3), W (2, 2)."""
    PH = np.empty((3, 2))
    for i in range(3):
        for a in range(2):
            PH[i, a] = P[i, 0] * H[a, 0] + P[i, 1] * H[a, 1] + P[i, 2] * H[a, 2]
    for i in range(3):
        k0 = PH[i, 0] * W[0, 0] + PH[i, 1] * W[1, 0]
        k1 = PH[i, 0] * W[0, 1] + PH[i, 1] * W[1, 1]
        delta[i] = k0 * nu[0] + k1 * nu[1]
        for j in range(3):
            posterior[i, j] = P[i, j] - k0 * PH[j, 0] - k1 * PH[j, 1]


@kernel
def _add_projected(H: Array, P: Array, S: Array) -> None:  # pragma: no cover - compiled
    """Add H P Hᵀ to S (2, 2)."""
    for a in range(2):
        for b in range(2):
            for i in range(3):
                for j in range(3):
                    S[a, b] += H[a, i] * P[i, j] * H[b, j]


@kernel
def _inverted(S: Array, W: Array) -> float:  # pragma: no cover - compiled
    """Set W = S⁻¹ (2, 2) and return |S|."""
    determinant: float = S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]
    W[0, 0], W[1, 1] = S[1, 1] / determinant, S[0, 0] / determinant
    W[0, 1], W[1, 0] = -S[0, 1] / determinant, -S[1, 0] / determinant
    return determinant


@kernel
def _move(pose: Array, delta: Array) -> None:  # pragma: no cover - compiled
    """Move a pose (3,) by delta (3,) in its own frame."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    pose[0] += c * delta[0] - s * delta[1]
    pose[1] += s * delta[0] + c * delta[1]
    pose[2] += delta[2]


class _Poses(NamedTuple):
    """Poses (M, 3) of one vehicle, and their covariance P (3, 3) in their own frames."""

    poses: Array
    P: Array


class _Measurement(NamedTuple):
    """Position z (2,) m with covariance R (2, 2); largest d² (gate) and outlier threshold t²."""

    z: Array
    R: Array
    gate: float
    t2: float


@kernel
def _condition_poses(
    observer: _Poses,
    target: _Poses,
    measurement: _Measurement,
    normals: Array,
    weights: Array,
    log_likelihoods: Array,
    remaining: Array,
) -> None:  # pragma: no cover - compiled
    """Condition the poses of observer and target on the measured position of the target.

    The errors of both are independent. The observer's poses become samples (normals (M, 3)), the
    target's conditional means with the covariance `remaining` (3, 3), the mean over the weights
    (M,) of the particles before. A residual d beyond the threshold has the covariance R d²/t²; one
    beyond the gate is ignored, and costs as much as one at the gate.
    """
    Hi, Hj = np.zeros((2, 3)), np.zeros((2, 3))
    S, W = np.empty((2, 2)), np.empty((2, 2))
    nu, delta, posterior = np.empty(2), np.empty(3), np.empty((3, 3))
    z, R, t2 = measurement.z, measurement.R, measurement.t2
    first, second = observer.poses, target.poses
    remaining[:] = 0.0
    for m in range(len(first)):
        c, s = math.cos(first[m, 2]), math.sin(first[m, 2])
        dx, dy = second[m, 0] - first[m, 0], second[m, 1] - first[m, 1]
        zx, zy = c * dx + s * dy, c * dy - s * dx
        Hi[0, 0], Hi[0, 2], Hi[1, 1], Hi[1, 2] = -1.0, zy, -1.0, -zx
        turn = second[m, 2] - first[m, 2]
        Hj[0, 0], Hj[0, 1] = math.cos(turn), -math.sin(turn)
        Hj[1, 0], Hj[1, 1] = math.sin(turn), math.cos(turn)
        nu[0], nu[1] = z[0] - zx, z[1] - zy
        S[:] = R
        _add_projected(Hi, observer.P, S)
        _add_projected(Hj, target.P, S)
        determinant = _inverted(S, W)
        square = W[0, 0] * nu[0] * nu[0] + 2.0 * W[0, 1] * nu[0] * nu[1] + W[1, 1] * nu[1] * nu[1]
        cost = min(square, robust_cost(square, t2), robust_cost(measurement.gate, t2))
        log_likelihoods[m] -= 0.5 * (cost + math.log(determinant))
        if square > measurement.gate:
            delta[:] = 0.0
            sample_gaussian(observer.P, normals[m], delta)
            _move(first[m], delta)
            remaining += weights[m] * target.P
            continue
        scale = max(square / t2, 1.0)
        S += (scale - 1.0) * R
        _inverted(S, W)
        _condition(observer.P, Hi, W, nu, delta, posterior)
        sample_gaussian(posterior, normals[m], delta)
        for a in range(2):
            nu[a] -= Hi[a, 0] * delta[0] + Hi[a, 1] * delta[1] + Hi[a, 2] * delta[2]
        _move(first[m], delta)
        S[:] = scale * R
        _add_projected(Hj, target.P, S)
        _inverted(S, W)
        _condition(target.P, Hj, W, nu, delta, posterior)
        _move(second[m], delta)
        remaining += weights[m] * posterior


def condition_on_observation(
    observer: tuple[Array, Array],
    target: tuple[Array, Array],
    observation: InterRobotObservation,
    config: FastSlamConfig,
    normals: Array,
    weights: Array,
) -> tuple[Array, Array]:
    """Condition the poses of two vehicles, in place, on what the observer measured of the target.

    observer, target: poses (M, 3) and their covariance (3, 3) in their own frames; normals (M, 3)
    for the sampled poses of the observer; weights (M,). Returns log-likelihoods (M,) and the
    covariance (3, 3) that remains for the target. FloatingPointError if numbers overflow.
    """
    log_likelihoods, remaining = np.zeros(len(weights)), np.empty((3, 3))
    measurement = _Measurement(
        observation.position,
        observation.covariance,
        _GATE**2,
        config.outlier_threshold * config.outlier_threshold,
    )
    _condition_poses(
        _Poses(*observer), _Poses(*target), measurement, normals, weights, log_likelihoods,
        remaining,
    )  # fmt: skip
    numbers = (observer[0], target[0], remaining, log_likelihoods)
    if not all(np.isfinite(part).all() for part in numbers):
        raise FloatingPointError('poses after an inter-robot observation are not finite')
    return log_likelihoods, 0.5 * (remaining + remaining.T)
