"""Per-particle association: each particle takes the likeliest gated candidate of an observation.

Rows of landmarks are (slots, 9, M): mean x y z, then covariance xx xy xz yy yz zz in the map
frame; a variance xx <= 0 says that the landmark does not exist in that particle. Symmetric 3 × 3
matrices are six numbers in that order throughout.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from explore_slam.geometry import Array

Choice = NDArray[np.int16]
Locals = NDArray[np.int64]
Six = tuple[float, float, float, float, float, float]


@njit(cache=True, nogil=True, inline='always')
def seen_covariance(
    c: float, s: float, xx: float, xy: float, xz: float, yy: float, yz: float, zz: float
) -> Six:  # pragma: no cover - compiled
    """Rotate a covariance of the map into the frame of a vehicle with heading cos c, sin s."""
    cc, cs, ss = c * c, c * s, s * s
    return (
        cc * xx + 2.0 * cs * xy + ss * yy,
        cs * (yy - xx) + (cc - ss) * xy,
        c * xz + s * yz,
        ss * xx - 2.0 * cs * xy + cc * yy,
        c * yz - s * xz,
        zz,
    )


@njit(cache=True, nogil=True, inline='always')
def inverse(
    xx: float, xy: float, xz: float, yy: float, yz: float, zz: float
) -> tuple[float, float, float, float, float, float, float]:  # pragma: no cover - compiled
    """Return the inverse of a symmetric matrix, and its determinant last."""
    a = yy * zz - yz * yz
    b = xz * yz - xy * zz
    d = xy * yz - xz * yy
    determinant = xx * a + xy * b + xz * d
    r = 1.0 / determinant
    return (
        r * a,
        r * b,
        r * d,
        r * (xx * zz - xz * xz),
        r * (xy * xz - xx * yz),
        r * (xx * yy - xy * xy),
        determinant,
    )


@njit(cache=True, nogil=True, inline='always')
def quadratic(
    w: tuple[float, float, float, float, float, float, float], x: float, y: float, z: float
) -> float:  # pragma: no cover - compiled
    """Return vᵀ W v."""
    return (
        w[0] * x * x
        + w[3] * y * y
        + w[5] * z * z
        + 2.0 * (w[1] * x * y + w[2] * x * z + w[4] * y * z)
    )


@njit(cache=True, nogil=True)
def associate(
    slab: Array,
    slots: Locals,
    candidates: Locals,
    distances: Array,
    z: Array,
    R: Array,
    poses: Array,
    P: Array,
    gate: float,
    descriptor_weight: float,
    paper: bool,
    choice: Choice,
    quality: Array,
) -> None:  # pragma: no cover - compiled
    """Fill choice (K, M) with the number of the candidate taken, or -1; quality (K, M) with d².

    candidates (K, J) are places in slots, or -1; distances (K, J) descriptor distances; z (K, 3)
    and R (K, 6) in the vehicle frame; poses (M, 3) predicted; P (3, 3) their covariance in the
    vehicle frame. Engine paper: the nearest descriptor among the gated (argmin E, section III),
    else the least d² + ln|S| + descriptor_weight · E. A landmark serves one observation.
    """
    K, J = candidates.shape
    for m in range(len(poses)):
        px, py = poses[m, 0], poses[m, 1]
        c, s = math.cos(poses[m, 2]), math.sin(poses[m, 2])
        for k in range(K):
            best = np.inf
            choice[k, m] = -1
            quality[k, m] = np.inf
            for j in range(J):
                local = candidates[k, j]
                if local < 0:
                    continue
                row = slab[slots[local]]
                if row[3, m] <= 0.0:
                    continue
                taken = False
                for other in range(k):
                    taken_by = choice[other, m]
                    if taken_by >= 0 and candidates[other, taken_by] == local:
                        taken = True
                        break
                if taken:
                    continue
                dx, dy = row[0, m] - px, row[1, m] - py
                zx, zy = c * dx + s * dy, c * dy - s * dx
                sxx, sxy, sxz, syy, syz, szz = seen_covariance(
                    c, s, row[3, m], row[4, m], row[5, m], row[6, m], row[7, m], row[8, m]
                )
                # S = H P Hᵀ + Σ + R with H = [[-1, 0, zy], [0, -1, -zx], [0, 0, 0]]
                sxx += P[0, 0] - 2.0 * zy * P[0, 2] + zy * zy * P[2, 2] + R[k, 0]
                sxy += P[0, 1] + zx * P[0, 2] - zy * P[1, 2] - zx * zy * P[2, 2] + R[k, 1]
                syy += P[1, 1] + 2.0 * zx * P[1, 2] + zx * zx * P[2, 2] + R[k, 3]
                w = inverse(sxx, sxy, sxz + R[k, 2], syy, syz + R[k, 4], szz + R[k, 5])
                square = quadratic(w, z[k, 0] - zx, z[k, 1] - zy, z[k, 2] - row[2, m])
                if not square <= gate:
                    continue
                if paper:
                    score = distances[k, j]
                else:
                    score = square + math.log(w[6]) + descriptor_weight * distances[k, j]
                if score < best or (score == best and square < quality[k, m]):
                    best = score
                    choice[k, m] = j
                    quality[k, m] = square
