"""Poses of dropped keyframes along the chain of motions between those that are kept."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.geometry import Array
from explore_slam.slam.graph.se2 import compose, compound, relative, wrapped


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
