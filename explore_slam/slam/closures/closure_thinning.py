"""Closures of places seen often: those that may go, so that the area bounds the graph.

The closures of the first visits of a place close its loops. Those of later visits tell little that
is new, but each of them keeps two keyframes in the graph. They are dropped once the vehicle has
driven on: what they measured is lost, never summarized. The way into and out of what is mapped for
the first time stays closed, whatever the number of visits.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array
from explore_slam.slam.checkpoint import State
from explore_slam.slam.closures.anchors import QUERY_LENGTH, Anchors
from explore_slam.slam.closures.closure import Closure

# Visits of a place by a vehicle whose closures are kept, as of landmarks (`graph_visits`).
_VISITS = 2
_SAME_PLACE = 1.5  # m between two poses of a vehicle in the same place
_SAME_VISIT = 15.0  # m driven; nearer closures of a place belong to the same visit of it

Key = tuple[int, int]  # of a closure: the keyframes a and b


class _Ends(NamedTuple):
    """The vehicles at both ends of a closure, and the distances (m) that they had driven."""

    vehicle_a: int
    distance_a: float
    vehicle_b: int
    distance_b: float


class ClosureThinning:
    """Which closures repeat what those of earlier visits say."""

    def __init__(self) -> None:
        self._ends: dict[Key, _Ends] = {}

    def add(self, closures: Sequence[Closure], anchors: Anchors) -> None:
        """Note closures whose anchors are there."""
        for closure in closures:
            a, b = (anchors.of_keyframe(k) for k in (closure.keyframe_a, closure.keyframe_b))
            self._ends[a.keyframe, b.keyframe] = _Ends(
                a.vehicle, a.distance_driven, b.vehicle, b.distance_driven
            )

    def forget(self, closures: Sequence[Closure]) -> None:
        """Forget closures that have been taken back or dropped."""
        for closure in closures:
            del self._ends[closure.keyframe_a, closure.keyframe_b]

    def redundant(
        self,
        closures: Sequence[Closure],
        poses: Array,
        anchors: Anchors,
        judged: Collection[int],
    ) -> list[Closure]:
        """Return the closures that may be dropped.

        closures: all that are part of the graph. poses (K, 3): of all keyframes. judged: keyframes
        whose anchors have been judged, see Thinning.
        """
        by_vehicle: dict[int, list[Closure]] = {}
        for closure in closures:
            ends = self._ends[closure.keyframe_a, closure.keyframe_b]
            by_vehicle.setdefault(ends.vehicle_b, []).append(closure)
        fixed = self._fixed(anchors, judged)
        return [
            closure
            for vehicle, own in sorted(by_vehicle.items())
            for closure in self._redundant_of(own, poses, anchors, *fixed[vehicle])
        ]

    def _fixed(
        self, anchors: Anchors, judged: Collection[int]
    ) -> Mapping[int, tuple[Array, float]]:
        """Return what closures must hold, of each vehicle, and how far that is known.

        These are, as distances driven (n,) m, its anchors that were judged and kept.
        """
        kept: dict[int, list[float]] = {ends.vehicle_b: [] for ends in self._ends.values()}
        frontier = dict.fromkeys(kept, np.inf)
        for anchor in anchors:
            if anchor.vehicle not in kept:
                continue
            if anchor.keyframe in judged:
                kept[anchor.vehicle].append(anchor.distance_driven)
            else:
                frontier[anchor.vehicle] = min(frontier[anchor.vehicle], anchor.distance_driven)
        return {vehicle: (np.unique(kept[vehicle]), frontier[vehicle]) for vehicle in kept}

    def _redundant_of(
        self, own: Sequence[Closure], poses: Array, anchors: Anchors, fixed: Array, frontier: float
    ) -> list[Closure]:
        """Return those of the closures of a vehicle that may be dropped."""
        ends = [self._ends[c.keyframe_a, c.keyframe_b] for c in own]
        order = sorted(range(len(own)), key=lambda n: ends[n].distance_b)
        own = [own[n] for n in order]
        driven = np.array([ends[n].distance_b for n in order])
        firm = np.array([closure.keyframe_a in anchors for closure in own])
        places = poses[[closure.keyframe_b for closure in own], :2]
        bridge = _bridges(driven, fixed, frontier)
        gone, left = list[Closure](), np.ones(len(own), np.bool_)
        for n in np.flatnonzero(~bridge).tolist():
            earlier = left & firm & (driven < driven[n] - _SAME_VISIT)
            earlier &= ((places - places[n]) ** 2).sum(axis=1) < _SAME_PLACE**2
            if _visits(driven[earlier]) >= _VISITS:
                gone.append(own[n])
                left[n] = False
        return gone

    # ---- state

    def state_dict(self) -> State:
        """Return what was noted of the closures; see `from_state`."""
        rows = [(*key, *ends) for key, ends in self._ends.items()]
        return {'ends': np.array(rows, np.float64).reshape(-1, 6)}

    @classmethod
    def from_state(cls, state: State) -> Self:
        """Make a thinning that goes on where `state_dict` was called."""
        made = cls()
        for a, b, vehicle_a, distance_a, vehicle_b, distance_b in state['ends'].tolist():
            ends = _Ends(int(vehicle_a), distance_a, int(vehicle_b), distance_b)
            made._ends[int(a), int(b)] = ends
        return made


def _bridges(driven: Array, fixed: Array, frontier: float) -> NDArray[np.bool_]:
    """Return (n,) which closures hold a kept part of the path, or may come to hold one.

    These are the first and the last within QUERY_LENGTH, from which on closures are independent,
    on the way between two fixed keyframes. driven (n,), fixed (m,): distances driven (m),
    ascending; frontier: from there on, nothing is known of what will be fixed.
    """
    stops = np.concatenate([[-np.inf], fixed[fixed < frontier], [frontier]])
    after = np.searchsorted(stops, driven, 'left')
    first = driven[np.searchsorted(driven, stops[after - 1], 'left')]
    last = driven[np.searchsorted(driven, stops[np.minimum(after, len(stops) - 1)], 'right') - 1]
    held: NDArray[np.bool_] = (driven - first < QUERY_LENGTH) | (last - driven < QUERY_LENGTH)
    held |= driven >= frontier
    return held


def _visits(driven: Array) -> int:
    """Return in how many visits closures of a place were found; driven (n,): ascending."""
    return 1 + int((np.diff(driven) > _SAME_VISIT).sum()) if len(driven) else 0
