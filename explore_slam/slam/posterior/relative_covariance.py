"""Covariances of relative poses for search windows, from a posterior that is a few keyframes old.

Exact covariances would require a factorization of the whole graph at every keyframe. Instead, the
covariance of the motion since the posterior was last computed is added, which is conservative: it
ignores the observations made since.
"""

from typing import NamedTuple

import numpy as np

from explore_slam.geometry import Array, between, planar_rotation, rotated
from explore_slam.slam.graph import JointGraph
from explore_slam.slam.graph.solver import Solution
from explore_slam.slam.storage.row_format import Places

# Keyframes that a posterior may lack before it is computed anew. Chosen by hand: search windows
# include the drift over as many keyframes, about 3 m driven with the default keyframe distance.
# `benchmarks/graph_speed.py` measures what a new posterior takes.
_MAXIMUM_MISSING = 16


class _Posterior(NamedTuple):
    """A posterior with the vehicles (K,) of its keyframes."""

    solution: Solution
    vehicles: Places


class RelativeCovariances:
    """Covariances of relative poses in one graph; computes posteriors anew when too old."""

    def __init__(self, graph: JointGraph) -> None:
        self._graph = graph
        self._known: dict[int, _Posterior] = {}

    def renew(self, vehicle: int) -> None:
        """Compute the posterior of a vehicle and those tied to it at the present estimate."""
        known = self._computed(vehicle)
        self._known |= dict.fromkeys(known.solution.problem.vehicles, known)

    def _computed(self, vehicle: int) -> _Posterior:
        solution = self._graph.posterior(vehicle)
        return _Posterior(solution, self._graph.vehicles_of(solution.problem.keyframes))

    def invalidate(self) -> None:
        """Discard all posteriors; each is computed anew when it is next needed."""
        self._known = {}

    def __call__(self, reference: int, others: Places, *, keep: bool = True) -> Array:
        """Return covariances (n, 3, 3) of keyframes' poses in the frame of a reference.

        They are those of the components of the relative poses, in the axes of the reference.
        Vehicles that no measurement ties together are independent, each with its covariance in the
        map. keep: use a posterior that must be computed for later calls too; without it, a call
        leaves no trace.
        """
        path = self._graph.path()
        owners = self._graph.vehicles_of(np.append(others, reference))
        owner = int(owners[-1])
        known = self._posterior(owner, keep)
        near = _newest(known, owner, reference)
        drift = self._graph.motion_covariance(near, reference)
        out = np.empty((len(others), 3, 3))
        tied = np.isin(owners[:-1], known.solution.problem.vehicles)
        if tied.any():
            nodes = [
                _newest(known, int(vehicle), int(keyframe))
                for vehicle, keyframe in zip(owners[:-1][tied], others[tied], strict=True)
            ]
            P = known.solution.relative_covariance(near, np.array(nodes, np.int64))
            z = between(path[near], path[others[tied]])
            out[tied] = _in_frame_of(between(path[near], path[reference]), drift, z, P)
        if tied.all():
            return out
        own = known.solution.covariance(near) + rotated(drift, -path[near, 2])
        for row in np.flatnonzero(~tied).tolist():
            vehicle, keyframe = int(owners[row]), int(others[row])
            theirs = self._posterior(vehicle, keep)
            P = theirs.solution.covariance(_newest(theirs, vehicle, keyframe))
            out[row] = _in_frame_of(path[reference], own, path[keyframe][None], P[None])[0]
        return out

    def _posterior(self, vehicle: int, keep: bool) -> _Posterior:
        """Return a posterior of a vehicle that lacks at most _MAXIMUM_MISSING keyframes."""
        known = self._known.get(vehicle)
        newest = self._graph.newest_keyframe(vehicle)
        if known is None or newest - known.solution.problem.keyframes[-1] > _MAXIMUM_MISSING:
            if not keep:
                return self._computed(vehicle)
            self.renew(vehicle)
            known = self._known[vehicle]
        return known


def _newest(known: _Posterior, vehicle: int, keyframe: int) -> int:
    """Return the newest keyframe of a vehicle, up to a given one, that a posterior contains."""
    numbers = known.solution.problem.keyframes
    mine = numbers[(known.vehicles == vehicle) & (numbers <= keyframe)]
    return int(mine[-1])


def _in_frame_of(u: Array, Q: Array, z: Array, P: Array) -> Array:
    """Return covariances (n, 3, 3) of poses z (n, 3) in the frame of a pose u (3,).

    Q (3, 3) and P (n, 3, 3): covariances of the components of u and of each z, in the axes in
    which these are given.
    """
    w = between(u, z)
    J = planar_rotation(-u[2])
    K = np.tile(-J, (len(z), 1, 1))
    K[:, 0, 2], K[:, 1, 2] = w[:, 1], -w[:, 0]
    found: Array = J @ P @ J.T + K @ Q @ K.transpose(0, 2, 1)
    return found
