"""Motion between keyframes: compounding it, and the path of keyframes that were dropped."""

import math

import numpy as np

from explore_slam.compiled import kernel
from explore_slam.geometry import Array
from explore_slam.slam.graph.factors import wrapped


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
def compound(u: Array, P: Array, v: Array, Q: Array) -> tuple[Array, Array]:
    """Return mean (3,) and covariance (3, 3) of a motion u with P followed by v with Q.

    Covariances are those of the components, in the axes where each motion begins (Smith, Self
    and Cheeseman, Estimating uncertain spatial relationships in robotics, 1990).
    """
    c, s = math.cos(u[2]), math.sin(u[2])
    mean = np.empty(3)
    compose(u, v, mean)
    F = np.eye(3)
    F[0, 2], F[1, 2] = -(mean[1] - u[1]), mean[0] - u[0]
    G = np.eye(3)
    G[0, 0], G[0, 1], G[1, 0], G[1, 1] = c, -s, s, c
    total = np.zeros((3, 3))
    for i in range(3):
        for j in range(i + 1):
            for k in range(3):
                for n in range(3):
                    total[i, j] += F[i, k] * P[k, n] * F[j, n] + G[i, k] * Q[k, n] * G[j, n]
            total[j, i] = total[i, j]
    return mean, total
