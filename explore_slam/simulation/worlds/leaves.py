"""Dead leaves textures: random shapes of power-law sizes that occlude each other.

The model reproduces statistics of natural images (Lee, Mumford, Huang, "Occlusion models for
natural images", IJCV 41, 2001). Corners of plain rectangles all have the same SIFT descriptor,
and so do isolated dots; overlapping shapes of all sizes have distinctive ones.
"""

import math

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel

Gains = NDArray[np.float32]
MEAN_COVER = 2.0  # area of a leaf of radius 1, roughly the mean over shapes and aspects
LARGEST = 50.0  # pixels, radius of the largest leaf
COVERS = 3.0  # total area of the leaves in multiples of the image: 95 % of it gets covered
ELLIPSE, RECTANGLE, WEDGE = 0, 1, 2  # kinds of leaves


@kernel
def _paint(gains: Gains, leaves: NDArray[np.float64]) -> None:
    """Paint leaves (N, 10) in order: x, y, radius, cos, sin, aspect, kind, gain per channel."""
    rows, columns = gains.shape[0], gains.shape[1]
    for k in range(leaves.shape[0]):
        cx, cy, radius = leaves[k, 0], leaves[k, 1], leaves[k, 2]
        cos, sin, aspect, kind = leaves[k, 3], leaves[k, 4], leaves[k, 5], leaves[k, 6]
        reach = 1.42 * radius  # √2, rounded up: to the corners of a square
        for y in range(max(0, int(cy - reach)), min(rows, int(cy + reach) + 2)):
            for x in range(max(0, int(cx - reach)), min(columns, int(cx + reach) + 2)):
                u = cos * (x - cx) + sin * (y - cy)
                v = cos * (y - cy) - sin * (x - cx)
                if kind == ELLIPSE:
                    inside = u * u + (v / aspect) ** 2 < radius * radius
                elif kind == RECTANGLE:
                    inside = abs(u) < radius and abs(v) < aspect * radius
                else:  # a wedge, 1.68 aspect radius wide at its base
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
    """Return multiplicative gains (H, W, 3) around 1, constant on each visible leaf.

    contrast, color: largest deviation from 1 of all channels together and of each one.
    smallest: smallest radius (pixels); radii follow the power law r^-3 up to LARGEST.
    """
    rows, columns = shape
    cover = COVERS * rows * columns
    most = math.ceil(cover / (MEAN_COVER * smallest**2)) + 1
    # inverse transform sampling of the density r^-3 between smallest and LARGEST
    share = rng.random(most) * (1.0 - (smallest / LARGEST) ** 2)
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
