"""Motion between keyframes: compounding, and the path of keyframes that were dropped."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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
def interpolate_chain(
    begin: Array, end: Array, increments: Array, covariances: Array, least: float, out: Array
) -> None:
    """Write the poses (n, 3) along a chain of n + 1 increments (n + 1, 3) between two poses (3,).

    The increments do not lead exactly from `begin` to `end`; the error is distributed according to
    their covariances (n + 1, 3, 3), which gives the conditional mean of a chain with known ends.
    least: minimum variance (m², rad²) of the whole motion.
    """
    n = len(out)
    means, spreads = np.zeros((n + 1, 3)), np.zeros((n + 1, 3, 3))
    means[0], spreads[0] = increments[0], covariances[0]
    for k in range(n):
        means[k + 1], spreads[k + 1] = compound(
            means[k], spreads[k], increments[k + 1], covariances[k + 1]
        )
    error = np.empty(3)
    relative(begin, end, error)
    error[0] -= means[n, 0]
    error[1] -= means[n, 1]
    error[2] = wrapped(error[2] - means[n, 2])
    weighted = np.linalg.solve(spreads[n] + least * np.eye(3), error)
    together, u = np.empty((3, 3)), np.empty(3)
    for k in range(n):
        _carry(means[k], means[n], spreads[k], together)
        for i in range(3):
            u[i] = means[k, i]
            for j in range(3):
                u[i] += together[i, j] * weighted[j]
        compose(begin, u, out[k])


class Chain(NamedTuple):
    """Keyframes (K,) of all vehicles in the order of their rows.

    previous: row of the vehicle's previous keyframe, −1 where there is none; live: whether the
    pose is given; reference: row of the keyframe that it stays relative to, −1: its motion alone
    determines its pose; increments (K, 3) since the previous one, with covariances (K, 3, 3).
    """

    previous: NDArray[np.int64]
    live: NDArray[np.bool_]
    reference: NDArray[np.int64]
    increments: Array
    covariances: Array


@kernel
def carry_dropped(chain: Chain, old: Array, least: float, poses: Array) -> None:
    """Write the poses (K, 3) of keyframes that are not live, given those that are.

    old (K, 3): all poses before the live ones moved to where `poses` has them. Keyframes with a
    reference move with it as a rigid body; the others are interpolated between those.
    """
    fixed = chain.live.copy()
    u = np.empty(3)
    for row in range(len(old)):
        root = row
        while root >= 0 and not chain.live[root]:
            root = chain.reference[root]
        if root >= 0 and root != row:
            fixed[row] = True
            relative(old[root], old[row], u)
            compose(poses[root], u, poses[row])
    rows = np.empty(len(old) + 1, np.int64)
    for end in range(len(old)):
        if not fixed[end]:
            continue
        count, row = 1, chain.previous[end]
        rows[0] = end
        while row >= 0 and not fixed[row]:
            rows[count] = row
            count += 1
            row = chain.previous[row]
        if row >= 0 and count > 1:
            steps = rows[:count][::-1].copy()
            interpolated = np.empty((count - 1, 3))
            interpolate_chain(
                poses[row],
                poses[end],
                chain.increments[steps],
                chain.covariances[steps],
                least,
                interpolated,
            )
            poses[steps[:-1]] = interpolated
