"""What the agent knows of one vehicle beside the belief: odometry, keyframe, what waits for it."""

import heapq
from dataclasses import dataclass, field, replace

import numpy as np

from explore_slam.agent.odometry import OdometryBuffer, Step
from explore_slam.data import (
    InterRobotObservation,
    LandmarkObservations,
    LaserScan,
    Plan,
    RgbdFrame,
    VehicleState,
)
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.mapping import ScanMatcher
from explore_slam.vision import KeyframeSelector

Observation = LaserScan | RgbdFrame | LandmarkObservations | InterRobotObservation


@dataclass(frozen=True)
class Keyframe:
    """A vehicle's newest keyframe: running number in the belief, stamp (s), odometry pose."""

    number: int
    stamp: float
    odometry: Pose2


@dataclass
class VehicleTrack:
    """One vehicle: chain of odometry, newest keyframe, observations that wait for odometry."""

    name: str
    start: Pose2
    odometry: OdometryBuffer
    selector: KeyframeSelector
    matcher: ScanMatcher
    keyframe: Keyframe | None = None
    last_scan: tuple[float, Pose2] | None = None  # stamp and odometry of the last scan kept
    refined_until: float = -np.inf  # stamp up to which scans have refined the odometry
    last_tried: float = -np.inf  # stamp of the last scan that was to be matched
    last_heard: float = -np.inf  # the agent's time (s) when odometry came last
    last_seen: float = -np.inf  # stamp of the last frame or landmarks that were used
    plan: Plan | None = None
    state: VehicleState = VehicleState.WAITING
    follower: str = ''
    counts: dict[str, int] = field(default_factory=dict)
    _waiting: list[tuple[float, int, Observation]] = field(default_factory=list)
    _unmatched: list[tuple[float, int, LaserScan]] = field(default_factory=list)
    _order: int = 0

    def count(self, name: str) -> None:
        """Count one event, e.g. a dropped frame."""
        self.counts[name] = self.counts.get(name, 0) + 1

    def wait(self, observation: Observation, most: int) -> None:
        """Keep an observation until odometry reaches its stamp; the oldest goes when too many."""
        self._order += 1
        heapq.heappush(self._waiting, (observation.stamp, self._order, observation))
        if len(self._waiting) > most:
            heapq.heappop(self._waiting)
            self.count('dropped_without_odometry')

    def wait_for_match(self, scan: LaserScan, most: int) -> None:
        """Keep a scan until it can be matched; the oldest goes when there are too many."""
        heapq.heappush(self._unmatched, (scan.stamp, self._order, scan))
        if len(self._unmatched) > most:
            heapq.heappop(self._unmatched)

    def next_to_match(self) -> LaserScan | None:
        """Return the oldest scan to be matched that odometry has reached, or None."""
        if not self._unmatched or self._unmatched[0][0] > self.odometry.last:
            return None
        scan = heapq.heappop(self._unmatched)[2]
        self.last_tried = max(self.last_tried, scan.stamp)
        return scan

    def next_ready(self, patience: float) -> Observation | None:
        """Return the oldest waiting observation that odometry has reached, or None.

        Where scans come and are matched, it waits for the next scan too, at most for the
        patience (s): the motion up to it is known well only then.
        """
        if not self._waiting or self._waiting[0][0] > self.odometry.last:
            return None
        stamp = self._waiting[0][0]
        matching = stamp - patience < self.last_tried < stamp
        if matching and self.odometry.last < stamp + patience:
            return None
        return heapq.heappop(self._waiting)[2]

    def follow_clock_back(self) -> None:
        """Go on in a new time: what waits belongs to another, the keyframe is here and now."""
        for _ in self._waiting:
            self.count('dropped_by_clock_jump')
        self._waiting.clear()
        self._unmatched.clear()
        self.selector.reset()
        self.matcher.reset()
        self.last_scan, self.last_seen = None, -np.inf
        self.refined_until = self.last_tried = -np.inf
        if self.keyframe is not None:
            self.keyframe = replace(self.keyframe, stamp=self.odometry.last)

    def moved_since_keyframe(self, stamp: float) -> Pose2:
        """Return the motion from the newest keyframe (or the start) to a stamp."""
        if self.keyframe is None or not len(self.odometry):
            return IDENTITY
        return self.keyframe.odometry.between(self.odometry.at(stamp))

    def steps_since_keyframe(self, stamp: float) -> list[Step]:
        """Return the steps from the newest keyframe to a stamp, reading by reading."""
        if self.keyframe is None:
            return []
        steps = self.odometry.steps(self.keyframe.stamp, stamp)
        if self.odometry.first > self.keyframe.stamp:  # older readings are gone: one step for them
            older = self.keyframe.odometry.between(self.odometry.at(0.0))
            steps.insert(0, Step(older, None))
        return steps
