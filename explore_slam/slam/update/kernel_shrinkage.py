"""Kernel shrinkage of landmarks over the particles, if an update would deplete them.

A vehicle that returns to what it mapped long ago knows its pose better than the particles, of
which only a handful agree. Part of the landmark error that is spread over the particles, as seen
from the
vehicle, is then moved into the covariances: each particle's landmark moves towards the mean over
all particles, and its covariance grows by what that removes, so that mean and covariance over all
particles stay the same (Liu and West, "Combined parameter and state estimation in simulation-based
filtering", 2001; regularized particle filter: Musso, Oudjane and Le Gland, 2001).
"""

import math

import numpy as np

from explore_slam.compiled import kernel
from explore_slam.geometry import Array

#: Parts of the covariance over the particles to move into the landmarks, the least first: steps of
#: about 3, from below the sampling noise of some hundred particles to where particles nearly
#: agree.
SHRINKAGES = (0.003, 0.01, 0.03, 0.1, 0.3)


@kernel
def _moments(
    row: Array, frames: Array, weights: Array, local: Array, mean: Array, S: Array
) -> float:  # pragma: no cover - compiled
    """Set local (M, 3), the landmark in the vehicle frames, and its mean and covariance S.

    row (9, M); frames (M, 4): position, cosine and sine of the heading. Returns the weight of the
    particles in which the landmark exists.
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
def shrink(
    rows: Array, poses: Array, weights: Array, part: float, shrunk: Array
) -> None:  # pragma: no cover - compiled
    """Move a part (0 to 1) of the covariance over the particles into that of each landmark.

    rows and shrunk (L, 9, M), see storage.row_format; poses (M, 3) and normalized weights (M,).
    Particles without the landmark are left as they are.
    """
    local, mean, S = np.empty((len(poses), 3)), np.empty(3), np.empty((3, 3))
    frames = np.empty((len(poses), 4))
    for m in range(len(poses)):
        frames[m, 0], frames[m, 1] = poses[m, 0], poses[m, 1]
        frames[m, 2], frames[m, 3] = math.cos(poses[m, 2]), math.sin(poses[m, 2])
    factor = math.sqrt(1.0 - part)
    shrunk[:] = rows
    for n in range(len(rows)):
        goal = shrunk[n]
        if _moments(rows[n], frames, weights, local, mean, S) <= 0.0:
            continue
        S *= part
        for m in range(len(poses)):
            if goal[3, m] <= 0.0:
                continue
            px, py, c, s = frames[m]
            x = mean[0] + factor * (local[m, 0] - mean[0])
            y = mean[1] + factor * (local[m, 1] - mean[1])
            goal[0, m] = px + c * x - s * y
            goal[1, m] = py + s * x + c * y
            goal[2, m] = mean[2] + factor * (local[m, 2] - mean[2])
            goal[3, m] += c * c * S[0, 0] - 2.0 * c * s * S[0, 1] + s * s * S[1, 1]
            goal[4, m] += c * s * (S[0, 0] - S[1, 1]) + (c * c - s * s) * S[0, 1]
            goal[5, m] += c * S[0, 2] - s * S[1, 2]
            goal[6, m] += s * s * S[0, 0] + 2.0 * c * s * S[0, 1] + c * c * S[1, 1]
            goal[7, m] += s * S[0, 2] + c * S[1, 2]
            goal[8, m] += S[2, 2]


def warm_up() -> None:
    """Compile the shrinkage, which seldom happens."""
    rows = np.ones((1, 9, 2))
    shrink(rows, np.zeros((2, 3)), np.full(2, 0.5), SHRINKAGES[0], np.empty_like(rows))
