"""Covariances of relative poses for search windows, from a posterior that is a few keyframes old.

The exact ones need a factorization of the whole graph after every keyframe. Here the motion since
the posterior was last computed is added instead, which is a little too wide.
"""

from typing import NamedTuple

import numpy as np

from explore_slam.geometry import Array, between, rotated
from explore_slam.slam.graph import JointGraph
from explore_slam.slam.graph.solver import Solution
from explore_slam.slam.storage.row_format import Places

_OLDEST = 16  # keyframes that a posterior may lack


class _Known(NamedTuple):
    """A posterior, and the vehicles (K,) of its keyframes."""

    solution: Solution
    vehicles: Places


class RelativeCovariances:
    """Answers for one graph; the posteriors are computed anew when they are too old."""

    def __init__(self, graph: JointGraph) -> None:
        self._graph = graph
        self._known: dict[int, _Known] = {}

    def renew(self, vehicle: int) -> None:
        """Take over the posterior of a vehicle and those tied to it, as after an optimization."""
        solution = self._graph.posterior(vehicle)
        known = _Known(solution, self._graph.vehicles_of(solution.problem.keyframes))
        self._known |= dict.fromkeys(solution.problem.vehicles, known)

    def forget(self) -> None:
        """Compute all posteriors anew when they are next needed."""
        self._known = {}

    def __call__(self, reference: int, others: Places) -> Array:
        """Return covariances (n, 3, 3) of keyframes' poses in the frame of a reference.

        They are those of the components of the relative poses, in the axes of the reference.
        Vehicles that nothing ties together are independent; both are in the map.
        """
        path = self._graph.path()
        owners = self._graph.vehicles_of(np.append(others, reference))
        owner = int(owners[-1])
        known = self._posterior(owner)
        near = _newest(known, owner, reference)
        tail = self._graph.motion_covariance(near, reference)
        out = np.empty((len(others), 3, 3))
        tied = np.isin(owners[:-1], known.solution.problem.vehicles)
        if tied.any():
            nodes = [
                _newest(known, int(vehicle), int(keyframe))
                for vehicle, keyframe in zip(owners[:-1][tied], others[tied], strict=True)
            ]
            P = known.solution.relative_covariance(near, np.array(nodes, np.int64))
            z = between(path[near], path[others[tied]])
            out[tied] = _seen_from(between(path[near], path[reference]), tail, z, P)
        if tied.all():
            return out
        own = known.solution.covariance(near) + rotated(tail, -path[near, 2])
        for row in np.flatnonzero(~tied).tolist():
            vehicle, keyframe = int(owners[row]), int(others[row])
            theirs = self._posterior(vehicle)
            P = theirs.solution.covariance(_newest(theirs, vehicle, keyframe))
            out[row] = _seen_from(path[reference], own, path[keyframe][None], P[None])[0]
        return out

    def _posterior(self, vehicle: int) -> _Known:
        """Return a posterior of a vehicle that lacks few of the keyframes."""
        known = self._known.get(vehicle)
        newest = self._graph.newest_keyframe(vehicle)
        if known is None or newest - known.solution.problem.keyframes[-1] > _OLDEST:
            self.renew(vehicle)
            known = self._known[vehicle]
        return known


def _newest(known: _Known, vehicle: int, keyframe: int) -> int:
    """Return the newest keyframe of a vehicle in a posterior that is not after a keyframe."""
    numbers = known.solution.problem.keyframes
    mine = numbers[(known.vehicles == vehicle) & (numbers <= keyframe)]
    return int(mine[-1])


def _seen_from(u: Array, Q: Array, z: Array, P: Array) -> Array:
    """Return covariances (n, 3, 3) of poses z (n, 3) in the frame of the pose u (3,).

    Q (3, 3) and P (n, 3, 3): covariances of the components of u and of each z, in the axes in
    which these are given.
    """
    w = between(u, z)
    c, s = np.cos(u[2]), np.sin(u[2])
    J = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    K = np.tile(-J, (len(z), 1, 1))
    K[:, 0, 2], K[:, 1, 2] = w[:, 1], -w[:, 0]
    found: Array = J @ P @ J.T + K @ Q @ K.transpose(0, 2, 1)
    return found
