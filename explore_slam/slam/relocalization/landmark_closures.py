"""Loops closed by landmarks, as far back as they may still turn out to be wrong.

A loop is closed when a vehicle observes landmarks again that it, or another vehicle, mapped some
time ago: by data association, or by a search. In both cases, its observations are from then on
those of old landmarks. Where two places look the same, that may be wrong. A closure is retracted
by giving the observations of old landmarks since then to new ones, which look the same but are
elsewhere: no measurement is lost, only the assumption that both are one.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.slam.checkpoint import State
from explore_slam.slam.graph import JointGraph
from explore_slam.slam.landmarks.landmark_map import LandmarkMap
from explore_slam.slam.storage.ancestry import AncestryTree
from explore_slam.slam.storage.row_format import Places

# Old landmarks in one update that close a loop: fewer can be wrong associations, which the robust
# kernel of the joint graph copes with. As many determine a pose (see `Relocalizer`).
_MINIMUM_LANDMARKS = 3
# m driven without old landmarks, after which they close a loop again; the same as for landmarks
# that count as recent (see `LandmarkLoops`).
_SPACING = 10.0
# m driven without old landmarks, after which a new run of such observations begins. A closure
# begins with its run: single observations before it rely on the same assumption.
_GAP = 3.0
_MAXIMUM_CLOSURES = 8  # newest ones of the team that are kept


class LandmarkClosure(NamedTuple):
    """The first observation of old landmarks after a distance without any.

    keyframe: its number in the joint graph. first_recent: landmarks of this vehicle from this id
    on count as recent, all others as old. merged (n,): numbers of earlier observations in the
    graph, of landmarks that a search found to be old ones.
    """

    vehicle: int
    keyframe: int
    first_recent: int
    merged: Places

    def are_old(self, ids: Places, landmarks: LandmarkMap) -> NDArray[np.bool_]:
        """Return (n,) which landmarks of the map, by id, are old."""
        entries = landmarks.entries_with(ids)
        recent = (ids >= self.first_recent) & (landmarks.owners[entries] == self.vehicle)
        found: NDArray[np.bool_] = (entries >= 0) & ~recent
        return found

    def live_keyframe(self, graph: JointGraph) -> int | None:
        """Return the first keyframe of the vehicle since the closure that is in the graph."""
        live = graph.live_keyframes()
        later = live[live >= self.keyframe]
        own = later[graph.vehicles_of(later) == self.vehicle]
        return int(own[0]) if len(own) else None


class _Run(NamedTuple):
    """Updates of a vehicle that observe old landmarks, at a spacing of at most _GAP.

    keyframe: of the first one; began, newest: distances driven (m) at the first and the last.
    """

    keyframe: int
    began: float
    newest: float


class LandmarkClosures:
    """The newest closures of a team, oldest first."""

    def __init__(self) -> None:
        self.closures: list[LandmarkClosure] = []
        self._runs: dict[int, _Run] = {}
        # distance driven (m) by each vehicle when it last observed enough old landmarks
        self._observed_at: dict[int, float] = {}

    def note(
        self, closure: LandmarkClosure, is_old: NDArray[np.bool_], distance_driven: float
    ) -> None:
        """Note an update; it becomes a closure if it observes old landmarks after a while.

        is_old (n,): which of the observed landmarks are old; distance_driven (m) by the vehicle.
        """
        vehicle, count = closure.vehicle, np.count_nonzero(is_old)
        if not count:
            return
        run = self._runs.get(vehicle)
        if run is None or distance_driven - run.newest > _GAP:
            run = _Run(closure.keyframe, distance_driven, distance_driven)
        self._runs[vehicle] = run._replace(newest=distance_driven)
        if count < _MINIMUM_LANDMARKS:
            return
        if distance_driven - self._observed_at.get(vehicle, 0.0) >= _SPACING:
            if distance_driven - run.began < _SPACING:
                closure = closure._replace(keyframe=run.keyframe)
            self.add(closure, distance_driven)
        self._observed_at[vehicle] = distance_driven

    def add(self, closure: LandmarkClosure, distance_driven: float) -> None:
        """Add a closure; the oldest ones are forgotten."""
        self._observed_at[closure.vehicle] = distance_driven
        self.closures = [*self.closures, closure][-_MAXIMUM_CLOSURES:]

    def retract(self, closure: LandmarkClosure) -> None:
        """Forget a closure that has been retracted."""
        self.closures = [other for other in self.closures if other is not closure]

    def newest(self, vehicle: int, tied: set[int]) -> list[LandmarkClosure]:
        """Return the newest closure of each tied vehicle: the vehicle's own, then newest first."""
        newest = {closure.vehicle: closure for closure in self.closures if closure.vehicle in tied}
        return sorted(newest.values(), key=lambda c: (c.vehicle != vehicle, -c.keyframe))

    def state_dict(self) -> State:
        """Return the closures."""
        rows = [(c.vehicle, c.keyframe, c.first_recent, len(c.merged)) for c in self.closures]
        merged = [closure.merged for closure in self.closures]
        return {
            'closures': np.array(rows, np.int64).reshape(-1, 4),
            'merged': np.concatenate([np.empty(0, np.int64), *merged]),
            'observed_at': np.array(list(self._observed_at.items()), np.float64).reshape(-1, 2),
            'runs': np.array([(v, *run) for v, run in self._runs.items()], np.float64).reshape(
                -1, 4
            ),
        }

    def restore(self, state: State) -> None:
        """Restore what `state_dict` returned."""
        rows = state['closures'].tolist()
        ends = np.cumsum([row[3] for row in rows]).astype(np.int64)
        merged = np.split(state['merged'], ends[:-1]) if rows else []
        self.closures = [
            LandmarkClosure(vehicle, keyframe, first, numbers.copy())
            for (vehicle, keyframe, first, _), numbers in zip(rows, merged, strict=True)
        ]
        self._observed_at = {int(vehicle): at for vehicle, at in state['observed_at'].tolist()}
        self._runs = {
            int(vehicle): _Run(int(keyframe), began, newest)
            for vehicle, keyframe, began, newest in state['runs'].tolist()
        }


