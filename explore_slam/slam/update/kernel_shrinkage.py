"""Landmarks smoothed over the particles, where an update would leave too few of these.

A vehicle that comes back to what was mapped long ago knows better where it is than the particles,
of which a handful fit. The error of a landmark, as the vehicle sees it, is then taken back from
the particles into its covariance, as far as is needed: the density of the particles is smoothed by
a kernel, and what each holds moves towards their mean, so that mean and covariance over all of
them stay what they were (Liu and West, Combined parameter and state estimation, 2001; regularized
particle filter, Musso et al., 2001).
"""

import math

import numpy as np

from explore_slam.compiled import kernel
from explore_slam.geometry import Array

#: Parts of the covariance over the particles that are tried, the least first.
SHARES = (0.003, 0.01, 0.03, 0.1, 0.3)


@kernel
def _moments(
    row: Array, frames: Array, weights: Array, local: Array, mean: Array, S: Array
) -> float:  # pragma: no cover - compiled
    """Set places (M, 3) in the vehicle frames, mean (3,) and covariance (3, 3) where they exist.

    frames (M, 4): position, cosine and sine of the heading. Returns the weight of the particles
    that have the landmark.
    """
    total = 0.0
    mean[:], S[:] = 0.0, 0.0
    for m in range(len(frames)):
        if row[3, m] > 0.0:
            px, py, c, s = frames[m]
            dx, dy = row[0, m] - px, row[1, m] - py
            local[m, 0], local[m, 1], local[m, 2] = c * dx + s * dy, c * dy - s * dx, row[2, m]
            total += weights[m]
            for a in range(3):
                mean[a] += weights[m] * local[m, a]
    if total <= 0.0:
        return total
    mean /= total
    for m in range(len(frames)):
        if row[3, m] > 0.0:
            for a in range(3):
                for b in range(3):
                    S[a, b] += weights[m] * (local[m, a] - mean[a]) * (local[m, b] - mean[b])
    S /= total
    return total


@kernel
def smooth(
    rows: Array, poses: Array, weights: Array, share: float, smoothed: Array
) -> None:  # pragma: no cover - compiled
    """Move a share (0 to 1) of the covariance over the particles into that of each landmark.

    rows and smoothed (L, 9, M) as in `association`, absent landmarks stay so; poses (M, 3) and
    normalized weights (M,). Places are compared in the vehicle frames.
    """
    local, mean, S = np.empty((len(poses), 3)), np.empty(3), np.empty((3, 3))
    frames = np.empty((len(poses), 4))
    for m in range(len(poses)):
        frames[m, 0], frames[m, 1] = poses[m, 0], poses[m, 1]
        frames[m, 2], frames[m, 3] = math.cos(poses[m, 2]), math.sin(poses[m, 2])
    nearer = math.sqrt(1.0 - share)
    smoothed[:] = rows
    for n in range(len(rows)):
        goal = smoothed[n]
        if _moments(rows[n], frames, weights, local, mean, S) <= 0.0:
            continue
        S *= share
        for m in range(len(poses)):
            if goal[3, m] <= 0.0:
                continue
            px, py, c, s = frames[m]
            x = mean[0] + nearer * (local[m, 0] - mean[0])
            y = mean[1] + nearer * (local[m, 1] - mean[1])
            goal[0, m] = px + c * x - s * y
            goal[1, m] = py + s * x + c * y
            goal[2, m] = mean[2] + nearer * (local[m, 2] - mean[2])
            goal[3, m] += c * c * S[0, 0] - 2.0 * c * s * S[0, 1] + s * s * S[1, 1]
            goal[4, m] += c * s * (S[0, 0] - S[1, 1]) + (c * c - s * s) * S[0, 1]
            goal[5, m] += c * S[0, 2] - s * S[1, 2]
            goal[6, m] += s * s * S[0, 0] + 2.0 * c * s * S[0, 1] + c * c * S[1, 1]
            goal[7, m] += s * S[0, 2] + c * S[1, 2]
            goal[8, m] += S[2, 2]


def warm_up() -> None:
    """Compile the smoothing, which otherwise happens when it is needed first."""
    rows = np.ones((1, 9, 2))
    smooth(rows, np.zeros((2, 3)), np.full(2, 0.5), SHARES[0], np.empty_like(rows))
