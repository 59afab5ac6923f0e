"""Extended Kalman filters of landmarks, given the pose of each particle (closed form, 3 × 3)."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from explore_slam.geometry import Array
from explore_slam.slam.association import Choice, Locals, seen_covariance
from explore_slam.slam.proposal import (
    BLOCK,
    COS,
    LM,
    MASK,
    PX,
    PY,
    SCRATCH,
    SIN,
    VX,
    VY,
    VZ,
    S,
    W,
    _expect,
    _invert,
    _load,
)  # fmt: skip


@njit(cache=True, nogil=True, error_model='numpy', inline='always')
def _correct(w, R, k):  # type: ignore[no-untyped-def]
    """Replace the landmark of each column by its posterior: K = A W, Σ⁺ = A − K A."""
    r0, r1, r2, r3, r4, r5 = R[k, 0], R[k, 1], R[k, 2], R[k, 3], R[k, 4], R[k, 5]
    for i in range(BLOCK):
        axx, axy, axz = w[S, i] - r0, w[S + 1, i] - r1, w[S + 2, i] - r2
        ayy, ayz, azz = w[S + 3, i] - r3, w[S + 4, i] - r4, w[S + 5, i] - r5
        w0, w1, w2 = w[W, i], w[W + 1, i], w[W + 2, i]
        w3, w4, w5 = w[W + 3, i], w[W + 4, i], w[W + 5, i]
        kxx, kxy = axx * w0 + axy * w1 + axz * w2, axx * w1 + axy * w3 + axz * w4
        kxz = axx * w2 + axy * w4 + axz * w5
        kyx, kyy = axy * w0 + ayy * w1 + ayz * w2, axy * w1 + ayy * w3 + ayz * w4
        kyz = axy * w2 + ayy * w4 + ayz * w5
        kzx, kzy = axz * w0 + ayz * w1 + azz * w2, axz * w1 + ayz * w3 + azz * w4
        kzz = axz * w2 + ayz * w4 + azz * w5
        vx, vy, vz = w[VX, i], w[VY, i], w[VZ, i]
        gx, gy = kxx * vx + kxy * vy + kxz * vz, kyx * vx + kyy * vy + kyz * vz
        c, s = w[COS, i], w[SIN, i]
        w[LM, i] += c * gx - s * gy
        w[LM + 1, i] += s * gx + c * gy
        w[LM + 2, i] += kzx * vx + kzy * vy + kzz * vz
        bxx = axx - (kxx * axx + kxy * axy + kxz * axz)
        bxy = axy - (kxx * axy + kxy * ayy + kxz * ayz)
        bxz = axz - (kxx * axz + kxy * ayz + kxz * azz)
        byy = ayy - (kyx * axy + kyy * ayy + kyz * ayz)
        byz = ayz - (kyx * axz + kyy * ayz + kyz * azz)
        cc, cs, ss = c * c, c * s, s * s
        w[LM + 3, i] = cc * bxx - 2.0 * cs * bxy + ss * byy
        w[LM + 4, i] = cs * (bxx - byy) + (cc - ss) * bxy
        w[LM + 5, i] = c * bxz - s * byz
        w[LM + 6, i] = ss * bxx + 2.0 * cs * bxy + cc * byy
        w[LM + 7, i] = c * byz + s * bxz
        w[LM + 8, i] = azz - (kzx * axz + kzy * ayz + kzz * azz)


@njit(cache=True, nogil=True, error_model='numpy')
def update_landmarks(  # noqa: PLR0912, C901 - a kernel
    slab: Array,
    slots: Locals,
    candidates: Locals,
    choice: Choice,
    z: Array,
    R: Array,
    influence: Array,
    poses: Array,
    begin: int,
    end: int,
) -> None:  # pragma: no cover - compiled
    """Update in place, in particles begin … end, the landmark chosen for each observation.

    influence (K, M): an observation of weight w counts with the covariance R / w.
    """
    w = np.empty((SCRATCH, BLOCK))
    for m0 in range(begin, end, BLOCK):
        n = min(BLOCK, end - m0)
        w[:] = 0.0
        for i in range(BLOCK):
            w[LM + 3, i] = w[LM + 6, i] = w[LM + 8, i] = 1.0
        for i in range(n):
            w[PX, i], w[PY, i] = poses[m0 + i, 0], poses[m0 + i, 1]
            w[COS, i], w[SIN, i] = math.cos(poses[m0 + i, 2]), math.sin(poses[m0 + i, 2])
        for k in range(len(candidates)):
            if not _load(w, slab, slots, candidates, choice, k, m0, n):
                continue
            _expect(w, z, R, k)
            for i in range(n):
                if influence[k, m0 + i] < 1.0 and w[MASK, i] > 0.0:
                    more = 1.0 / influence[k, m0 + i] - 1.0
                    for v in range(6):
                        w[S + v, i] += more * R[k, v]
            _invert(w)
            for i in range(n):
                if influence[k, m0 + i] < 1.0 and w[MASK, i] > 0.0:
                    more = 1.0 / influence[k, m0 + i] - 1.0
                    for v in range(6):
                        w[S + v, i] -= more * R[k, v]
            _correct(w, R, k)
            for i in range(n):
                j = choice[k, m0 + i]
                least = min(w[LM + 3, i], w[LM + 6, i], w[LM + 8, i])
                if j >= 0 and least > 0.0 and least < np.inf:
                    slot = slots[candidates[k, j]]
                    for v in range(9):
                        slab[slot, v, m0 + i] = w[LM + v, i]


@njit(cache=True, nogil=True, error_model='numpy')
def insert_landmarks(
    slab: Array,
    slots: Locals,
    z: Array,
    R: Array,
    where: NDArray[np.bool_],
    poses: Array,
) -> None:  # pragma: no cover - compiled
    """Write landmarks (n slots) seen at z (n, 3), R (n, 6) in the particles where (n, M)."""
    for k in range(len(slots)):
        row = slab[slots[k]]
        for m in range(len(poses)):
            if not where[k, m]:
                continue
            c, s = math.cos(poses[m, 2]), math.sin(poses[m, 2])
            row[0, m] = poses[m, 0] + c * z[k, 0] - s * z[k, 1]
            row[1, m] = poses[m, 1] + s * z[k, 0] + c * z[k, 1]
            row[2, m] = z[k, 2]
            row[3, m], row[4, m], row[5, m], row[6, m], row[7, m], row[8, m] = seen_covariance(
                c, -s, R[k, 0], R[k, 1], R[k, 2], R[k, 3], R[k, 4], R[k, 5]
            )
