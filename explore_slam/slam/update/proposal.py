"""FastSLAM 2.0 for blocks of particles: association, pose proposal, likelihood.

(Montemerlo et al., "FastSLAM 2.0: an improved particle filtering algorithm for simultaneous
localization and mapping that provably converges", 2003.) For one particle, with δ the pose error
in the predicted vehicle frame, δ ~ N(0, P), and observations z = h + H δ + noise of covariance S =
Σ + R:  Λ = Σ Hᵀ S⁻¹ H,  η = Σ Hᵀ S⁻¹ ν.  The proposal has the covariance (P⁻¹ + Λ)⁻¹ = P (I + Λ
P)⁻¹, also for singular P, and the mean P (I + Λ P)⁻¹ η. It is solved twice: the first solution is
where the observations are linearized and reweighted (see robust_weights) for the second.

The likelihood does not depend on the sample that is drawn from the proposal. Resampling therefore
comes before sampling, and the copies of one particle get different poses.

Particles are independent of each other: any split into blocks and threads gives the same bits.
"""

import math
from typing import NamedTuple

import numpy as np

from explore_slam.compiled import kernel
from explore_slam.geometry import Array
from explore_slam.slam.association.state import Associations, CandidateRows, Observed
from explore_slam.slam.storage.row_format import Choice
from explore_slam.slam.update.blocks import (
    BEST,
    BLOCK,
    CD,
    COS,
    COST,
    D0,
    D1,
    D2,
    DET,
    ETA,
    LAMBDA,
    LM,
    MASK,
    PICK,
    PRODUCT,
    PX,
    PY,
    SCRATCH,
    SD,
    SIN,
    SQ,
    VX,
    VY,
    VZ,
    WEIGHT,
    WEIGHTS,
    ZX,
    ZY,
    Q,
    S,
    W,
    expect,
    invert,
    load,
    mahalanobis_squared,
)
from explore_slam.slam.update.gaussian import sample_gaussian, solve
from explore_slam.slam.update.robust_weights import reweight, robust_cost

# Products of determinants and weights are scaled back into 1e-100 … 1e100, by an exact power of
# two whose logarithm goes to the cost: a single factor may then be as large or small as 1e±200.
_SMALL, _LARGE = 2.0**-332, 2.0**332
_LOG_LARGE = 332.0 * math.log(2.0)
_MINIMUM_DETERMINANT = 1e-300  # of I + Λ P, 1 or more but for rounding


class ProposalParameters(NamedTuple):
    """Parameters of association and likelihood.

    gate: largest d² of a match; descriptor_weight: cost per unit of descriptor distance beside d²
    + ln|S|; t2: outlier threshold, squared; information: part (0 to 1) of the information of the
    observations that is used; P (3, 3): covariance of the predicted poses in the vehicle frame.
    """

    gate: float
    descriptor_weight: float
    t2: float
    information: float
    P: Array


class ProposalInputs(NamedTuple):
    """What the proposals of all particles follow from.

    Observations are associated with the covariances of `measured` and count with those of
    `observed`; poses (M, 3): predicted.
    """

    rows: CandidateRows
    measured: Observed
    observed: Observed
    parameters: ProposalParameters
    poses: Array


class Proposals(NamedTuple):
    """Gaussians of the pose errors in the predicted vehicle frames, and likelihoods.

    means (M, 3); covariances (M, 6) packed; log_likelihoods (M,).
    """

    means: Array
    covariances: Array
    log_likelihoods: Array


