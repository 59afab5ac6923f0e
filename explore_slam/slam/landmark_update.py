"""Extended Kalman filters of landmarks, given the pose of each particle (closed form, 3 × 3)."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from explore_slam.geometry import Array
from explore_slam.slam.association import Choice, Locals, inverse, seen_covariance


@njit(cache=True, nogil=True)
def update_landmarks(
    slab: Array,
    slots: Locals,
    candidates: Locals,
    choice: Choice,
    z: Array,
    R: Array,
    influence: Array,
    poses: Array,
) -> None:  # pragma: no cover - compiled
    """Update in place the landmark that each particle has chosen for each observation.

    influence (K, M): an observation of weight w counts with the covariance R / w.
    """
    K, M = choice.shape
    for k in range(K):
        for m in range(M):
            if choice[k, m] < 0 or influence[k, m] <= 0.0:
                continue
            row = slab[slots[candidates[k, choice[k, m]]]]
            c, s = math.cos(poses[m, 2]), math.sin(poses[m, 2])
            dx, dy = row[0, m] - poses[m, 0], row[1, m] - poses[m, 1]
            vx = z[k, 0] - (c * dx + s * dy)
            vy = z[k, 1] - (c * dy - s * dx)
            vz = z[k, 2] - row[2, m]
            axx, axy, axz, ayy, ayz, azz = seen_covariance(
                c, s, row[3, m], row[4, m], row[5, m], row[6, m], row[7, m], row[8, m]
            )
            r = 1.0 / influence[k, m]
            w = inverse(
                axx + r * R[k, 0], axy + r * R[k, 1], axz + r * R[k, 2], ayy + r * R[k, 3],
                ayz + r * R[k, 4], azz + r * R[k, 5],
            )  # fmt: skip
            # K = A W in the vehicle frame; Σ⁺ = A - K A
            kxx = axx * w[0] + axy * w[1] + axz * w[2]
            kxy = axx * w[1] + axy * w[3] + axz * w[4]
            kxz = axx * w[2] + axy * w[4] + axz * w[5]
            kyx = axy * w[0] + ayy * w[1] + ayz * w[2]
            kyy = axy * w[1] + ayy * w[3] + ayz * w[4]
            kyz = axy * w[2] + ayy * w[4] + ayz * w[5]
            kzx = axz * w[0] + ayz * w[1] + azz * w[2]
            kzy = axz * w[1] + ayz * w[3] + azz * w[4]
            kzz = axz * w[2] + ayz * w[4] + azz * w[5]
            gx = kxx * vx + kxy * vy + kxz * vz
            gy = kyx * vx + kyy * vy + kyz * vz
            row[0, m] += c * gx - s * gy
            row[1, m] += s * gx + c * gy
            row[2, m] += kzx * vx + kzy * vy + kzz * vz
            bxx = axx - (kxx * axx + kxy * axy + kxz * axz)
            bxy = axy - (kxx * axy + kxy * ayy + kxz * ayz)
            bxz = axz - (kxx * axz + kxy * ayz + kxz * azz)
            byy = ayy - (kyx * axy + kyy * ayy + kyz * ayz)
            byz = ayz - (kyx * axz + kyy * ayz + kyz * azz)
            bzz = azz - (kzx * axz + kzy * ayz + kzz * azz)
            oxx, oxy, oxz, oyy, oyz, ozz = seen_covariance(c, -s, bxx, bxy, bxz, byy, byz, bzz)
            row[3, m], row[4, m], row[5, m] = oxx, oxy, oxz
            row[6, m], row[7, m], row[8, m] = oyy, oyz, ozz


@njit(cache=True, nogil=True)
def insert_landmarks(
    slab: Array,
    slots: Locals,
    z: Array,
    R: Array,
    where: NDArray[np.bool_],
    poses: Array,
) -> None:  # pragma: no cover - compiled
    """Write new landmarks (n slots) at observations z (n, 3), R (n, 6) in particles where (n, M)."""
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
