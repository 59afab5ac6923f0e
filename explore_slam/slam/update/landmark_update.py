"""Extended Kalman filters of landmarks, given the pose of each particle (closed form, 3 × 3).

Steps 2.6.1 (update) and 2.7.1 (insertion) of the paper's algorithm.
"""

import math

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.geometry import Array
from explore_slam.slam.association.state import (
    Associations,
    AssociationState,
    CandidateRows,
    Observed,
)
from explore_slam.slam.storage.row_format import Choice, Places, covariance_in_vehicle_frame
from explore_slam.slam.update.blocks import (
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
    WEIGHT,
    S,
    W,
    count_choices,
    expect,
    invert,
    load,
)
from explore_slam.slam.update.parallel import over_particles

_LARGEST_VARIANCE = 1e300  # m²: beyond it numbers have overflowed
_MINIMUM_WEIGHT = 1e-12  # robust weights are not smaller, so that R / w stays finite


@kernel(inline='always')
def _correct(w: Array, R: Array, k: int) -> None:  # pragma: no cover - compiled
    """Replace the landmark of each column by its posterior: K = A S⁻¹, Σ⁺ = A − K A."""
    r0, r1, r2, r3, r4, r5 = R[k, 0], R[k, 1], R[k, 2], R[k, 3], R[k, 4], R[k, 5]
    for i in range(BLOCK):
        q = w[WEIGHT, i]
        axx, axy, axz = w[S, i] - q * r0, w[S + 1, i] - q * r1, w[S + 2, i] - q * r2
        ayy, ayz, azz = w[S + 3, i] - q * r3, w[S + 4, i] - q * r4, w[S + 5, i] - q * r5
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


@kernel(inline='always')
def _store(
    w: Array, rows: CandidateRows, choice: Choice, k: int, m0: int, n: int
) -> None:  # pragma: no cover - compiled
    """Write back the landmarks of columns that have one, unless numbers overflowed."""
    slab, addresses, candidates = rows.rows, rows.addresses, rows.candidates
    first, having, taking = count_choices(choice, k, m0, n)
    for i in range(n):
        least = min(w[LM + 3, i], w[LM + 6, i], w[LM + 8, i])
        w[MASK, i] = w[MASK, i] if least > 0.0 and least < _LARGEST_VARIANCE else 0.0
    if taking < having:
        for i in range(n):
            if w[MASK, i] > 0.0:
                address = addresses[candidates[k, choice[k, m0 + i]]]
                for v in range(9):
                    slab[address, v, m0 + i] = w[LM + v, i]
    elif first >= 0:
        row = slab[addresses[candidates[k, first]]]
        for v in range(9):
            for i in range(n):
                row[v, m0 + i] = w[LM + v, i] if w[MASK, i] > 0.0 else row[v, m0 + i]


@kernel
def update_landmarks(
    rows: CandidateRows,
    observed: Observed,
    chosen: Associations,
    poses: Array,
    begin: int,
    end: int,
) -> None:  # pragma: no cover - compiled
    """Update in place, in particles begin … end, the landmark chosen for each observation.

    An observation of robust weight w has the covariance R / w.
    """
    R, choice, robust_weight = observed.R, chosen.choice, chosen.robust_weight
    w = np.zeros((SCRATCH, BLOCK))
    for i in range(BLOCK):
        w[LM + 3, i] = w[LM + 6, i] = w[LM + 8, i] = 1.0
    placed = np.empty((4, end - begin))
    for i in range(end - begin):
        placed[0, i], placed[1, i] = poses[begin + i, 0], poses[begin + i, 1]
        placed[2, i], placed[3, i] = math.cos(poses[begin + i, 2]), math.sin(poses[begin + i, 2])
    for k in range(len(R)):
        r0, r1, r2, r3, r4, r5 = R[k, 0], R[k, 1], R[k, 2], R[k, 3], R[k, 4], R[k, 5]
        for m0 in range(begin, end, BLOCK):
            n = min(BLOCK, end - m0)
            if not load(w, rows, choice, k, m0, n):
                continue
            for i in range(n):
                w[PX, i], w[PY, i] = placed[0, m0 - begin + i], placed[1, m0 - begin + i]
                w[COS, i], w[SIN, i] = placed[2, m0 - begin + i], placed[3, m0 - begin + i]
            expect(w, observed, k)
            for i in range(n):
                w[WEIGHT, i] = 1.0 / max(robust_weight[k, m0 + i], _MINIMUM_WEIGHT)
            for i in range(BLOCK):
                more = w[WEIGHT, i] - 1.0
                w[S, i] += more * r0
                w[S + 1, i] += more * r1
                w[S + 2, i] += more * r2
                w[S + 3, i] += more * r3
                w[S + 4, i] += more * r4
                w[S + 5, i] += more * r5
            invert(w)
            _correct(w, R, k)
            _store(w, rows, choice, k, m0, n)


