"""FastSLAM 2.0 for blocks of particles: association, pose proposal, likelihood.

For one particle, with δ the pose error in the predicted vehicle frame, δ ~ N(0, P), and the
observations z = h + H δ + noise of covariance S = Σ + R: Λ = Σ Hᵀ S⁻¹ H, η = Σ Hᵀ S⁻¹ ν,
posterior covariance (P⁻¹ + Λ)⁻¹ = P (I + Λ P)⁻¹ (also for singular P) and mean P (I + Λ P)⁻¹ η.
The solution is iterated once: residuals are judged where the first solution lies, by their
studentized length d, and lose influence beyond the outlier threshold t, w = t² / d²: the
likelihood has a heavy tail and no single observation decides over a particle.

The likelihood does not depend on the sample that is drawn from the proposal. So a resampling comes
before the sampling: the descendants of one particle go on from poses of their own.

Particles do not depend on each other, so any split into blocks and threads gives the same bits.
"""

import math

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.geometry import Array
from explore_slam.slam.association.gating import Choice, Locals
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
    measure,
)  # fmt: skip
from explore_slam.slam.update.gaussian import sample_gaussian, solve


@kernel
def _associate(  # noqa: PLR0912, C901 - a kernel
    w: Array,
    slab: Array,
    slots: Locals,
    candidates: Locals,
    distances: Array,
    shared: NDArray[np.bool_],
    z: Array,
    R: Array,
    P: Array,
    gate: float,
    likeness: float,
    m0: int,
    n: int,
    choice: Choice,
) -> None:  # pragma: no cover - compiled
    """Each particle takes the gated candidate of least d² + ln|S| + likeness · E."""
    scratch, w = w, np.empty((SCRATCH, BLOCK))
    w[:] = scratch
    used = np.zeros((len(slots), BLOCK), np.bool_)
    p00, p01, p02, p11, p12, p22 = P[0, 0], P[0, 1], P[0, 2], P[1, 1], P[1, 2], P[2, 2]
    for k in range(len(candidates)):
        some = 0
        for j in range(candidates.shape[1]):
            some += candidates[k, j] >= 0
        for i in range(BLOCK):
            w[BEST, i] = np.inf
            w[PICK, i] = -1.0
        for j in range(candidates.shape[1]):
            local = candidates[k, j]
            if local < 0:
                continue
            row = slab[slots[local]]
            for v in range(9):
                for i in range(n):
                    w[LM + v, i] = row[v, m0 + i]
            expect(w, z, R, k)
            for i in range(BLOCK):
                # H P Hᵀ with H = [[-1, 0, zy], [0, -1, -zx], [0, 0, 0]]
                zx, zy = w[ZX, i], w[ZY, i]
                hxx = p00 - 2.0 * zy * p02 + zy * zy * p22
                hxy = p01 + zx * p02 - zy * p12 - zx * zy * p22
                hyy = p11 + 2.0 * zx * p12 + zx * zx * p22
                w[SQ, i], w[DET, i] = measure(w, hxx, hxy, hyy, i)
            for i in range(n):
                if not (w[LM + 3, i] > 0.0 and w[SQ, i] <= gate):
                    continue
                if shared[local] and used[local, i]:
                    continue
                score = 0.0
                if some > 1:
                    score = w[SQ, i] + math.log(w[DET, i]) + likeness * distances[k, j]
                if score < w[BEST, i]:
                    w[BEST, i] = score
                    w[PICK, i] = j
        for i in range(n):
            j = int(w[PICK, i])
            choice[k, m0 + i] = j
            if j >= 0 and shared[candidates[k, j]]:
                used[candidates[k, j], i] = True


