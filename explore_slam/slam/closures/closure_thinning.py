"""Select the closures of places visited often that may be dropped, to bound the graph by the area.

The closures of the first visits of a place close its loops. Those of later visits add little
information, but each of them keeps two keyframes in the graph. They are dropped, not
marginalized, once the vehicle has driven on. The closures at either end of a part of the path that
maps something new are kept, whatever the number of visits.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Self

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array
from explore_slam.slam.checkpoint import State
from explore_slam.slam.closures.anchors import Anchors
from explore_slam.slam.closures.closure import Closure, ClosureEnds

# Chosen by hand; test_closure_thinning shows what they decide.
_VISITS = 1  # of a place by a vehicle, whose closures are kept; 2 are no more accurate on Intel
_SAME_PLACE = 1.5  # m between two poses of a vehicle in the same place
_SAME_VISIT = 15.0  # m driven; nearer closures of a place belong to the same visit of it
# Closures that are kept between two kept anchors, at either end: where anchors are close together,
# more of them would let the graph grow with every visit (`explore_slam benchmark endurance`).
_AT_EITHER_END = 2

Key = tuple[int, int]  # of a closure: the keyframes a and b


class ClosureThinning:
    """Selects the closures that repeat those of earlier visits."""

    def __init__(self) -> None:
        self._ends: dict[Key, ClosureEnds] = {}

    def add(self, closures: Sequence[Closure], anchors: Anchors) -> None:
        """Add closures, whose anchors must exist."""
        for closure in closures:
            a, b = (anchors.of_keyframe(k) for k in (closure.keyframe_a, closure.keyframe_b))
            self._ends[a.keyframe, b.keyframe] = ClosureEnds.of(a, b)

    def forget(self, closures: Sequence[Closure]) -> None:
        """Forget closures that have been retracted or dropped."""
        for closure in closures:
            del self._ends[closure.keyframe_a, closure.keyframe_b]

    def redundant(
        self,
        closures: Sequence[Closure],
        poses: Array,
        anchors: Anchors,
        evaluated: Collection[int],
    ) -> list[Closure]:
        """Return the closures that may be dropped.

        closures: all that are part of the graph. poses (K, 3): of all keyframes. evaluated:
        keyframes whose anchors have been evaluated, see Thinning.
        """
        by_vehicle: dict[int, list[Closure]] = {}
        for closure in closures:
            ends = self._ends[closure.keyframe_a, closure.keyframe_b]
            by_vehicle.setdefault(ends.vehicle_b, []).append(closure)
        fixed = self._fixed(anchors, evaluated)
        return [
            closure
            for vehicle, own in sorted(by_vehicle.items())
            for closure in self._redundant_of(own, poses, anchors, *fixed[vehicle])
        ]

    def _fixed(
        self, anchors: Anchors, evaluated: Collection[int]
    ) -> Mapping[int, tuple[Array, float]]:
        """Return the anchors of each vehicle that closures must fix, and how far they are known.

        Both are distances driven (m): (n,) of the anchors that were evaluated and kept, and that
        of the first one that has not been evaluated.
        """
        kept: dict[int, list[float]] = {ends.vehicle_b: [] for ends in self._ends.values()}
        frontier = dict.fromkeys(kept, np.inf)
        for anchor in anchors:
            if anchor.vehicle not in kept:
                continue
            if anchor.keyframe in evaluated:
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
        """Return the ends of the closures; see `from_state`."""
        rows = [(*key, *ends) for key, ends in self._ends.items()]
        return {'ends': np.array(rows, np.float64).reshape(-1, 6)}

    @classmethod
    def from_state(cls, state: State) -> Self:
        """Make a thinning that continues exactly from a state of `state_dict`."""
        made = cls()
        for a, b, vehicle_a, distance_a, vehicle_b, distance_b in state['ends'].tolist():
            ends = ClosureEnds(int(vehicle_a), distance_a, int(vehicle_b), distance_b)
            made._ends[int(a), int(b)] = ends
        return made


def _bridges(driven: Array, fixed: Array, frontier: float) -> NDArray[np.bool_]:
    """Return (n,) which closures fix a kept part of the path, or may come to fix one.

    These are, between two fixed keyframes, the first and the last few. driven (n,), fixed (m,):
    distances driven (m), ascending; frontier (m): from there on, it is not known which keyframes
    will be fixed.
    """
    stops = np.concatenate([[-np.inf], fixed[fixed < frontier], [frontier]])
    after = np.searchsorted(stops, driven, 'left')
    first = np.searchsorted(driven, stops[after - 1], 'right')
    end = np.searchsorted(driven, stops[np.minimum(after, len(stops) - 1)], 'right')
    own = np.arange(len(driven))
    held: NDArray[np.bool_] = (own < first + _AT_EITHER_END) | (own >= end - _AT_EITHER_END)
    held |= driven >= frontier
    return held


def _visits(driven: Array) -> int:
    """Return the number of visits with closures of a place; driven (n,) m: ascending."""
    return 1 + int((np.diff(driven) > _SAME_VISIT).sum()) if len(driven) else 0
