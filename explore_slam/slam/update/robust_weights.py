"""Robust weights: observations beyond the outlier threshold are downweighted.

The likelihood of one observation with Mahalanobis distance d is that of a Gaussian up to the
threshold t, and falls like d^-t² beyond: its cost is d² for d <= t, t² (1 + ln(d² / t²)) beyond,
and iteratively reweighted least squares (Huber, "Robust Statistics", 1981) uses the weight w =
min(1, t² / d²). No single observation can then decide over a particle.
"""

import math

from explore_slam.compiled import kernel
from explore_slam.geometry import Array
from explore_slam.slam.update.blocks import (
    BLOCK,
    CD,
    SD,
    WEIGHT,
    ZX,
    ZY,
    Q,
    S,
    mahalanobis_squared,
)

# The posterior covariance seen from the observation may take up to this part of S, so that the
# covariance of a studentized residual stays positive definite in spite of rounding.
_LARGEST_FRACTION = 0.999


@kernel
def robust_cost(square: float, t2: float) -> float:  # pragma: no cover - compiled
    """Return t² (1 + ln(d² / t²)), the cost of a residual d² beyond t², and t² up to it."""
    return t2 * (1.0 + math.log(max(square / t2, 1.0)))


@kernel(inline='always')
def reweight(w: Array, t2: float) -> None:  # pragma: no cover - compiled
    """Set the robust weight of the loaded observation by its studentized residual.

    The residual at the current solution has the covariance S − H Q Hᵀ, Q the posterior of the
    pose.
    """
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
        hxx = min(-cd * a0 - sd * a1 + zy * a2, _LARGEST_FRACTION * w[S, i])
        hxy = sd * a0 - cd * a1 - zx * a2
        hyy = min(sd * b0 - cd * b1 - zx * b2, _LARGEST_FRACTION * w[S + 3, i])
        studentized, determinant = mahalanobis_squared(w, -hxx, -hxy, -hyy, i)
        plain, _ = mahalanobis_squared(w, 0.0, 0.0, 0.0, i)
        square = studentized if determinant > 0.0 and studentized > plain else plain
        w[WEIGHT, i] = t2 / square if square > t2 else 1.0
