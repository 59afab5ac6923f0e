"""Dead leaves: random shapes that cover each other, the texture model closest to natural pictures.

Corners of plain rectangles all have the same SIFT descriptor, and isolated dots too; a patch of
overlapping shapes of all sizes has one that is found nowhere else.
"""

import math

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel

Gains = NDArray[np.float32]
MEAN_COVER = 2.0  # area of a leaf of radius 1, about
ELLIPSE, RECTANGLE, WEDGE = 0, 1, 2


@kernel
def _paint(gains: Gains, leaves: NDArray[np.float64]) -> None:
    """Paint leaves (N, 10) in their order: x, y, radius, cos, sin, aspect, kind, three gains."""
    rows, columns = gains.shape[0], gains.shape[1]
    for k in range(leaves.shape[0]):
        cx, cy, radius = leaves[k, 0], leaves[k, 1], leaves[k, 2]
        cos, sin, aspect, kind = leaves[k, 3], leaves[k, 4], leaves[k, 5], leaves[k, 6]
        reach = 1.42 * radius
        for y in range(max(0, int(cy - reach)), min(rows, int(cy + reach) + 2)):
            for x in range(max(0, int(cx - reach)), min(columns, int(cx + reach) + 2)):
                u = cos * (x - cx) + sin * (y - cy)
                v = cos * (y - cy) - sin * (x - cx)
                if kind == 0:
                    inside = u * u + (v / aspect) ** 2 < radius * radius
                elif kind == 1:
                    inside = abs(u) < radius and abs(v) < aspect * radius
                else:
                    inside = abs(u) < radius and abs(v) < 0.42 * aspect * (radius - u)
                if inside:
                    for channel in range(3):
                        gains[y, x, channel] = leaves[k, 7 + channel]


def leaf_gains(
    shape: tuple[int, int],
    rng: np.random.Generator,
    contrast: float,
    color: float = 0.1,
    smallest: float = 4.0,
) -> Gains:
    """Return gains (H, W, 3) about 1: those of leaves that cover everything about thrice.

    contrast and color are the largest deviations from 1, of all channels together and of each.
    Radii (pixels) follow the power law r^-3 of natural pictures, from the smallest to 50.
    """
    rows, columns = shape
    cover = 3.0 * rows * columns
    most = math.ceil(cover / (MEAN_COVER * smallest**2)) + 1
    # inverse of the distribution function of r^-3 between smallest and 50
    share = rng.random(most) * (1.0 - (smallest / 50.0) ** 2)
    radii = smallest / np.sqrt(1.0 - share)
    count = int(np.searchsorted(np.cumsum(MEAN_COVER * radii**2), cover)) + 1
    leaves = np.empty((min(count, most), 10))
    count = len(leaves)
    turn = rng.uniform(0.0, math.pi, count)
    leaves[:, 0] = rng.uniform(0.0, columns, count)
    leaves[:, 1] = rng.uniform(0.0, rows, count)
    leaves[:, 2] = radii[:count]
    leaves[:, 3], leaves[:, 4] = np.cos(turn), np.sin(turn)
    leaves[:, 5] = rng.uniform(0.35, 1.0, count)
    leaves[:, 6] = rng.integers(ELLIPSE, WEDGE + 1, count)
    leaves[:, 7:] = 1.0 + contrast * rng.uniform(-1.0, 1.0, (count, 1))
    leaves[:, 7:] += color * rng.uniform(-1.0, 1.0, (count, 3))
    gains = np.ones((rows, columns, 3), np.float32)
    _paint(gains, leaves)
    return gains
