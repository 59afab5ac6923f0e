"""Gaussians of pose errors in compiled code: conditioning and sampling, 3 × 3."""

import math

import numpy as np

from explore_slam.compiled import kernel
from explore_slam.geometry import Array

_MINIMUM_DEVIATION = 1e-12  # m or rad: directions below it count as exactly known


@kernel
def solve(
    P: Array, L: Array, eta: Array, delta: Array, posterior: Array
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Set posterior = P (I + L P)⁻¹ and delta = posterior η; return |I + L P| and ηᵀ delta.

    P, L, posterior (3, 3); eta, delta (3,).
    """
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


@kernel
def sample_gaussian(
    posterior: Array, normal: Array, delta: Array
) -> None:  # pragma: no cover - compiled
    """Add a sample of N(0, posterior) to delta (3,), made of standard normals (3,)."""
    l00 = math.sqrt(max(posterior[0, 0], 0.0))
    l10 = posterior[1, 0] / l00 if l00 > _MINIMUM_DEVIATION else 0.0
    l20 = posterior[2, 0] / l00 if l00 > _MINIMUM_DEVIATION else 0.0
    l11 = math.sqrt(max(posterior[1, 1] - l10 * l10, 0.0))
    l21 = (posterior[2, 1] - l20 * l10) / l11 if l11 > _MINIMUM_DEVIATION else 0.0
    l22 = math.sqrt(max(posterior[2, 2] - l20 * l20 - l21 * l21, 0.0))
    delta[0] += l00 * normal[0]
    delta[1] += l10 * normal[0] + l11 * normal[1]
    delta[2] += l20 * normal[0] + l21 * normal[1] + l22 * normal[2]
