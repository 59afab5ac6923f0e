"""What the lasers of a vehicle see around it: the returns of their newest scans, now."""

import math
from collections.abc import Mapping

import numpy as np

from explore_slam.data import LaserScan
from explore_slam.geometry import Array, Pose2, to_world
from explore_slam.sweeps import Sweep, SweepJudge, deskewed
from explore_slam.vehicle.clearance import scan_points
from explore_slam.vehicle.dead_reckoning import DeadReckoning

# s between the poses by which beams are placed; odometry comes at 50 Hz or less
_SWEEP_STEP = 0.02
# s by which a scan may be older than the newest one; long after silence has stopped the vehicle
_FORGOTTEN = 5.0
_ONLY_TOPIC = 'scan'  # of a vehicle with one laser


class LaserView:
    """The newest scan of every laser of a vehicle, in the vehicle frame at any time.

    Beams that were measured one after the other are placed by odometry at their own times.
    Obstacles cannot wait for odometry: where it has not come yet, it is extrapolated.

    reckoning: odometry of the vehicle, which grows while scans arrive.
    """

    def __init__(self, vehicle: str, reckoning: DeadReckoning) -> None:
        self._vehicle = vehicle
        self._reckoning = reckoning
        self._judges: dict[str, SweepJudge] = {}
        self._seen: dict[str, tuple[float, Array]] = {}  # laser -> stamp and points (N, 2)
        self._received: dict[str, float] = {}
        self._known: dict[str, Sweep] = {}

    @property
    def last_received(self) -> float:
        """Time (s) since which a laser has been silent: the longest silent one; -inf: no scan.

        Lasers that share a topic count as one: a driver may have begun anew with another frame.
        """
        newest: dict[str, float] = {}
        for laser, received in self._received.items():
            topic = laser.partition(', ')[0] or _ONLY_TOPIC
            newest[topic] = max(received, newest.get(topic, -math.inf))
        return min(newest.values(), default=-math.inf)

    def set_sweeps(self, found: Mapping[str, Sweep]) -> None:
        """Set when the beams of lasers are measured, as their scans have shown elsewhere."""
        self._known = dict(found)
        for laser, judge in self._judges.items():
            judge.found = self._known.get(laser)

    def add(self, scan: LaserScan, laser: Pose2, received: float) -> None:
        """Replace the newest scan of a laser, which is on the vehicle at a pose.

        received: time (s) of the clock by which silence is measured.
        """
        judge = self._judges.get(scan.sensor)
        if judge is None:
            judge = self._judges[scan.sensor] = SweepJudge(self._vehicle)
            judge.found = self._known.get(scan.sensor)
        sweep = judge.sweep_of(scan)
        if sweep is not None:
            begin = scan.stamp + sweep.begin
            count = max(math.ceil(sweep.duration / _SWEEP_STEP), 1) + 1
            at = np.linspace(begin, begin + sweep.duration, count)
            path = np.array([self._reckoning.odometry_at(float(stamp)) for stamp in at])
            scan = deskewed(scan, sweep, at, path, laser)
        self._seen[scan.sensor] = (scan.stamp, scan_points(scan, laser))
        self._received[scan.sensor] = received

    def points(self, now: float) -> Array:
        """Return the returns (N, 2) m of all lasers in the vehicle frame at a time (s)."""
        present = self._reckoning.odometry_at(now)
        oldest = max((stamp for stamp, _ in self._seen.values()), default=now) - _FORGOTTEN
        found = [
            to_world(present.between(self._reckoning.odometry_at(stamp)), points)
            for stamp, points in self._seen.values()
            if stamp >= oldest
        ]
        return np.concatenate(found) if found else np.empty((0, 2))
