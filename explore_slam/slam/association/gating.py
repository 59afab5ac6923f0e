"""Association of engine paper: argmin of the descriptor distance among what is gated at P0.

Rows of landmarks are (slots, 9, M): mean x y z, then covariance xx xy xz yy yz zz in the map
frame; a variance xx <= 0 says that the landmark does not exist in that particle. Symmetric 3 × 3
matrices are six numbers in that order throughout.
"""

import math

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.geometry import Array

Choice = NDArray[np.int16]
Locals = NDArray[np.int64]
Six = tuple[float, float, float, float, float, float]


@kernel(inline='always')
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


@kernel
def _squared_length(
    x: float, y: float, z: float, xx: float, xy: float, xz: float, yy: float, yz: float, zz: float
) -> float:  # pragma: no cover - compiled
    """Return vᵀ S⁻¹ v."""
    a, b, d = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    square = (
        a * x * x
        + (xx * zz - xz * xz) * y * y
        + (xx * yy - xy * xy) * z * z
        + 2.0 * (b * x * y + d * x * z + (xy * xz - xx * yz) * y * z)
    )
    return square / (xx * a + xy * b + xz * d)


@kernel
def associate(
    slab: Array,
    slots: Locals,
    candidates: Locals,
    distances: Array,
    z: Array,
    R: Array,
    poses: Array,
    gate: float,
    choice: Choice,
    quality: Array,
) -> None:  # pragma: no cover - compiled
    """Fill choice (K, M) with the number of the candidate taken, or -1; quality (K, M) with d².

    Where none is taken, d² is that of the nearest candidate all the same, inf if there is none.

    candidates (K, J) are places in slots, or -1; distances (K, J) descriptor distances E; z (K, 3)
    and R (K, 6) in the vehicle frame; poses (M, 3) sampled. Each particle takes the candidate of
    least E among those with d² <= gate, of equals the one of least d² (section III).
    """
    K, J = candidates.shape
    for m in range(len(poses)):
        px, py = poses[m, 0], poses[m, 1]
        c, s = math.cos(poses[m, 2]), math.sin(poses[m, 2])
        for k in range(K):
            best = np.inf
            nearest = np.inf
            choice[k, m] = -1
            quality[k, m] = np.inf
            for j in range(J):
                local = candidates[k, j]
                if local < 0:
                    continue
                row = slab[slots[local]]
                if row[3, m] <= 0.0:
                    continue
                dx, dy = row[0, m] - px, row[1, m] - py
                sxx, sxy, sxz, syy, syz, szz = seen_covariance(
                    c, s, row[3, m], row[4, m], row[5, m], row[6, m], row[7, m], row[8, m]
                )
                square = _squared_length(
                    z[k, 0] - (c * dx + s * dy), z[k, 1] - (c * dy - s * dx), z[k, 2] - row[2, m],
                    sxx + R[k, 0], sxy + R[k, 1], sxz + R[k, 2], syy + R[k, 3], syz + R[k, 4],
                    szz + R[k, 5],
                )  # fmt: skip
                nearest = min(nearest, square)
                score = distances[k, j]
                if not square <= gate or score > best:
                    continue
                if score < best or square < quality[k, m]:
                    best = score
                    choice[k, m] = j
                    quality[k, m] = square
            if choice[k, m] < 0:
                quality[k, m] = nearest
