"""FastSLAM 2.0 for blocks of particles: association, pose proposal, likelihood, landmark filters.

For one particle, with δ the pose error in the predicted vehicle frame, δ ~ N(0, P), and the
observations z = h + H δ + noise of covariance S = Σ + R: Λ = Σ Hᵀ S⁻¹ H, η = Σ Hᵀ S⁻¹ ν,
posterior covariance (P⁻¹ + Λ)⁻¹ = P (I + Λ P)⁻¹ (also for singular P) and mean P (I + Λ P)⁻¹ η.
The solution is iterated once: residuals are judged where the first solution lies, by their
studentized length d, and lose influence beyond the outlier threshold t, w = t² / d²: the
likelihood has a heavy tail and no single observation decides over a particle.

Particles are worked off in blocks whose numbers lie in one scratch array, a row per quantity and
a column per particle: the compiler turns loops over columns into vector instructions, and the
landmark rows of a block stay in the cache from the association to the update. Particles do not
depend on each other, so any split into blocks and threads gives the same bits.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from explore_slam.geometry import Array
from explore_slam.slam.association import Choice, Locals
from explore_slam.slam.gaussian import sample_gaussian, solve

BLOCK = 64

# Rows of the scratch array.
PX, PY, COS, SIN = 0, 1, 2, 3  # pose at which to linearize
CD, SD, D0, D1, D2 = 4, 5, 6, 7, 8  # cos, sin of its turn, and δ, since the prediction
LM = 9  # landmark mean 9…11, covariance 12…17
ZX, ZY, VX, VY, VZ = 18, 19, 20, 21, 22  # expected x, y; residual
S = 23  # covariance of the residual, 23…28
W = 29  # its inverse, 29…34
DET = 35  # its determinant
SQ = 36  # squared length of the residual
MASK = 37  # 1 where the particle has a landmark for the observation, else 0
ETA = 38  # η, 38…40
LAMBDA = 41  # Λ: 00 01 02 11 12 22, 41…46
COST = 47  # Σ w νᵀ S⁻¹ ν + what is unmatched
PRODUCT, WEIGHTS = 48, 49  # Π |S| / |2R| and Π w, taken to COST before they run out of range
Q = 50  # posterior covariance 00 01 02 11 12 22, 50…55
WEIGHT = 56  # w
BEST, PICK = 57, 58  # least score so far and its candidate
SCRATCH = 59


@njit(cache=True, nogil=True, error_model='numpy', inline='always')
def _load(w, slab, slots, candidates, choice, k, m0, n):  # type: ignore[no-untyped-def]
    """Load the landmark that each particle has chosen for observation k, and the mask."""
    first, having, taking = -1, 0, 0
    for i in range(n):
        first = max(first, choice[k, m0 + i])
    for i in range(n):
        j = choice[k, m0 + i]
        having += 1 if j >= 0 else 0
        taking += 1 if j == first else 0
        w[MASK, i] = 1.0 if j >= 0 else 0.0
    if first >= 0:
        row = slab[slots[candidates[k, first]]]
        for v in range(9):
            for i in range(n):
                w[LM + v, i] = row[v, m0 + i]
        if taking < having:
            for i in range(n):
                j = choice[k, m0 + i]
                if j >= 0:
                    for v in range(9):
                        w[LM + v, i] = slab[slots[candidates[k, j]], v, m0 + i]
    return first >= 0


@njit(cache=True, nogil=True, error_model='numpy', inline='always')
def _expect(w, z, R, k):  # type: ignore[no-untyped-def]
    """Set expected observation, residual and S = Σ + R in the vehicle frame."""
    z0, z1, z2 = z[k, 0], z[k, 1], z[k, 2]
    r0, r1, r2, r3, r4, r5 = R[k, 0], R[k, 1], R[k, 2], R[k, 3], R[k, 4], R[k, 5]
    for i in range(BLOCK):
        c, s = w[COS, i], w[SIN, i]
        dx, dy = w[LM, i] - w[PX, i], w[LM + 1, i] - w[PY, i]
        zx, zy = c * dx + s * dy, c * dy - s * dx
        w[ZX, i], w[ZY, i] = zx, zy
        w[VX, i], w[VY, i], w[VZ, i] = z0 - zx, z1 - zy, z2 - w[LM + 2, i]
        xx, xy, xz = w[LM + 3, i], w[LM + 4, i], w[LM + 5, i]
        yy, yz = w[LM + 6, i], w[LM + 7, i]
        cc, cs, ss = c * c, c * s, s * s
        w[S, i] = cc * xx + 2.0 * cs * xy + ss * yy + r0
        w[S + 1, i] = cs * (yy - xx) + (cc - ss) * xy + r1
        w[S + 2, i] = c * xz + s * yz + r2
        w[S + 3, i] = ss * xx - 2.0 * cs * xy + cc * yy + r3
        w[S + 4, i] = c * yz - s * xz + r4
        w[S + 5, i] = w[LM + 8, i] + r5


@njit(cache=True, nogil=True, error_model='numpy', inline='always')
def _measure(w, hxx, hxy, hyy, i):  # type: ignore[no-untyped-def]
    """Return νᵀ (S + h)⁻¹ ν and |S + h| of column i, h added to the x, y part of S."""
    xx, xy, xz = w[S, i] + hxx, w[S + 1, i] + hxy, w[S + 2, i]
    yy, yz, zz = w[S + 3, i] + hyy, w[S + 4, i], w[S + 5, i]
    a, b, d = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    determinant = xx * a + xy * b + xz * d
    vx, vy, vz = w[VX, i], w[VY, i], w[VZ, i]
    square = (
        a * vx * vx
        + (xx * zz - xz * xz) * vy * vy
        + (xx * yy - xy * xy) * vz * vz
        + 2.0 * (b * vx * vy + d * vx * vz + (xy * xz - xx * yz) * vy * vz)
    )
    return square / determinant, determinant


@njit(cache=True, nogil=True, error_model='numpy', inline='always')
def _invert(w):  # type: ignore[no-untyped-def]
    """Set W = S⁻¹ and |S|."""
    for i in range(BLOCK):
        xx, xy, xz = w[S, i], w[S + 1, i], w[S + 2, i]
        yy, yz, zz = w[S + 3, i], w[S + 4, i], w[S + 5, i]
        a, b, d = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        determinant = xx * a + xy * b + xz * d
        r = 1.0 / determinant
        w[DET, i] = determinant
        w[W, i], w[W + 1, i], w[W + 2, i] = r * a, r * b, r * d
        w[W + 3, i] = r * (xx * zz - xz * xz)
        w[W + 4, i] = r * (xy * xz - xx * yz)
        w[W + 5, i] = r * (xx * yy - xy * xy)


@njit(cache=True, nogil=True, error_model='numpy')
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
            _expect(w, z, R, k)
            for i in range(BLOCK):
                # H P Hᵀ with H = [[-1, 0, zy], [0, -1, -zx], [0, 0, 0]]
                zx, zy = w[ZX, i], w[ZY, i]
                hxx = p00 - 2.0 * zy * p02 + zy * zy * p22
                hxy = p01 + zx * p02 - zy * p12 - zx * zy * p22
                hyy = p11 + 2.0 * zx * p12 + zx * zx * p22
                w[SQ, i], w[DET, i] = _measure(w, hxx, hxy, hyy, i)
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


@njit(cache=True, nogil=True, error_model='numpy', inline='always')
def _judge(w, t2):  # type: ignore[no-untyped-def]
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
        studentized, determinant = _measure(w, -hxx, -hxy, -hyy, i)
        plain, _ = _measure(w, 0.0, 0.0, 0.0, i)
        square = studentized if determinant > 0.0 and studentized > plain else plain
        w[WEIGHT, i] = t2 / square if square > t2 else 1.0


@njit(cache=True, nogil=True, error_model='numpy', inline='always')
def _gather(w, scale, unmatched):  # type: ignore[no-untyped-def]
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


@njit(cache=True, nogil=True, error_model='numpy')
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
        if not _load(w, slab, slots, candidates, choice, k, m0, n):
            for i in range(BLOCK):
                w[COST, i] += unmatched
            continue
        _expect(w, z, R, k)
        _invert(w)
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


@njit(cache=True, nogil=True, error_model='numpy')
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


@njit(cache=True, nogil=True, error_model='numpy')
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


@njit(cache=True, nogil=True, error_model='numpy')
def _sample_block(
    w: Array, poses: Array, normals: Array, log_weights: Array, m0: int, n: int, Qm: Array
) -> None:  # pragma: no cover - compiled
    """Replace the predicted poses by samples of the proposals; add the log likelihoods."""
    delta = np.empty(3)
    for i in range(n):
        Qm[0, 0], Qm[0, 1], Qm[0, 2] = w[Q, i], w[Q + 1, i], w[Q + 2, i]
        Qm[1, 0], Qm[1, 1], Qm[1, 2] = w[Q + 1, i], w[Q + 3, i], w[Q + 4, i]
        Qm[2, 0], Qm[2, 1], Qm[2, 2] = w[Q + 2, i], w[Q + 4, i], w[Q + 5, i]
        delta[0], delta[1], delta[2] = w[D0, i], w[D1, i], w[D2, i]
        sample_gaussian(Qm, normals[m0 + i], delta)
        _linearize(w, poses, delta, m0, i)
        heading = poses[m0 + i, 2] + delta[2]
        poses[m0 + i, 0], poses[m0 + i, 1], poses[m0 + i, 2] = w[PX, i], w[PY, i], heading
        log_weights[m0 + i] -= 0.5 * w[COST, i]


@njit(cache=True, nogil=True, error_model='numpy')
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
    normals: Array,
    begin: int,
    end: int,
    poses: Array,
    log_weights: Array,
    choice: Choice,
    influence: Array,
) -> None:  # pragma: no cover - compiled
    """Associate, and move particles begin … end of poses (M, 3) to samples of their proposals.

    slab, slots, candidates (K, J), distances (K, J), z (K, 3), R (K, 6) as in `association`;
    shared (L,) landmarks that are candidates of several observations; P (3, 3) of the predicted
    poses in the vehicle frame. What is observed counts with the share (0 to 1) of its
    information. log_weights (M,) gains the likelihoods; choice and influence
    (K, M) receive candidate and w. Unmatched counts like a residual at the gate.
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
        _sample_block(w, poses, normals, log_weights, m0, n, Qm)
