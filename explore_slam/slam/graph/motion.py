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


@kernel
def _carry(u: Array, v: Array, P: Array, out: Array) -> None:
    """Write P Fᵀ (3, 3), the covariance of a motion u of covariance P with the longer motion v.

    F is the Jacobian of v's components in those of u, where v begins with u.
    """
    dx, dy = v[0] - u[0], v[1] - u[1]
    for i in range(3):
        out[i, 0], out[i, 1] = P[i, 0] - dy * P[i, 2], P[i, 1] + dx * P[i, 2]
        out[i, 2] = P[i, 2]


@kernel
def hang_between(
    begin: Array, end: Array, increments: Array, covariances: Array, least: float, out: Array
) -> None:
    """Write the poses (n, 3, M) between M pairs of poses (3, M) that n + 1 increments connect.

    The increments (n + 1, 3) do not lead exactly from `begin` to `end`; the error is spread as
    their covariances (n + 1, 3, 3) have it, which is the conditional mean of a chain whose ends
    are known. least: variance (m², rad²) that the whole motion has at least.
    """
    n = len(out)
    means, spreads = np.zeros((n + 1, 3)), np.zeros((n + 1, 3, 3))
    means[0], spreads[0] = increments[0], covariances[0]
    for k in range(n):
        means[k + 1], spreads[k + 1] = compound(
            means[k], spreads[k], increments[k + 1], covariances[k + 1]
        )
    inverse = np.linalg.inv(spreads[n] + least * np.eye(3))
    gains, together = np.zeros((n, 3, 3)), np.empty((3, 3))
    for k in range(n):
        _carry(means[k], means[n], spreads[k], together)
        for i in range(3):
            for j in range(3):
                for m in range(3):
                    gains[k, i, j] += together[i, m] * inverse[m, j]
    p, q, u, error = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for m in range(begin.shape[1]):
        for i in range(3):
            p[i], q[i] = begin[i, m], end[i, m]
        relative(p, q, error)
        error[0] -= means[n, 0]
        error[1] -= means[n, 1]
        error[2] = wrapped(error[2] - means[n, 2])
        for k in range(n):
            G = gains[k]
            for i in range(3):
                moved = G[i, 0] * error[0] + G[i, 1] * error[1] + G[i, 2] * error[2]
                u[i] = means[k, i] + moved
            compose(p, u, q)
            for i in range(3):
                out[k, i, m] = q[i]