@kernel(inline='always')
def _initialize(
    row: Array, observed: Observed, k: int, poses: Array, m: int
) -> None:  # pragma: no cover - compiled
    """Write the landmark of observation k, as particle m observes it, to a block (9, M)."""
    z, R = observed.z, observed.R
    c, s = math.cos(poses[m, 2]), math.sin(poses[m, 2])
    row[0, m] = poses[m, 0] + c * z[k, 0] - s * z[k, 1]
    row[1, m] = poses[m, 1] + s * z[k, 0] + c * z[k, 1]
    row[2, m] = z[k, 2]
    row[3, m], row[4, m], row[5, m], row[6, m], row[7, m], row[8, m] = covariance_in_vehicle_frame(
        c, -s, R[k, 0], R[k, 1], R[k, 2], R[k, 3], R[k, 4], R[k, 5]
    )


@kernel
def insert_landmarks(
    rows: Array, addresses: Places, observed: Observed, where: NDArray[np.bool_], poses: Array
) -> None:  # pragma: no cover - compiled
    """Write new landmarks, one per observation, to addresses (n,) in particles where (n, M)."""
    for k in range(len(addresses)):
        row = rows[addresses[k]]
        for m in range(len(poses)):
            if where[k, m]:
                _initialize(row, observed, k, poses, m)


@kernel
def fill_absent(
    rows: CandidateRows, observed: Observed, poses: Array, wanted: NDArray[np.bool_]
) -> NDArray[np.bool_]:  # pragma: no cover - compiled
    """Initialize candidates in particles that lack them, instead of inserting new landmarks.

    One feature would otherwise become another landmark for every set of particles. wanted (K, M):
    where an observation needs a new landmark; what is filled is removed from it. Returns (L,)
    which landmarks were initialized in any particle.
    """
    candidates, addresses = rows.candidates, rows.addresses
    K, J = candidates.shape
    M = len(poses)
    used = np.zeros((len(addresses), M), np.bool_)
    filled = np.zeros(len(addresses), np.bool_)
    for k in range(K):
        if not wanted[k].any():
            continue
        for j in range(J):
            place = candidates[k, j]
            if place < 0:
                continue
            row = rows.rows[addresses[place]]
            for m in range(M):
                if wanted[k, m] and row[3, m] <= 0.0 and not used[place, m]:
                    _initialize(row, observed, k, poses, m)
                    used[place, m] = True
                    wanted[k, m] = False
                    filled[place] = True
    return filled


def update_associated(state: AssociationState, poses: Array, threads: int) -> None:
    """Update the Kalman filters of all associated landmarks, given sampled poses (M, 3)."""
    rows, observed, chosen = state.rows(), state.found.observed, state.chosen

    def run(begin: int, end: int) -> None:
        update_landmarks(rows, observed, chosen, poses, begin, end)

    over_particles(run, len(poses), threads)
