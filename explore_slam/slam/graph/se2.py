"""Kernels of SE(2): poses and increments (x m, y m, heading rad) as arrays (3,).

`explore_slam.geometry` and `explore_slam.slam.particles.motion.compound` are the same operations
outside of kernels, on arrays of poses and on `Pose2`, which kernels cannot call. Their matrix
products go through BLAS and differ from these sums in the last bit, so that one in place of the
other would change results to the bit; a test compares them.
"""

import math

import numpy as np

from explore_slam.compiled import kernel
from explore_slam.geometry import Array


@kernel
def wrapped(angle: float) -> float:
    """Return the angle (rad) in [−π, π]."""
    if -math.pi <= angle <= math.pi:
        return angle
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)


@kernel
def compose(p: Array, u: Array, out: Array) -> None:
    """Write the pose p (3,) moved by an increment u (3,) in its frame."""
    c, s = math.cos(p[2]), math.sin(p[2])
    x, y = p[0] + c * u[0] - s * u[1], p[1] + s * u[0] + c * u[1]
    out[0], out[1], out[2] = x, y, wrapped(p[2] + u[2])


@kernel
def relative(p: Array, q: Array, out: Array) -> None:
    """Write the increment (3,) that leads from pose p (3,) to pose q (3,)."""
    c, s = math.cos(p[2]), math.sin(p[2])
    dx, dy = q[0] - p[0], q[1] - p[1]
    out[0], out[1], out[2] = c * dx + s * dy, c * dy - s * dx, wrapped(q[2] - p[2])


@kernel
def jacobians(u: Array, total: Array) -> tuple[Array, Array]:
    """Return the Jacobians (3, 3) of a motion in its first part u (3,) and in the rest."""
    c, s = math.cos(u[2]), math.sin(u[2])
    F, G = np.eye(3), np.eye(3)
    F[0, 2], F[1, 2] = -(total[1] - u[1]), total[0] - u[0]
    G[0, 0], G[0, 1], G[1, 0], G[1, 1] = c, -s, s, c
    return F, G


@kernel
def compound(u: Array, P: Array, v: Array, Q: Array) -> tuple[Array, Array]:
    """Return mean (3,) and covariance (3, 3) of a motion u with P followed by v with Q.

    Covariances are those of the components, in the axes where each motion begins (Smith, Self
    and Cheeseman, Estimating uncertain spatial relationships in robotics, 1990).
    """
    mean = np.empty(3)
    compose(u, v, mean)
    F, G = jacobians(u, mean)
    total = np.zeros((3, 3))
    for i in range(3):
        for j in range(i + 1):
            for k in range(3):
                for n in range(3):
                    total[i, j] += F[i, k] * P[k, n] * F[j, n] + G[i, k] * Q[k, n] * G[j, n]
            total[j, i] = total[i, j]
    return mean, total