@kernel(inline='always')
def _judge(w: Array, t2: float) -> None:  # pragma: no cover - compiled
    """Set w by the studentized residual, of covariance S − H Q Hᵀ, at the present solution."""
    for i in range(BLOCK):
        cd, sd, zx, zy = w[CD, i], w[SD, i], w[ZX, i], w[ZY, i]
        q00, q01, q02 = w[Q, i], w[Q + 1, i], w[Q + 2, i]
        q11, q12, q22 = w[Q + 3, i], w[Q + 4, i], w[Q + 5, i]
        a0 = -cd * q00 - sd * q01 + zy * q02
        a1 = -cd * q01 - sd * q11 + zy * q12
        a2 = -cd * q02 - sd * q12 + zy * q22
        b0 = sd * q00 - cd * q01 - zx * q02
        b1 = sd * q01 - cd * q11 - zx * q12
        b2 = sd * q02 - cd * q12 - zx * q22
        hxx = min(-cd * a0 - sd * a1 + zy * a2, 0.999 * w[S, i])
        hxy = sd * a0 - cd * a1 - zx * a2
        hyy = min(sd * b0 - cd * b1 - zx * b2, 0.999 * w[S + 3, i])
        studentized, determinant = measure(w, -hxx, -hxy, -hyy, i)
        plain, _ = measure(w, 0.0, 0.0, 0.0, i)
        square = studentized if determinant > 0.0 and studentized > plain else plain
        w[WEIGHT, i] = t2 / square if square > t2 else 1.0


@kernel(inline='always')
def _gather(w: Array, scale: float, unmatched: float) -> None:  # pragma: no cover - compiled
    """Add one observation to η, Λ and the cost; scale is 1 / |2R|."""
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
        w[PRODUCT, i] *= mask * w[DET, i] * scale + (1.0 - mask)
        w[WEIGHTS, i] *= mask * w[WEIGHT, i] + (1.0 - mask)
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
def _fold(
    w: Array,
    slab: Array,
    slots: Locals,
    candidates: Locals,
    choice: Choice,
    z: Array,
    R: Array,
    scales: Array,
    unmatched: float,
    t2: float,
    judged: bool,
    m0: int,
    n: int,
    influence: Array,
) -> Array:  # pragma: no cover - compiled
    """Sum η, Λ and the cost over all observations; return the scratch array."""
    scratch, w = w, np.empty((SCRATCH, BLOCK))
    w[:] = scratch
    for i in range(BLOCK):
        for v in range(9):
            w[ETA + v, i] = 0.0
        w[COST, i] = 0.0
        w[PRODUCT, i] = w[WEIGHTS, i] = w[WEIGHT, i] = 1.0
    for k in range(len(candidates)):
        if not load(w, slab, slots, candidates, choice, k, m0, n):
            for i in range(BLOCK):
                w[COST, i] += unmatched
            continue
        expect(w, z, R, k)
        invert(w)
        if judged:
            _judge(w, t2)
            for i in range(n):
                influence[k, m0 + i] = w[WEIGHT, i]
        _gather(w, scales[k], unmatched)
        if k % 32 == 31:
            for i in range(BLOCK):
                w[COST, i] += math.log(w[PRODUCT, i]) - t2 * math.log(w[WEIGHTS, i])
                w[PRODUCT, i] = w[WEIGHTS, i] = 1.0
    for i in range(BLOCK):
        w[COST, i] += math.log(w[PRODUCT, i]) - t2 * math.log(w[WEIGHTS, i])
    return w


@kernel
def _solve_block(
    w: Array, poses: Array, P: Array, m0: int, n: int, L: Array, Qm: Array, share: float
) -> None:  # pragma: no cover - compiled
    """Set δ, Q and the pose at which to linearize next; COST becomes −2 ln of the likelihood."""
    eta, delta = np.empty(3), np.empty(3)
    for i in range(n):
        L[0, 0], L[0, 1], L[0, 2] = w[LAMBDA, i], w[LAMBDA + 1, i], w[LAMBDA + 2, i]
        L[1, 0], L[1, 1], L[1, 2] = L[0, 1], w[LAMBDA + 3, i], w[LAMBDA + 4, i]
        L[2, 0], L[2, 1], L[2, 2] = L[0, 2], L[1, 2], w[LAMBDA + 5, i]
        for a in range(3):
            eta[a] = w[ETA + a, i]
        L *= share
        eta *= share
        w[COST, i] *= share
        determinant, quad = solve(P, L, eta, delta, Qm)
        w[COST, i] += math.log(max(determinant, 1e-300)) - quad
        w[Q, i], w[Q + 1, i], w[Q + 2, i] = Qm[0, 0], Qm[0, 1], Qm[0, 2]
        w[Q + 3, i], w[Q + 4, i], w[Q + 5, i] = Qm[1, 1], Qm[1, 2], Qm[2, 2]
        _linearize(w, poses, delta, m0, i)


