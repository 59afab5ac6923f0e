"""Association of engine paper: steps 2.2.2 to 2.5 of the paper's algorithm, per particle.

Each particle chooses, among the candidates whose association probability exp(-d²/2) is at least
P0, the one of smallest descriptor distance E.
"""

import math

import numpy as np

from explore_slam.compiled import kernel
from explore_slam.geometry import Array
from explore_slam.slam.association.state import Associations, CandidateRows, Observed
from explore_slam.slam.storage.row_format import Six, covariance_in_vehicle_frame


@kernel
def _mahalanobis_squared(
    residual: tuple[float, float, float], covariance: Six
) -> float:  # pragma: no cover - compiled
    """Return νᵀ S⁻¹ ν of a residual ν (x, y, z) and its packed covariance S."""
    x, y, z = residual
    xx, xy, xz, yy, yz, zz = covariance
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
    rows: CandidateRows, observed: Observed, poses: Array, gate: float, chosen: Associations
) -> None:  # pragma: no cover - compiled
    """Fill choice and mahalanobis_squared (K, M) for particles at sampled poses (M, 3).

    gate: largest d². Of equal descriptors the candidate of smallest d² is chosen. If none
    passes, d² is that of the nearest candidate, inf if there is none.
    """
    candidates, z, R = rows.candidates, observed.z, observed.R
    choice, mahalanobis_squared = chosen.choice, chosen.mahalanobis_squared
    K, J = candidates.shape
    for m in range(len(poses)):
        px, py = poses[m, 0], poses[m, 1]
        c, s = math.cos(poses[m, 2]), math.sin(poses[m, 2])
        for k in range(K):
            best = np.inf
            nearest = np.inf
            choice[k, m] = -1
            mahalanobis_squared[k, m] = np.inf
            for j in range(J):
                place = candidates[k, j]
                if place < 0:
                    continue
                row = rows.rows[rows.addresses[place]]
                if row[3, m] <= 0.0:
                    continue
                dx, dy = row[0, m] - px, row[1, m] - py
                sxx, sxy, sxz, syy, syz, szz = covariance_in_vehicle_frame(
                    c, s, row[3, m], row[4, m], row[5, m], row[6, m], row[7, m], row[8, m]
                )
                ex, ey = z[k, 0] - (c * dx + s * dy), z[k, 1] - (c * dy - s * dx)
                S = (
                    sxx + R[k, 0], sxy + R[k, 1], sxz + R[k, 2], syy + R[k, 3], syz + R[k, 4],
                    szz + R[k, 5],
                )  # fmt: skip
                square = _mahalanobis_squared((ex, ey, z[k, 2] - row[2, m]), S)
                nearest = min(nearest, square)
                distance = rows.distances[k, j]
                if not square <= gate or distance > best:
                    continue
                if distance < best or square < mahalanobis_squared[k, m]:
                    best = distance
                    choice[k, m] = j
                    mahalanobis_squared[k, m] = square
            if choice[k, m] < 0:
                mahalanobis_squared[k, m] = nearest