@kernel
def _associate(  # noqa: PLR0912, C901 - a kernel
    w: Array,
    rows: CandidateRows,
    observed: Observed,
    parameters: ProposalParameters,
    m0: int,
    n: int,
    choice: Choice,
) -> None:  # pragma: no cover - compiled
    """Each particle chooses the gated candidate of smallest d² + ln|S| + descriptor_weight · E.

    Each landmark is chosen for at most one observation.
    """
    slab, addresses, candidates = rows.rows, rows.addresses, rows.candidates
    distances, shared, P = rows.distances, rows.shared, parameters.P
    gate, descriptor_weight = parameters.gate, parameters.descriptor_weight
    scratch, w = w, np.empty((SCRATCH, BLOCK))
    w[:] = scratch
    used = np.zeros((len(addresses), BLOCK), np.bool_)
    p00, p01, p02, p11, p12, p22 = P[0, 0], P[0, 1], P[0, 2], P[1, 1], P[1, 2], P[2, 2]
    for k in range(len(candidates)):
        some = 0
        for j in range(candidates.shape[1]):
            some += candidates[k, j] >= 0
        for i in range(BLOCK):
            w[BEST, i] = np.inf
            w[PICK, i] = -1.0
        for j in range(candidates.shape[1]):
            place = candidates[k, j]
            if place < 0:
                continue
            row = slab[addresses[place]]
            for v in range(9):
                for i in range(n):
                    w[LM + v, i] = row[v, m0 + i]
            expect(w, observed, k)
            for i in range(BLOCK):
                # H P Hᵀ with H = [[-1, 0, zy], [0, -1, -zx], [0, 0, 0]]
                zx, zy = w[ZX, i], w[ZY, i]
                hxx = p00 - 2.0 * zy * p02 + zy * zy * p22
                hxy = p01 + zx * p02 - zy * p12 - zx * zy * p22
                hyy = p11 + 2.0 * zx * p12 + zx * zx * p22
                w[SQ, i], w[DET, i] = mahalanobis_squared(w, hxx, hxy, hyy, i)
            for i in range(n):
                if not (w[LM + 3, i] > 0.0 and w[SQ, i] <= gate):
                    continue
                if shared[place] and used[place, i]:
                    continue
                score = 0.0
                if some > 1:
                    score = w[SQ, i] + math.log(w[DET, i]) + descriptor_weight * distances[k, j]
                if score < w[BEST, i]:
                    w[BEST, i] = score
                    w[PICK, i] = j
        for i in range(n):
            j = int(w[PICK, i])
            choice[k, m0 + i] = j
            if j >= 0 and shared[candidates[k, j]]:
                used[candidates[k, j], i] = True


@kernel(inline='always')
def _accumulate(
    w: Array, scale: float, unmatched: float, t2: float
) -> None:  # pragma: no cover - compiled
    """Add the loaded observation to η, Λ and the cost; scale is 1 / |2R|."""
    for i in range(BLOCK):
        cd, sd, zx, zy = w[CD, i], w[SD, i], w[ZX, i], w[ZY, i]
        mask = w[MASK, i]
        weight = w[WEIGHT, i] * mask
        # residual at the predicted pose, as the present linearization has it
        vx = w[VX, i] - cd * w[D0, i] - sd * w[D1, i] + zy * w[D2, i]
        vy = w[VY, i] + sd * w[D0, i] - cd * w[D1, i] - zx * w[D2, i]
        vz = w[VZ, i]
        wxx, wxy, wxz = weight * w[W, i], weight * w[W + 1, i], weight * w[W + 2, i]
        wyy, wyz, wzz = weight * w[W + 3, i], weight * w[W + 4, i], weight * w[W + 5, i]
        gx = wxx * vx + wxy * vy + wxz * vz
        gy = wxy * vx + wyy * vy + wyz * vz
        gz = wxz * vx + wyz * vy + wzz * vz
        w[COST, i] += gx * vx + gy * vy + gz * vz + (1.0 - mask) * unmatched
        product = w[PRODUCT, i] * (mask * w[DET, i] * scale + (1.0 - mask))
        large, small = product > _LARGE, product < _SMALL
        w[PRODUCT, i] = product * (_SMALL if large else (_LARGE if small else 1.0))
        w[COST, i] += _LOG_LARGE if large else (-_LOG_LARGE if small else 0.0)
        weights = w[WEIGHTS, i] * (mask * w[WEIGHT, i] + (1.0 - mask))
        w[WEIGHTS, i] = weights * (_LARGE if weights < _SMALL else 1.0)
        w[COST, i] += t2 * _LOG_LARGE if weights < _SMALL else 0.0
        # rows of H in the predicted frame: [-cd, -sd, zy], [sd, -cd, -zx], 0
        w[ETA, i] += sd * gy - cd * gx
        w[ETA + 1, i] -= sd * gx + cd * gy
        w[ETA + 2, i] += zy * gx - zx * gy
        a0, b0 = sd * wxy - cd * wxx, sd * wyy - cd * wxy
        a1, b1 = -sd * wxx - cd * wxy, -sd * wxy - cd * wyy
        a2, b2 = zy * wxx - zx * wxy, zy * wxy - zx * wyy
        w[LAMBDA, i] += sd * b0 - cd * a0
        w[LAMBDA + 1, i] -= sd * a0 + cd * b0
        w[LAMBDA + 2, i] += zy * a0 - zx * b0
        w[LAMBDA + 3, i] -= sd * a1 + cd * b1
        w[LAMBDA + 4, i] += zy * a1 - zx * b1
        w[LAMBDA + 5, i] += zy * a2 - zx * b2