@kernel
def _linearize(
    w: Array, poses: Array, delta: Array, m0: int, i: int
) -> None:  # pragma: no cover - compiled
    """Set the pose of column i to the prediction moved by delta (3,)."""
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
    centers: Array, spreads: Array, normals: Array, begin: int, end: int, poses: Array
) -> None:  # pragma: no cover - compiled
    """Move predicted poses begin … end of (M, 3) in place to samples of their proposals.

    centers (M, 3) and spreads (M, 6), the covariances, in the predicted vehicle frames; normals
    (M, 3).
    """
    delta, spread = np.empty(3), np.empty((3, 3))
    for m in range(begin, end):
        delta[:] = centers[m]
        spread[0, 0], spread[0, 1], spread[0, 2] = spreads[m, 0], spreads[m, 1], spreads[m, 2]
        spread[1, 0], spread[1, 1], spread[1, 2] = spreads[m, 1], spreads[m, 3], spreads[m, 4]
        spread[2, 0], spread[2, 1], spread[2, 2] = spreads[m, 2], spreads[m, 4], spreads[m, 5]
        sample_gaussian(spread, normals[m], delta)
        c, s = math.cos(poses[m, 2]), math.sin(poses[m, 2])
        poses[m, 0] += c * delta[0] - s * delta[1]
        poses[m, 1] += s * delta[0] + c * delta[1]
        poses[m, 2] += delta[2]


@kernel
def propose(
    slab: Array,
    slots: Locals,
    candidates: Locals,
    distances: Array,
    shared: NDArray[np.bool_],
    z: Array,
    R: Array,
    P: Array,
    gate: float,
    likeness: float,
    threshold: float,
    share: float,
    begin: int,
    end: int,
    poses: Array,
    centers: Array,
    spreads: Array,
    log_weights: Array,
    choice: Choice,
    influence: Array,
) -> None:  # pragma: no cover - compiled
    """Associate, and find the proposals of particles begin … end, whose predictions are poses.

    slab, slots, candidates (K, J), distances (K, J), z (K, 3), R (K, 6) as in `association`;
    shared (L,) landmarks that are candidates of several observations; P (3, 3) of the predicted
    poses in the vehicle frame. What is observed counts with the share (0 to 1) of its
    information. log_weights (M,) gains the likelihoods; choice and influence
    (K, M) receive candidate and w. Unmatched counts like a residual at the gate. centers (M, 3)
    and spreads (M, 6) receive mean and covariance of the pose error, see `sample_proposals`.
    """
    t2 = threshold * threshold
    unmatched = t2 * (1.0 + math.log(max(gate / t2, 1.0)))
    scales = np.empty(len(candidates))
    for k in range(len(candidates)):
        a = R[k, 3] * R[k, 5] - R[k, 4] * R[k, 4]
        b = R[k, 2] * R[k, 4] - R[k, 1] * R[k, 5]
        d = R[k, 1] * R[k, 4] - R[k, 2] * R[k, 3]
        scales[k] = 1.0 / (8.0 * (R[k, 0] * a + R[k, 1] * b + R[k, 2] * d))
    L, Qm, zero = np.empty((3, 3)), np.empty((3, 3)), np.zeros(3)
    for m0 in range(begin, end, BLOCK):
        n = min(BLOCK, end - m0)
        w = np.zeros((SCRATCH, BLOCK))
        for i in range(BLOCK):
            for v in (S, S + 3, S + 5, LM + 3, LM + 6, LM + 8):
                w[v, i] = 1.0
        for i in range(n):
            _linearize(w, poses, zero, m0, i)
        _associate(
            w, slab, slots, candidates, distances, shared, z, R, P, gate, likeness, m0, n, choice
        )
        for judged in (False, True):
            w = _fold(
                w, slab, slots, candidates, choice, z, R, scales, unmatched, t2, judged, m0, n,
                influence,
            )  # fmt: skip
            _solve_block(w, poses, P, m0, n, L, Qm, share)
        for i in range(n):
            centers[m0 + i, 0], centers[m0 + i, 1] = w[D0, i], w[D1, i]
            centers[m0 + i, 2] = w[D2, i]
            for v in range(6):
                spreads[m0 + i, v] = w[Q + v, i]
            log_weights[m0 + i] -= 0.5 * w[COST, i]
