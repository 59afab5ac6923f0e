"""Loops closed by laser: later scans are matched with those attached to the filter's keyframes.

Vehicles of unknown start are searched in the whole map, every few metres. That takes up to a
second; it is done in slices, some regions of the map with every scan that arrives, so that no
scan waits for it and the result depends on the records alone.

The filter knows nothing of scans and the search nothing of particles: keyframes, their poses and
relative covariances go to the search, relative poses of keyframes come back and become part of the
belief. Both are tied together here, in the agent, which knows the two.
"""

import logging
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple, Self

import numpy as np

from explore_slam.agent.vehicle_track import Keyframe
from explore_slam.errors import SlamError
from explore_slam.geometry import Pose2, between, moved_enough
from explore_slam.registration import PointCloud
from explore_slam.slam import RelativePose, TeamBelief
from explore_slam.slam.checkpoint import State, part, under
from explore_slam.slam.closures import (
    Closure,
    ClosureConfig,
    ClosureThinning,
    GlobalSearch,
    LoopSearch,
    Thinning,
    join_transform,
)

logger = logging.getLogger(__name__)

# Keyframes of a vehicle that rests follow each other in time: they show the same.
_ANCHOR_DISTANCE, _ANCHOR_HEADING = 0.1, 0.1  # m, rad
_THINNING_SPACING = 10  # anchors between two searches for redundant ones
# Places at which a loop may be closed on purpose: driven since then (m), as far as a laser sees
# ahead and back; distance (m) between two of them.
_LOOP_DISTANCE, _PLACE_SPACING = 25.0, 1.0
# Global searches of a vehicle of unknown start: distance driven between two, and how many regions
# are searched per scan of the team. On Intel, cut in two (`benchmark mapping --cut 1325 --starts
# unknown`), such a slice of four took 0.08 s in the median and 0.3 s at most, on two busy cores.
_QUERY_SPACING = 1.0  # m
_REGIONS_PER_SCAN = 4


class _Last(NamedTuple):
    """The newest keyframe of a vehicle with an anchor, and the distance driven (m) until there."""

    keyframe: Keyframe
    distance_driven: float


class ClosureCounts(NamedTuple):
    """How many closures a scan has led to, and how many were retracted."""

    closed: int = 0
    retracted: int = 0


class Join(NamedTuple):
    """A vehicle whose map was tied to that of others by closures for the first time.

    distance_driven (m): until then. relative: pose, right afterwards, of its keyframe at stamp (s)
    in the frame of the other's keyframe at other_stamp (s); one of the closures measured it.
    """

    vehicle: str
    stamp: float
    distance_driven: float
    other: str
    other_stamp: float
    relative: Pose2


