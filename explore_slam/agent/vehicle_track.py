"""The agent's state of one vehicle, apart from the filter and the map."""

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from explore_slam.agent.bridge_noise import BridgeNoise
from explore_slam.agent.measurement_queue import MeasurementQueue, Stamped
from explore_slam.agent.odometry import OdometryBuffer, Step
from explore_slam.agent.odometry_sources import OdometrySource, SlipMonitor, WheelSource
from explore_slam.agent.placement import Placement
from explore_slam.agent.scan_sets import ScanSets
from explore_slam.agent.sweep_queue import SweepQueues
from explore_slam.data import (
    FollowerReport,
    LaserScan,
    ObstacleView,
    Plan,
    VehicleBody,
    VehicleState,
)
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.registration import PointCloud, ScanMatcher, ScanMatchingConfig
from explore_slam.vision import KeyframeSelector
from explore_slam.vision.sections import KeyframeConfig

_CLOUDS = 50  # as many scans as may wait by default


@dataclass(frozen=True)
class Keyframe:
    """A vehicle's newest keyframe: number in the filter, stamp (s), odometry pose there."""

    number: int
    stamp: float
    odometry: Pose2


@dataclass
class VehicleTrack:
    """Odometry, newest keyframe, waiting measurements and plan of one vehicle.

    start: its pose in the map, None: unknown.
    placement: whether its pose can be relied on.
    source: what its odometry is measured by.
    slip: whether odometry agrees with the scans.
    bridge: what it errs by between two of them.
    unmapped: its scans are matched, but do not enter the map.
    body: its size and speed.
    last_scans: stamp (s) and odometry pose of the newest scan of each laser in the map.
    last_views: the same of the newest view of obstacles of each camera.
    new_views: the newest of obstacles by each camera that nobody has taken yet.
    has_camera: whether there have been views of obstacles.
    matched_until: stamp (s) up to which scan matching has refined the odometry.
    sweeps: scans whose beams were measured one after the other, until odometry covers them.
    sets: clouds of several lasers, until they can be matched together.
    clouds: stamps (s) and point clouds of the newest scans that were placed by matching.
    last_match_attempt: stamp (s) of the newest scan that was passed to scan matching.
    scan_period: time (s) between that scan and the one before; inf if it was the first.
    last_heard: time (s) of the agent when odometry arrived last.
    last_seen: stamp (s) of the newest frame or landmarks that were processed.
    follower: newest report of the path follower.
    counts: events by name, e.g. measurements that were left out.
    """

    name: str
    start: Pose2 | None
    odometry: OdometryBuffer
    selector: KeyframeSelector
    matcher: ScanMatcher
    placement: Placement
    body: VehicleBody = field(default_factory=VehicleBody)
    source: OdometrySource = field(default_factory=WheelSource)
    unmapped: bool = False
    keyframe: Keyframe | None = None
    last_scans: dict[str, tuple[float, Pose2]] = field(default_factory=dict)
    last_views: dict[str, tuple[float, Pose2]] = field(default_factory=dict)
    new_views: dict[str, ObstacleView] = field(default_factory=dict)
    has_camera: bool = False
    matched_until: float = -np.inf
    last_match_attempt: float = -np.inf
    scan_period: float = np.inf
    last_heard: float = -np.inf
    last_seen: float = -np.inf
    plan: Plan | None = None
    state: VehicleState = VehicleState.WAITING
    follower: FollowerReport | None = None
    counts: dict[str, int] = field(default_factory=dict)
    waiting: MeasurementQueue[Stamped] = field(default_factory=MeasurementQueue)
    unmatched: MeasurementQueue[LaserScan] = field(default_factory=MeasurementQueue)
    clouds: deque[tuple[float, PointCloud]] = field(default_factory=lambda: deque(maxlen=_CLOUDS))
    sets: ScanSets = field(default_factory=ScanSets)
    bridge: BridgeNoise = field(default_factory=BridgeNoise)
    sweeps: SweepQueues = field(init=False)
    slip: SlipMonitor = field(init=False)

    def __post_init__(self) -> None:
        self.sweeps = SweepQueues(self.name)
        self.slip = SlipMonitor(self.name, self.source.name)
        if self.source.needs_scans:
            self.sweeps.never_hold()
        self._selectors: dict[str, KeyframeSelector] = {}

    def count(self, name: str, times: int = 1) -> None:
        """Count an event that has happened once, some times, or not at all."""
        if times:
            self.counts[name] = self.counts.get(name, 0) + times

    def selector_of(self, camera: str) -> KeyframeSelector:
        """Return the selector of a camera's keyframes: each camera has its own."""
        if camera not in self._selectors:
            first = not self._selectors
            config = self.selector.config
            self._selectors[camera] = self.selector if first else KeyframeSelector(config)
        return self._selectors[camera]

    def configure(self, keyframes: KeyframeConfig, matching: ScanMatchingConfig) -> None:
        """Replace the settings."""
        for selector in (self.selector, *self._selectors.values()):
            selector.config = keyframes
        self.matcher.config = matching

    def wait(self, measurement: Stamped, capacity: int) -> None:
        """Queue a measurement until odometry reaches its stamp."""
        if self.waiting.push(measurement, capacity):
            self.count('dropped_without_odometry')

    def cloud_of(self, stamp: float) -> PointCloud | None:
        """Return the point cloud of a scan that matching has placed; older ones are forgotten."""
        while self.clouds and self.clouds[0][0] < stamp:
            self.clouds.popleft()
        if self.clouds and self.clouds[0][0] == stamp:
            return self.clouds[0][1]
        return None

    def next_to_match(self) -> LaserScan | None:
        """Return the oldest scan to be matched that odometry has reached, or None.

        It waits for earlier scans of other lasers whose sweeps are not complete.
        """
        if self.unmatched.first > self.odometry.last:
            return None
        if self.sweeps.several and self.unmatched.first > self.sweeps.first:
            return None
        scan = self.unmatched.pop()
        if scan.stamp > self.last_match_attempt:
            self.scan_period = scan.stamp - self.last_match_attempt
            self.last_match_attempt = scan.stamp
        return scan

    def next_ready(self, timeout: float) -> Stamped | None:
        """Return the oldest waiting measurement that odometry has reached, or None.

        It waits for earlier scans whose sweeps are not complete, which takes a second at most.
        While scans are matched, a measurement waits for the next scan as well, at most for the
        timeout (s): only then is the motion up to its stamp refined. A scan that is expected only
        later than that, by the time between the last two, is not waited for.
        """
        stamp = self.waiting.first
        if stamp > self.odometry.last or stamp >= self.sweeps.first:
            return None
        waits = self._expects_scan(stamp, timeout) or self.sets.first <= stamp
        if waits and self.odometry.last < stamp + timeout:
            return None
        return self.waiting.pop()

    def _expects_scan(self, stamp: float, timeout: float) -> bool:
        """Return whether a scan at a stamp (s) or up to a timeout (s) later is about to come."""
        last = self.last_match_attempt
        if last >= stamp:
            return False
        expected = last + self.scan_period
        return stamp - timeout < last or stamp - timeout < expected <= stamp + timeout

    def restart_clock(self) -> None:
        """Continue after the clock jumped back: drop what waits, restamp the newest keyframe."""
        for _ in range(len(self.waiting)):
            self.count('dropped_by_clock_jump')
        self.waiting.clear()
        self.unmatched.clear()
        self.sweeps.clear()
        for selector in (self.selector, *self._selectors.values()):
            selector.reset()
        self.sets.clear()
        self.matcher.reset()
        self.source.restart_clock()
        self.slip.clear()
        self.clouds.clear()
        self.last_scans.clear()
        self.last_views.clear()
        self.last_seen = -np.inf
        self.matched_until = self.last_match_attempt = -np.inf
        self.scan_period = np.inf
        if self.keyframe is not None:
            self.keyframe = replace(self.keyframe, stamp=self.odometry.last)

    def moved_since_keyframe(self, stamp: float) -> Pose2:
        """Return the motion from the newest keyframe (or the start) to a stamp (s)."""
        if self.keyframe is None or not len(self.odometry):
            return IDENTITY
        return self.keyframe.odometry.between(self.odometry.at(stamp))

    def steps_since_keyframe(self, stamp: float) -> list[Step]:
        """Return the steps from the newest keyframe to a stamp (s), one per odometry reading."""
        if self.keyframe is None:
            return []
        steps = self.odometry.steps(self.keyframe.stamp, stamp)
        if self.odometry.first > self.keyframe.stamp:
            # readings since the keyframe have left the buffer: one step replaces them
            forgotten = self.keyframe.odometry.between(self.odometry.at(0.0))
            steps.insert(0, Step(forgotten, None))
        return steps


def merged_steps(steps: list[Step], most: int) -> list[Step]:
    """Join steps of wheel odometry so that about as many as asked for are left."""
    size = -(-len(steps) // most)
    if size <= 1:
        return steps
    merged: list[Step] = []
    joined = 0  # steps in the last of the merged
    for step in steps:
        wheels = step.covariance is None and bool(merged) and merged[-1].covariance is None
        if wheels and joined < size:
            merged[-1] = Step(merged[-1].increment.compose(step.increment), None)
            joined += 1
        else:
            merged.append(step)
            joined = 1
    return merged