@kernel
def _accumulate_all(
    w: Array,
    inputs: ProposalInputs,
    scales: Array,
    reweighted: bool,
    m0: int,
    n: int,
    chosen: Associations,
) -> Array:  # pragma: no cover - compiled
    """Sum η, Λ and the cost over all observations; return the scratch array.

    Unmatched observations cost as much as a residual at the gate.
    """
    rows, observed, t2 = inputs.rows, inputs.observed, inputs.parameters.t2
    choice, robust_weight = chosen.choice, chosen.robust_weight
    unmatched = robust_cost(inputs.parameters.gate, t2)
    scratch, w = w, np.empty((SCRATCH, BLOCK))
    w[:] = scratch
    for i in range(BLOCK):
        for v in range(9):
            w[ETA + v, i] = 0.0
        w[COST, i] = 0.0
        w[PRODUCT, i] = w[WEIGHTS, i] = w[WEIGHT, i] = 1.0
    for k in range(len(scales)):
        if not load(w, rows, choice, k, m0, n):
            for i in range(BLOCK):
                w[COST, i] += unmatched
            continue
        expect(w, observed, k)
        invert(w)
        if reweighted:
            reweight(w, t2)
            for i in range(n):
                robust_weight[k, m0 + i] = w[WEIGHT, i]
        _accumulate(w, scales[k], unmatched, t2)
    for i in range(BLOCK):
        w[COST, i] += math.log(w[PRODUCT, i]) - t2 * math.log(w[WEIGHTS, i])
    return w


@kernel
def _solve_block(
    w: Array, poses: Array, parameters: ProposalParameters, m0: int, n: int
) -> None:  # pragma: no cover - compiled
    """Set δ, Q and the pose to linearize at next; COST becomes −2 ln of the likelihood."""
    P, information = parameters.P, parameters.information
    L, Qm = np.empty((3, 3)), np.empty((3, 3))
    eta, delta = np.empty(3), np.empty(3)
    for i in range(n):
        L[0, 0], L[0, 1], L[0, 2] = w[LAMBDA, i], w[LAMBDA + 1, i], w[LAMBDA + 2, i]
        L[1, 0], L[1, 1], L[1, 2] = L[0, 1], w[LAMBDA + 3, i], w[LAMBDA + 4, i]
        L[2, 0], L[2, 1], L[2, 2] = L[0, 2], L[1, 2], w[LAMBDA + 5, i]
        for a in range(3):
            eta[a] = w[ETA + a, i]
        L *= information
        eta *= information
        w[COST, i] *= information
        determinant, quad = solve(P, L, eta, delta, Qm)
        w[COST, i] += math.log(max(determinant, _MINIMUM_DETERMINANT)) - quad
        w[Q, i], w[Q + 1, i], w[Q + 2, i] = Qm[0, 0], Qm[0, 1], Qm[0, 2]
        w[Q + 3, i], w[Q + 4, i], w[Q + 5, i] = Qm[1, 1], Qm[1, 2], Qm[2, 2]
        _linearize(w, poses, delta, m0, i)