class LoopClosing:
    """Anchors of all vehicles, the search for closures, and their factors in the filter."""

    def __init__(self, config: ClosureConfig) -> None:
        self.search = LoopSearch(config)
        self.thinning = Thinning(self.search.anchors)
        self.closure_thinning = ClosureThinning()
        self.global_search = GlobalSearch(config, self.search.anchors)
        self._searching: tuple[str, Iterator[list[Closure]]] | None = None
        # distance driven (m) at a vehicle's newest global search
        self._searched: dict[int, float] = {}
        self._tied: set[tuple[int, int]] = set()  # pairs of vehicles that closures have tied
        self._joins: list[Join] = []
        self._last: dict[int, _Last] = {}
        self._distances_driven: dict[int, float] = {}
        self._numbers: dict[tuple[int, int], int] = {}  # of closures in the belief
        self._redraws = 0

    @property
    def config(self) -> ClosureConfig:
        """Settings in force."""
        return self.search.config

    def add_scan(
        self,
        belief: TeamBelief,
        vehicle: str,
        keyframe: Keyframe,
        offset: Pose2,
        cloud: PointCloud,
        stamp: float,
    ) -> ClosureCounts:
        """Attach a scan to the keyframe before it, if it is the first there, and search for loops.

        offset: motion since the keyframe; cloud: in the vehicle frame at the stamp (s).
        """
        if not self.config.laser_closures or not belief.closes_loops:
            return ClosureCounts()
        number = belief.vehicles.index(vehicle)
        last = self._last.get(number)
        distance_driven = self._distances_driven.get(number, 0.0)
        if last is not None:
            if last.keyframe.number == keyframe.number:
                return ClosureCounts()
            moved = last.keyframe.odometry.between(keyframe.odometry)
            if not moved_enough(moved, _ANCHOR_DISTANCE, _ANCHOR_HEADING):
                return ClosureCounts()
            distance_driven = last.distance_driven + math.hypot(moved.x, moved.y)
        self._last[number], self._distances_driven[number] = (
            _Last(keyframe, distance_driven),
            distance_driven,
        )
        self.search.add_anchor(
            keyframe.number, number, cloud.moved(offset), distance_driven, stamp
        )
        belief.pin(keyframe.number)
        found = self.search.search(
            keyframe.number,
            belief.best_path(),
            belief.relative_covariance,
            belief.in_one_map_with(vehicle),
        )
        if found:
            numbers = belief.close_loops([_relative_pose(closure) for closure in found])
            self._note_closures(belief, found, numbers)
        if not belief.is_in_map(vehicle):
            self._begin_global_search(belief, number, keyframe.number)
        retracted = self._retract_inconsistent(belief)
        if self.search.anchors.number_added(number) % _THINNING_SPACING == 0:
            self._thin(belief)
        return ClosureCounts(len(found), retracted)

    def known_places(
        self, belief: TeamBelief, vehicle: str, reach: float
    ) -> list[tuple[float, float, float]]:
        """Return places at which a vehicle may close a loop: x, y, deviation of the position (m).

        They are anchors within a reach (m) of its newest one in the map, of other vehicles, or so
        far back on its own way that the map between may have an error (Stachniss et al., 2004).
        The deviation is the largest standard deviation relative to the vehicle.
        """
        number = belief.vehicles.index(vehicle)
        last = self._last.get(number)
        if last is None or not self.config.laser_closures or not belief.closes_loops:
            return []
        table, path = self.search.anchors.table(), belief.best_path()
        tied = belief.in_one_map_with(vehicle)
        own = table.vehicles == number
        back = last.distance_driven - table.distances_driven
        places = path[table.keyframes, :2]
        distances = np.hypot(*(places - path[last.keyframe.number, :2]).T)
        wanted = np.where(own, back >= _LOOP_DISTANCE, np.isin(table.vehicles, tied))
        chosen: list[int] = []
        for n in np.flatnonzero(wanted & (distances <= reach)):
            if not chosen or np.hypot(*(places[chosen] - places[n]).T).min() >= _PLACE_SPACING:
                chosen.append(int(n))
        if not chosen:
            return []
        P = belief.relative_covariance(last.keyframe.number, table.keyframes[chosen], keep=False)
        largest = np.linalg.eigvalsh(P[:, :2, :2])[:, 1]
        deviations = np.sqrt(np.maximum(largest, 0.0))
        return list(zip(*places[chosen].T.tolist(), deviations.tolist(), strict=True))

    def take_joins(self) -> list[Join]:
        """Return the joins since the last call."""
        joins, self._joins = self._joins, []
        return joins

    def report_join(self, join: Join, pair: tuple[int, int]) -> None:
        """Take the report of a join by something else than closures; pair: of vehicles."""
        first, second = sorted(pair)
        if (first, second) not in self._tied:
            self._tied.add((first, second))
            self._joins.append(join)

    def search_joins(self, belief: TeamBelief) -> None:
        """Go on searching for a vehicle of unknown start; join it to the map when it is found."""
        if self._searching is None:
            return
        vehicle, steps = self._searching
        for _ in range(_REGIONS_PER_SCAN):
            found = next(steps, None)
            if found is None or belief.is_in_map(vehicle):
                self._searching = None
                return
            if found:
                self._searching = None
                self._join(belief, vehicle, found)
                return

    def _begin_global_search(self, belief: TeamBelief, number: int, keyframe: int) -> None:
        """Search for a vehicle in the map, at the anchor of a keyframe, if that is due."""
        distance_driven = self._distances_driven[number]
        if (
            self._searching
            or distance_driven - self._searched.get(number, -math.inf) < _QUERY_SPACING
        ):
            return
        self._searched[number] = distance_driven
        localized = [n for n, name in enumerate(belief.vehicles) if belief.is_in_map(name)]
        steps = self.global_search.search(keyframe, belief.best_path(), localized)
        self._searching = belief.vehicles[number], steps

    def _join(self, belief: TeamBelief, vehicle: str, found: Sequence[Closure]) -> None:
        """Take a vehicle into the map by closures that agree on where it is."""
        frame = join_transform(found, belief.best_path())
        try:
            numbers = belief.join(vehicle, frame, [_relative_pose(closure) for closure in found])
        except SlamError as error:
            logger.warning('%s cannot join the map: %s', vehicle, error)
            return
        self.search.adopt(found)
        self._note_closures(belief, found, numbers)
        distance_driven = self._distances_driven[belief.vehicles.index(vehicle)]
        logger.info('%s joined the map after driving %.1f m', vehicle, distance_driven)

    def _note_closures(
        self, belief: TeamBelief, found: Sequence[Closure], numbers: Sequence[int]
    ) -> None:
        """Note closures that have become part of the belief, with their numbers there."""
        self._numbers |= dict(zip(map(_key, found), numbers, strict=True))
        self.closure_thinning.add(found, self.search.anchors)
        self._note_ties(belief, found)

    def _note_ties(self, belief: TeamBelief, found: Sequence[Closure]) -> None:
        """Note the vehicles that closures tie together for the first time."""
        anchors = self.search.anchors
        for closure in reversed(found):
            ends = [anchors.of_keyframe(k) for k in (closure.keyframe_a, closure.keyframe_b)]
            other, joined = sorted(ends, key=lambda end: end.vehicle)
            pair = other.vehicle, joined.vehicle
            if pair[0] == pair[1] or pair in self._tied:
                continue
            self._tied.add(pair)
            path = belief.best_path()
            self._joins.append(
                Join(
                    belief.vehicles[joined.vehicle],
                    belief.stamp_of(joined.keyframe),
                    self._distances_driven[joined.vehicle],
                    belief.vehicles[other.vehicle],
                    belief.stamp_of(other.keyframe),
                    Pose2.from_array(between(path[other.keyframe], path[joined.keyframe])),
                )
            )

    def _retract_inconsistent(self, belief: TeamBelief) -> int:
        """Remove the closures that contradict the path since it was drawn anew."""
        if belief.redraws == self._redraws or not self.search.closures:
            return 0
        self._redraws = belief.redraws
        distances = belief.closure_distances()
        closures = self.search.closures
        found = self.search.recheck(
            np.array([distances[self._numbers[_key(closure)]] for closure in closures])
        )
        for closure in found:
            belief.retract_closure(self._numbers.pop(_key(closure)))
        self.closure_thinning.forget(found)
        return len(found)

    def _thin(self, belief: TeamBelief) -> None:
        """Remove anchors and closures that add no information: the area bounds their number."""
        frames = [-1 if belief.is_in_map(v) else n for n, v in enumerate(belief.vehicles)]
        path = belief.best_path()
        for keyframe in self.thinning.redundant(path, belief.relative_covariance, frames):
            self.global_search.remove_anchor(keyframe)
            self.search.remove_anchor(keyframe)
            belief.unpin(keyframe)
        redundant = self.closure_thinning.redundant(
            self.search.closures, path, self.search.anchors, self.thinning.evaluated
        )
        for closure in redundant:
            belief.drop_closure(self._numbers.pop(_key(closure)))
        self.search.drop(redundant)
        self.closure_thinning.forget(redundant)

    # ---- state

    def state_dict(self) -> State:
        """Return everything but the odometry, whose frame does not survive a restart.

        A global search that is going on is given up, here as in what is restored.
        """
        self._searching = None
        return {
            **under('search', self.search.state_dict()),
            **under('global_search', self.global_search.state_dict()),
            'searched': np.array(list(self._searched.items()), np.float64).reshape(-1, 2),
            'tied': np.array(sorted(self._tied), np.int64).reshape(-1, 2),
            'evaluated': np.array(sorted(self.thinning.evaluated), np.int64),
            **under('closure_thinning', self.closure_thinning.state_dict()),
            'distances_driven': np.array(list(self._distances_driven.items()), np.float64).reshape(
                -1, 2
            ),
            'numbers': np.array(
                [(*key, number) for key, number in self._numbers.items()], np.int64
            ).reshape(-1, 3),
            'redraws': np.array(self._redraws),
        }

    @classmethod
    def from_state(cls, state: State, config: ClosureConfig) -> Self:
        """Make what `state_dict` returned."""
        made = cls(config)
        made.search = LoopSearch.from_state(part('search', state), config)
        made.thinning = Thinning(made.search.anchors)
        made.thinning.evaluated = set(state['evaluated'].tolist())
        made.closure_thinning = ClosureThinning.from_state(part('closure_thinning', state))
        anchors = made.search.anchors
        pending = part('global_search', state)
        made.global_search = GlobalSearch.from_state(pending, config, anchors)
        made._searched = {
            int(vehicle): distance_driven
            for vehicle, distance_driven in state['searched'].tolist()
        }
        made._tied = {(a, b) for a, b in state['tied'].tolist()}
        made._distances_driven = {
            int(vehicle): distance_driven
            for vehicle, distance_driven in state['distances_driven'].tolist()
        }
        made._numbers = {(a, b): number for a, b, number in state['numbers'].tolist()}
        made._redraws = int(state['redraws'])
        return made


def _key(closure: Closure) -> tuple[int, int]:
    return closure.keyframe_a, closure.keyframe_b


def _relative_pose(closure: Closure) -> RelativePose:
    return RelativePose(closure.keyframe_a, closure.keyframe_b, closure.pose, closure.information)
