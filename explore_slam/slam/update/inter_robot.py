"""Vehicles that see each other: one relative position moves the poses of both.

Only the seer's pose is sampled. What the seer sees, a position, is linear in the pose of the seen
vehicle, which therefore stays Gaussian given the sample: its heading, mostly unknown then, is not
thinned out by resamplings until its own observations need it.
"""

import math

import numpy as np

from explore_slam.compiled import kernel
from explore_slam.data import InterRobotObservation
from explore_slam.geometry import Array
from explore_slam.slam.config import FastSlamConfig
from explore_slam.slam.update.gaussian import sample_gaussian


@kernel
def _conditioned(
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
def _innovation_covariance(H: Array, P: Array, S: Array) -> None:  # pragma: no cover - compiled
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
    c, s = math.cos(pose[2]), math.sin(pose[2])
    pose[0] += c * delta[0] - s * delta[1]
    pose[1] += s * delta[0] + c * delta[1]
    pose[2] += delta[2]


@kernel
def _sight(
    seer: Array,
    seer_P: Array,
    seen: Array,
    seen_P: Array,
    z: Array,
    R: Array,
    gate: float,
    threshold: float,
    normals: Array,
    weights: Array,
    log_weights: Array,
    left_P: Array,
) -> None:  # pragma: no cover - compiled
    """Move poses of seer and seen (M, 3 each), given that seen is at z (2,) from seer.

    seer_P and seen_P (3, 3): covariances of the poses in their own frames, independent of each
    other; R (2, 2); normals (M, 3). seer becomes samples, seen conditional means with the
    covariance left_P (3, 3), the mean over the weights (M,) of the particles before.
    A residual d beyond the threshold counts with R · d²/t², one beyond the gate is left out, and
    weighs like one at the gate.
    """
    Hi, Hj = np.zeros((2, 3)), np.zeros((2, 3))
    S, W = np.empty((2, 2)), np.empty((2, 2))
    nu, delta, posterior = np.empty(2), np.empty(3), np.empty((3, 3))
    t2 = threshold * threshold
    left_P[:] = 0.0
    for m in range(len(seer)):
        c, s = math.cos(seer[m, 2]), math.sin(seer[m, 2])
        dx, dy = seen[m, 0] - seer[m, 0], seen[m, 1] - seer[m, 1]
        zx, zy = c * dx + s * dy, c * dy - s * dx
        Hi[0, 0], Hi[0, 2], Hi[1, 1], Hi[1, 2] = -1.0, zy, -1.0, -zx
        turn = seen[m, 2] - seer[m, 2]
        Hj[0, 0], Hj[0, 1] = math.cos(turn), -math.sin(turn)
        Hj[1, 0], Hj[1, 1] = math.sin(turn), math.cos(turn)
        nu[0], nu[1] = z[0] - zx, z[1] - zy
        S[:] = R
        _innovation_covariance(Hi, seer_P, S)
        _innovation_covariance(Hj, seen_P, S)
        determinant = _inverted(S, W)
        square = W[0, 0] * nu[0] * nu[0] + 2.0 * W[0, 1] * nu[0] * nu[1] + W[1, 1] * nu[1] * nu[1]
        scale = max(square / t2, 1.0)
        bounded = min(square, t2 * (1.0 + math.log(scale)), t2 * (1.0 + math.log(gate / t2)))
        log_weights[m] -= 0.5 * (bounded + math.log(determinant))
        if square > gate:
            delta[:] = 0.0
            sample_gaussian(seer_P, normals[m], delta)
            _move(seer[m], delta)
            left_P += weights[m] * seen_P
            continue
        S += (scale - 1.0) * R
        _inverted(S, W)
        _conditioned(seer_P, Hi, W, nu, delta, posterior)
        sample_gaussian(posterior, normals[m], delta)
        for a in range(2):
            nu[a] -= Hi[a, 0] * delta[0] + Hi[a, 1] * delta[1] + Hi[a, 2] * delta[2]
        _move(seer[m], delta)
        S[:] = scale * R
        _innovation_covariance(Hj, seen_P, S)
        _inverted(S, W)
        _conditioned(seen_P, Hj, W, nu, delta, posterior)
        _move(seen[m], delta)
        left_P += weights[m] * posterior


def sight(
    seer: Array,
    seer_P: Array,
    seen: Array,
    seen_P: Array,
    sighting: InterRobotObservation,
    config: FastSlamConfig,
    normals: Array,
    weights: Array,
) -> tuple[Array, Array]:
    """Move poses of seer and seen (M, 3 each) in place, given what the seer sees.

    seer_P, seen_P (3, 3) are their covariances in their own frames; the seer is sampled by
    normals (M, 3). Returns the logarithms (M,) of the likelihoods, and the covariance (3, 3) that
    seen has then, the mean over the weights (M,). FloatingPointError where a number is out of
    range.
    """
    log_weights, left = np.zeros(len(seer)), np.empty((3, 3))
    _sight(
        seer, seer_P, seen, seen_P, sighting.position, sighting.covariance,
        config.association.association_gate**2, config.outlier_threshold, normals, weights,
        log_weights, left,
    )  # fmt: skip
    if not all(np.isfinite(part).all() for part in (seer, seen, left, log_weights)):
        raise FloatingPointError('a sighting is not finite')
    return log_weights, 0.5 * (left + left.T)
