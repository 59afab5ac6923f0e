"""Loops closed by laser: scans hang on the filter's keyframes, later scans are searched on them.

The filter knows nothing of scans and the search nothing of particles: keyframes, their poses and
relative covariances go to the search, relative poses of keyframes come back and become part of the
belief. Both are tied together here, in the agent, which knows the two.
"""

import math
from typing import NamedTuple, Self

import numpy as np

from explore_slam.agent.vehicle_track import Keyframe
from explore_slam.geometry import Pose2, moved_enough
from explore_slam.registration import PointCloud
from explore_slam.slam import RelativePose, TeamBelief
from explore_slam.slam.checkpoint import State, part, under
from explore_slam.slam.closures import Closure, ClosureConfig, LoopSearch, Thinning

# Keyframes of a vehicle that rests follow each other in time: they show the same.
_ANCHOR_DISTANCE, _ANCHOR_HEADING = 0.1, 0.1  # m, rad
_THINNING_SPACING = 10  # anchors between two searches for redundant ones


class _Last(NamedTuple):
    """The newest keyframe of a vehicle that has an anchor, and the way (m) until there."""

    keyframe: Keyframe
    way: float


class ClosureCounts(NamedTuple):
    """How many closures a scan has led to, and how many were taken back."""

    closed: int = 0
    taken_back: int = 0


class LoopClosing:
    """Anchors of all vehicles, the search for closures, and what the belief was told of them."""

    def __init__(self, config: ClosureConfig) -> None:
        self.search = LoopSearch(config)
        self.thinning = Thinning(self.search.anchors)
        self._last: dict[int, _Last] = {}
        self._ways: dict[int, float] = {}
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
        """Hang a scan on the keyframe before it, if it is the first there, and search for loops.

        offset: motion since the keyframe; cloud: in the vehicle frame at the stamp (s).
        """
        if not self.config.laser_closures or not belief.closes_loops:
            return ClosureCounts()
        number = belief.vehicles.index(vehicle)
        last = self._last.get(number)
        way = self._ways.get(number, 0.0)
        if last is not None:
            moved = last.keyframe.odometry.between(keyframe.odometry)
            if not moved_enough(moved, _ANCHOR_DISTANCE, _ANCHOR_HEADING):
                return ClosureCounts()
            way = last.way + math.hypot(moved.x, moved.y)
        self._last[number], self._ways[number] = _Last(keyframe, way), way
        self.search.add_anchor(keyframe.number, number, cloud.moved(offset), way, stamp)
        belief.pin(keyframe.number)
        found = self.search.search(
            keyframe.number,
            belief.best_path(),
            belief.relative_covariance,
            belief.in_one_map_with(vehicle),
        )
        if found:
            numbers = belief.close_loops([_relative_pose(closure) for closure in found])
            self._numbers |= dict(zip(map(_key, found), numbers, strict=True))
        taken_back = self._take_back(belief)
        if self.search.anchors.number_added(number) % _THINNING_SPACING == 0:
            self._thin(belief)
        return ClosureCounts(len(found), taken_back)

    def _take_back(self, belief: TeamBelief) -> int:
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
            belief.reopen_loop(self._numbers.pop(_key(closure)))
        return len(found)

    def _thin(self, belief: TeamBelief) -> None:
        """Remove the anchors that show nothing new, so that the area bounds them."""
        covariance = belief.relative_covariance
        for keyframe in self.thinning.redundant(belief.best_path(), covariance):
            self.search.remove_anchor(keyframe)
            belief.unpin(keyframe)

    # ---- state

    def state_dict(self) -> State:
        """Return everything but the odometry, whose frame does not survive a restart."""
        return {
            **under('search', self.search.state_dict()),
            'judged': np.array(sorted(self.thinning.judged), np.int64),
            'ways': np.array(list(self._ways.items()), np.float64).reshape(-1, 2),
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
        made.thinning.judged = set(state['judged'].tolist())
        made._ways = {int(vehicle): way for vehicle, way in state['ways'].tolist()}
        made._numbers = {(a, b): number for a, b, number in state['numbers'].tolist()}
        made._redraws = int(state['redraws'])
        return made


def _key(closure: Closure) -> tuple[int, int]:
    return closure.keyframe_a, closure.keyframe_b


def _relative_pose(closure: Closure) -> RelativePose:
    return RelativePose(closure.keyframe_a, closure.keyframe_b, closure.pose, closure.information)
