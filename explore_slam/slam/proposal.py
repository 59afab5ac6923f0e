"""FastSLAM 2.0: each particle's pose proposal folds in what is observed now.

For one particle, with δ the pose error in the predicted vehicle frame, δ ~ N(0, P), and the
observations z = h + H δ + noise of covariance S = Σ + R: Λ = Σ Hᵀ S⁻¹ H, η = Σ Hᵀ S⁻¹ ν,
posterior covariance (P⁻¹ + Λ)⁻¹ = P (I + Λ P)⁻¹ (also for singular P) and mean P (I + Λ P)⁻¹ η.
The solution is iterated once: residuals are judged where the first solution lies, by their
studentized length d, and lose influence beyond the outlier threshold t, w = t² / d²: the
likelihood has a heavy tail and no single observation decides over a particle.
"""

import math

import numpy as np
from numba import njit

from explore_slam.geometry import Array
from explore_slam.slam.association import Choice, Locals, inverse, quadratic, seen_covariance


@njit(cache=True, nogil=True)
def solve(
    P: Array, L: Array, eta: Array, delta: Array, posterior: Array
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Set posterior = P (I + L P)⁻¹ and delta = posterior η; return |I + L P| and ηᵀ delta."""
    A = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            A[i, j] = L[i, 0] * P[0, j] + L[i, 1] * P[1, j] + L[i, 2] * P[2, j]
        A[i, i] += 1.0
    c00 = A[1, 1] * A[2, 2] - A[1, 2] * A[2, 1]
    c01 = A[1, 2] * A[2, 0] - A[1, 0] * A[2, 2]
    c02 = A[1, 0] * A[2, 1] - A[1, 1] * A[2, 0]
    determinant = A[0, 0] * c00 + A[0, 1] * c01 + A[0, 2] * c02
    r = 1.0 / determinant
    I00, I10, I20 = r * c00, r * c01, r * c02
    I01 = r * (A[0, 2] * A[2, 1] - A[0, 1] * A[2, 2])
    I11 = r * (A[0, 0] * A[2, 2] - A[0, 2] * A[2, 0])
    I21 = r * (A[0, 1] * A[2, 0] - A[0, 0] * A[2, 1])
    I02 = r * (A[0, 1] * A[1, 2] - A[0, 2] * A[1, 1])
    I12 = r * (A[0, 2] * A[1, 0] - A[0, 0] * A[1, 2])
    I22 = r * (A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0])
    for i in range(3):
        posterior[i, 0] = P[i, 0] * I00 + P[i, 1] * I10 + P[i, 2] * I20
        posterior[i, 1] = P[i, 0] * I01 + P[i, 1] * I11 + P[i, 2] * I21
        posterior[i, 2] = P[i, 0] * I02 + P[i, 1] * I12 + P[i, 2] * I22
    for i in range(3):
        for j in range(i):
            mean = 0.5 * (posterior[i, j] + posterior[j, i])
            posterior[i, j] = mean
            posterior[j, i] = mean
    quad = 0.0
    for i in range(3):
        delta[i] = posterior[i, 0] * eta[0] + posterior[i, 1] * eta[1] + posterior[i, 2] * eta[2]
        quad += eta[i] * delta[i]
    return determinant, quad


@njit(cache=True, nogil=True)
def sample_gaussian(
    posterior: Array, normal: Array, delta: Array
) -> None:  # pragma: no cover - compiled
    """Add chol(posterior) · normal (3,) to delta (3,); directions without variance stay."""
    l00 = math.sqrt(max(posterior[0, 0], 0.0))
    l10 = posterior[1, 0] / l00 if l00 > 1e-12 else 0.0
    l20 = posterior[2, 0] / l00 if l00 > 1e-12 else 0.0
    l11 = math.sqrt(max(posterior[1, 1] - l10 * l10, 0.0))
    l21 = (posterior[2, 1] - l20 * l10) / l11 if l11 > 1e-12 else 0.0
    l22 = math.sqrt(max(posterior[2, 2] - l20 * l20 - l21 * l21, 0.0))
    delta[0] += l00 * normal[0]
    delta[1] += l10 * normal[0] + l11 * normal[1]
    delta[2] += l20 * normal[0] + l21 * normal[1] + l22 * normal[2]


@njit(cache=True, nogil=True)
def propose(
    slab: Array,
    slots: Locals,
    candidates: Locals,
    choice: Choice,
    z: Array,
    R: Array,
    P: Array,
    gate: float,
    threshold: float,
    normals: Array,
    poses: Array,
    log_weights: Array,
    influence: Array,
) -> None:  # pragma: no cover - compiled
    """Move poses (M, 3) by a sample of the proposal and add the likelihood to log_weights (M,).

    influence (K, M) receives w of each observation in each particle. An observation that has
    found no landmark in a particle counts like a residual at the gate.
    """
    K = len(candidates)
    t2 = threshold * threshold
    L = np.empty((3, 3))
    eta = np.empty(3)
    delta = np.empty(3)
    posterior = np.empty((3, 3))
    unmatched = np.empty(K)
    for k in range(K):
        w = inverse(
            2.0 * R[k, 0], 2.0 * R[k, 1], 2.0 * R[k, 2], 2.0 * R[k, 3], 2.0 * R[k, 4],
            2.0 * R[k, 5],
        )  # fmt: skip
        unmatched[k] = t2 * (1.0 + math.log(max(gate / t2, 1.0))) + math.log(w[6])
    for m in range(len(poses)):
        delta[:] = 0.0
        cost = 0.0
        determinant = 1.0
        quad = 0.0
        for iteration in range(2):
            cd, sd = math.cos(delta[2]), math.sin(delta[2])
            heading = poses[m, 2]
            c0, s0 = math.cos(heading), math.sin(heading)
            px = poses[m, 0] + c0 * delta[0] - s0 * delta[1]
            py = poses[m, 1] + s0 * delta[0] + c0 * delta[1]
            c, s = c0 * cd - s0 * sd, s0 * cd + c0 * sd
            L[:] = 0.0
            eta[:] = 0.0
            cost = 0.0
            for k in range(K):
                if choice[k, m] < 0:
                    influence[k, m] = 0.0
                    cost += unmatched[k]
                    continue
                row = slab[slots[candidates[k, choice[k, m]]]]
                dx, dy = row[0, m] - px, row[1, m] - py
                zx, zy = c * dx + s * dy, c * dy - s * dx
                vx, vy, vz = z[k, 0] - zx, z[k, 1] - zy, z[k, 2] - row[2, m]
                sxx, sxy, sxz, syy, syz, szz = seen_covariance(
                    c, s, row[3, m], row[4, m], row[5, m], row[6, m], row[7, m], row[8, m]
                )
                sxx += R[k, 0]
                sxy += R[k, 1]
                sxz += R[k, 2]
                syy += R[k, 3]
                syz += R[k, 4]
                szz += R[k, 5]
                w = inverse(sxx, sxy, sxz, syy, syz, szz)
                # rows of H in the predicted frame: [-cd, -sd, zy], [sd, -cd, -zx], 0
                weight = 1.0
                if iteration == 1:
                    # residual covariance S - H posterior Hᵀ, studentized
                    Q = posterior
                    a0 = -cd * Q[0, 0] - sd * Q[1, 0] + zy * Q[2, 0]
                    a1 = -cd * Q[0, 1] - sd * Q[1, 1] + zy * Q[2, 1]
                    a2 = -cd * Q[0, 2] - sd * Q[1, 2] + zy * Q[2, 2]
                    b0 = sd * Q[0, 0] - cd * Q[1, 0] - zx * Q[2, 0]
                    b1 = sd * Q[0, 1] - cd * Q[1, 1] - zx * Q[2, 1]
                    b2 = sd * Q[0, 2] - cd * Q[1, 2] - zx * Q[2, 2]
                    hxx = -cd * a0 - sd * a1 + zy * a2
                    hxy = sd * a0 - cd * a1 - zx * a2
                    hyy = sd * b0 - cd * b1 - zx * b2
                    u = inverse(
                        max(sxx - hxx, 1e-6 * sxx), sxy - hxy, sxz, max(syy - hyy, 1e-6 * syy),
                        syz, szz,
                    )  # fmt: skip
                    square = quadratic(u, vx, vy, vz)
                    if u[6] <= 0.0 or square < 0.0:
                        square = quadratic(w, vx, vy, vz)
                    if square > t2:
                        weight = t2 / square
                influence[k, m] = weight
                cost += math.log(w[6]) - t2 * math.log(weight)
                # residual at the predicted pose, as the present linearization has it
                vx += -cd * delta[0] - sd * delta[1] + zy * delta[2]
                vy += sd * delta[0] - cd * delta[1] - zx * delta[2]
                cost += weight * quadratic(w, vx, vy, vz)
                gx = weight * (w[0] * vx + w[1] * vy + w[2] * vz)
                gy = weight * (w[1] * vx + w[3] * vy + w[4] * vz)
                wxx, wxy, wyy = weight * w[0], weight * w[1], weight * w[3]
                eta[0] += -cd * gx + sd * gy
                eta[1] += -sd * gx - cd * gy
                eta[2] += zy * gx - zx * gy
                a0, b0 = -cd * wxx + sd * wxy, -cd * wxy + sd * wyy
                a1, b1 = -sd * wxx - cd * wxy, -sd * wxy - cd * wyy
                a2, b2 = zy * wxx - zx * wxy, zy * wxy - zx * wyy
                L[0, 0] += -cd * a0 + sd * b0
                L[0, 1] += -sd * a0 - cd * b0
                L[0, 2] += zy * a0 - zx * b0
                L[1, 1] += -sd * a1 - cd * b1
                L[1, 2] += zy * a1 - zx * b1
                L[2, 2] += zy * a2 - zx * b2
            L[1, 0], L[2, 0], L[2, 1] = L[0, 1], L[0, 2], L[1, 2]
            determinant, quad = solve(P, L, eta, delta, posterior)
        log_weights[m] -= 0.5 * (cost - quad + math.log(max(determinant, 1e-300)))
        sample_gaussian(posterior, normals[m], delta)
        heading = poses[m, 2]
        c0, s0 = math.cos(heading), math.sin(heading)
        poses[m, 0] += c0 * delta[0] - s0 * delta[1]
        poses[m, 1] += s0 * delta[0] + c0 * delta[1]
        poses[m, 2] = heading + delta[2]
