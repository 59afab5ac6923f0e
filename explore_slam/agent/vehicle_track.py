"""What the agent knows of one vehicle beside the belief: odometry, keyframe, what waits for it."""

import heapq
from dataclasses import dataclass, field

import numpy as np

from explore_slam.agent.odometry import OdometryBuffer, Step
from explore_slam.data import (
    LandmarkObservations,
    LaserScan,
    Plan,
    RgbdFrame,
    VehicleSighting,
    VehicleState,
)
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.mapping import ScanMatcher
from explore_slam.vision import KeyframeSelector

_SCANS_FIRST = 1 << 40
Observation = LaserScan | RgbdFrame | LandmarkObservations | VehicleSighting


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
    last_match: float = -np.inf  # stamp of the last scan that was matched with earlier ones
    last_heard: float = -np.inf  # the agent's time (s) when odometry came last
    last_seen: float = -np.inf  # stamp of the last frame or landmarks that were used
    plan: Plan | None = None
    state: VehicleState = VehicleState.WAITING
    follower: str = ''
    counts: dict[str, int] = field(default_factory=dict)
    _waiting: list[tuple[float, int, Observation]] = field(default_factory=list)
    _order: int = 0

    def count(self, name: str) -> None:
        """Count one event, e.g. a dropped frame."""
        self.counts[name] = self.counts.get(name, 0) + 1

    def wait(self, observation: Observation, most: int) -> None:
        """Keep an observation until odometry reaches its stamp; the oldest goes when too many."""
        self._order += 1
        # of one stamp scans come first: they refine the motion that the others are used with
        order = self._order if isinstance(observation, LaserScan) else self._order + _SCANS_FIRST
        heapq.heappush(self._waiting, (observation.stamp, order, observation))
        if len(self._waiting) > most:
            heapq.heappop(self._waiting)
            self.count('dropped_without_odometry')

    def next_ready(self) -> Observation | None:
        """Return the oldest waiting observation that odometry has reached, or None."""
        if not self._waiting or self._waiting[0][0] > self.odometry.last:
            return None
        return heapq.heappop(self._waiting)[2]

    def forget_waiting(self) -> None:
        """Drop what waits: it belongs to another time."""
        for _ in self._waiting:
            self.count('dropped_by_clock_jump')
        self._waiting.clear()

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