class Separation(NamedTuple):
    """Landmarks (n,) of which a retracted closure's observations were taken, and their copies.

    counts (n,): how many observations each copy has been given.
    """

    vehicle: int
    landmarks: Places
    copies: Places
    counts: Places

    def renamed(self, ids: Places) -> Places:
        """Return ids (K,) with the copies in place of the landmarks."""
        renamed = ids.copy()
        if len(self.landmarks):
            at = np.minimum(np.searchsorted(self.landmarks, ids), len(self.landmarks) - 1)
            known = self.landmarks[at] == ids
            renamed[known] = self.copies[at[known]]
        return renamed

    def add_copies(self, landmarks: LandmarkMap, tree: AncestryTree) -> None:
        """Register the copies in the landmark map, before the particles are redrawn."""
        entries = landmarks.entries_with(self.landmarks)
        landmarks.add_copies(entries, self.vehicle, self.counts, tree)


def separate(graph: JointGraph, landmarks: LandmarkMap, closure: LandmarkClosure) -> Separation:
    """Give the observations that a closure is made of to new landmarks of the graph.

    The landmark map does not know these yet; see `Separation.add_copies`.
    """
    ids, numbers = graph.observations_since(closure.keyframe)
    earlier = closure.merged[~np.isin(closure.merged, numbers)]
    merged_ids, merged_numbers = graph.observed_landmarks(earlier)
    ids, numbers = np.append(ids, merged_ids), np.append(numbers, merged_numbers)
    old = closure.are_old(ids, landmarks)
    sources, which, counts = np.unique(ids[old], return_inverse=True, return_counts=True)
    copies = landmarks.next_id + np.arange(len(sources))
    graph.move_observations(numbers[old], copies[which])
    return Separation(closure.vehicle, sources, copies, counts)