@kernel
def _linearize(
    w: Array, poses: Array, delta: Array, m0: int, i: int
) -> None:  # pragma: no cover - compiled
    """Set the pose of column i to linearize at: the prediction moved by delta (3,)."""
    x, y, heading = poses[m0 + i, 0], poses[m0 + i, 1], poses[m0 + i, 2]
    c, s = math.cos(heading), math.sin(heading)
    cd, sd = math.cos(delta[2]), math.sin(delta[2])
    w[PX, i] = x + c * delta[0] - s * delta[1]
    w[PY, i] = y + s * delta[0] + c * delta[1]
    w[COS, i], w[SIN, i] = c * cd - s * sd, s * cd + c * sd
    w[CD, i], w[SD, i] = cd, sd
    w[D0, i], w[D1, i], w[D2, i] = delta[0], delta[1], delta[2]


@kernel
def sample_proposals(
    means: Array, covariances: Array, normals: Array, poses: Array
) -> None:  # pragma: no cover - compiled
    """Move predicted poses (M, 3) in place to samples of their proposals.

    means (M, 3) and covariances (M, 6) as in Proposals; normals (M, 3).
    """
    delta, covariance = np.empty(3), np.empty((3, 3))
    for m in range(len(poses)):
        delta[:] = means[m]
        for a in range(3):
            covariance[0, a] = covariances[m, a]
            covariance[a, 0] = covariances[m, a]
        covariance[1, 1], covariance[2, 2] = covariances[m, 3], covariances[m, 5]
        covariance[1, 2] = covariance[2, 1] = covariances[m, 4]
        sample_gaussian(covariance, normals[m], delta)
        c, s = math.cos(poses[m, 2]), math.sin(poses[m, 2])
        poses[m, 0] += c * delta[0] - s * delta[1]
        poses[m, 1] += s * delta[0] + c * delta[1]
        poses[m, 2] += delta[2]


@kernel
def propose(
    inputs: ProposalInputs, begin: int, end: int, proposals: Proposals, chosen: Associations
) -> None:  # pragma: no cover - compiled
    """Associate and set the proposals of particles begin … end.

    choice and robust_weight of `chosen` are set; log_likelihoods are added to.
    """
    parameters, poses, R = inputs.parameters, inputs.poses, inputs.observed.R
    scales = np.empty(len(R))
    for k in range(len(R)):
        a = R[k, 3] * R[k, 5] - R[k, 4] * R[k, 4]
        b = R[k, 2] * R[k, 4] - R[k, 1] * R[k, 5]
        d = R[k, 1] * R[k, 4] - R[k, 2] * R[k, 3]
        scales[k] = 1.0 / (8.0 * (R[k, 0] * a + R[k, 1] * b + R[k, 2] * d))
    zero = np.zeros(3)
    for m0 in range(begin, end, BLOCK):
        n = min(BLOCK, end - m0)
        w = np.zeros((SCRATCH, BLOCK))
        for i in range(BLOCK):
            for v in (S, S + 3, S + 5, LM + 3, LM + 6, LM + 8):
                w[v, i] = 1.0
        for i in range(n):
            _linearize(w, poses, zero, m0, i)
        _associate(w, inputs.rows, inputs.measured, parameters, m0, n, chosen.choice)
        for reweighted in (False, True):
            w = _accumulate_all(w, inputs, scales, reweighted, m0, n, chosen)
            _solve_block(w, poses, parameters, m0, n)
        for i in range(n):
            for v in range(3):
                proposals.means[m0 + i, v] = w[D0 + v, i]
            for v in range(6):
                proposals.covariances[m0 + i, v] = w[Q + v, i]
            proposals.log_likelihoods[m0 + i] -= 0.5 * w[COST, i]
