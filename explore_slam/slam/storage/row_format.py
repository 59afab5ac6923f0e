"""The row: the Gaussian of one landmark in one particle, nine numbers.

A landmark has one row per particle. They lie together as a block (9, M), one column per particle,
so that loops over particles run over contiguous memory and become vector instructions:

                     particle  0    1    2   ...  M-1
    mean        0   x (m)      .    .    .         .     position in the map frame
                1   y (m)      .    .    .         .
                2   z (m)      .    .    .         .
    COVARIANCE  3   xx (m²)    .    .    .         .     upper triangle, row by row;
                4   xy         .    .    .         .     xx <= 0: the landmark does not
                5   xz         .    .    .         .     exist in this particle
                6   yy         .    .    .         .
                7   yz         .    .    .         .
                8   zz         .    .    .         .

All symmetric 3 × 3 matrices of the package are packed into six numbers in this order: covariances
of observations R (K, 6) too.
"""

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.geometry import Array

ROW_LENGTH = 9
COVARIANCE = 3
UPPER_TRIANGLE = (np.array([0, 0, 0, 1, 1, 2]), np.array([0, 1, 2, 1, 2, 2]))
_PLACE_IN_SIX = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])

Six = tuple[float, float, float, float, float, float]
Places = NDArray[np.int64]  # indices of a landmark or of its rows
Choice = NDArray[np.int16]  # (K, M): number of the candidate that a particle has chosen, or -1


def packed(matrices: Array) -> Array:
    """Return symmetric matrices (n, 3, 3) as (n, 6)."""
    return np.ascontiguousarray(matrices[:, *UPPER_TRIANGLE], np.float64)


def unpacked(six: Array) -> Array:
    """Return symmetric matrices (n, 3, 3) of (n, 6)."""
    return six[:, _PLACE_IN_SIX]


def exists(rows: Array) -> NDArray[np.bool_]:
    """Return (n,) whether the landmarks of rows (n, 9) exist."""
    there: NDArray[np.bool_] = rows[:, COVARIANCE] > 0.0
    return there


@kernel(inline='always')
def covariance_in_vehicle_frame(
    c: float, s: float, xx: float, xy: float, xz: float, yy: float, yz: float, zz: float
) -> Six:  # pragma: no cover - compiled
    """Rotate a covariance from the map into the frame of a vehicle with heading cos c, sin s.

    With -s instead of s the rotation is the inverse one.
    """
    cc, cs, ss = c * c, c * s, s * s
    return (
        cc * xx + 2.0 * cs * xy + ss * yy,
        cs * (yy - xx) + (cc - ss) * xy,
        c * xz + s * yz,
        ss * xx - 2.0 * cs * xy + cc * yy,
        c * yz - s * xz,
        zz,
    )
