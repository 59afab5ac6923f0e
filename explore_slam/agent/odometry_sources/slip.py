"""Whether wheel odometry agrees with the scans: slip, wrong sizes of wheels, and dead encoders."""

import logging
import math
from collections import deque
from typing import NamedTuple

from explore_slam.geometry import Pose2
from explore_slam.registration import PointCloud, ScanMatcher
from explore_slam.slam import OdometryNoise

logger = logging.getLogger(__name__)

_WINDOW = 3.0  # s over which motions are added up
# Motions that are compared at all, by the longer of the two (m, rad), and their difference as a
# share of it: five times what differs on a good floor, and less than the 1.4 at which the map of
# the sensor rig is wrong.
_LEAST_DISTANCE, _LEAST_TURN = 0.5, 0.5
_DIFFERENCE = 0.25
_SIGMAS = 3.0  # of the drift that the odometry is known to have, beside that share
_DEAD = 0.05  # share of the motion that scans show, below which odometry does not move
# A standing vehicle's scans, compared now and then: it has moved when it is this far from where it
# stood, twice in succession. At rest, matches differ by millimetres and milliradians.
_PROBE_PERIOD = 0.25  # s
_MOVED = (0.05, 0.05)  # m, rad


class _Motion(NamedTuple):
    since: float
    stamp: float
    wheels: Pose2
    scans: Pose2


class SlipMonitor:
    """Compares the motion by odometry with that by matched scans; names a disagreement once.

    problem: what was named, '' if nothing was.
    """

    def __init__(self, vehicle: str, source: str) -> None:
        self._vehicle, self._source = vehicle, source
        self._motions: deque[_Motion] = deque()
        self._probed = -math.inf
        self._moved = 0  # probes in succession that show a motion
        self.problem = ''

    def add_match(
        self, since: float, stamp: float, wheels: Pose2, scans: Pose2, noise: OdometryNoise
    ) -> None:
        """Compare the motions from the last match to a scan, both given by their stamps (s).

        noise: of the odometry, whose drift is no slip.
        """
        if self.problem:
            return
        self._moved = 0
        self._motions.append(_Motion(since, stamp, wheels, scans))
        while self._motions[0].stamp < stamp - _WINDOW:
            self._motions.popleft()
        by_wheels = _path([item.wheels for item in self._motions])
        by_scans = _path([item.scans for item in self._motions])
        if _differ(by_wheels, by_scans, noise):
            self._name(by_wheels, by_scans, f'in {stamp - self._motions[0].since:.1f} s')

    def add_still_scan(
        self, stamp: float, matcher: ScanMatcher, cloud: PointCloud, pose: Pose2
    ) -> None:
        """Look, now and then, whether the scan of a vehicle shows a motion that odometry does not.

        pose: of the vehicle by odometry, which has not moved since the last match.
        """
        if self.problem or abs(stamp - self._probed) < _PROBE_PERIOD:
            return
        self._probed = stamp
        found = matcher.probe(cloud, pose)
        if found is None:
            return
        moved = pose.between(found.pose)
        distance = math.hypot(moved.x, moved.y)
        if distance < _MOVED[0] and abs(moved.theta) < _MOVED[1]:
            self._moved = 0
            return
        self._moved += 1
        if self._moved >= 2:
            self._name((0.0, 0.0), (distance, abs(moved.theta)), 'since the vehicle last moved')

    def _name(self, wheels: tuple[float, float], scans: tuple[float, float], when: str) -> None:
        dead = all(_DEAD * s >= w for w, s in zip(wheels, scans, strict=True))
        what = (
            'odometry does not move while the scans do'
            if dead
            else ('wheels slip, or are of another size than their driver takes them for')
        )
        remedy = f'set {self._vehicle}.odometry: scan'
        if self._source == 'wheels':
            remedy += ' (or wheels+gyro, with an IMU, where turns alone are wrong)'
        self.problem = (
            f'{what}: {when}, odometry has {wheels[0]:.2f} m and {math.degrees(wheels[1]):.0f}°, '
            f'the scans {scans[0]:.2f} m and {math.degrees(scans[1]):.0f}°'
        )
        logger.warning('%s: %s; %s', self._vehicle, self.problem, remedy)

    def clear(self) -> None:
        """Forget the motions: the clock has jumped."""
        self._motions.clear()
        self._probed, self._moved = -math.inf, 0

    def report(self) -> dict[str, float | str]:
        """Return what was named."""
        return {'problem': self.problem} if self.problem else {}


def _path(motions: list[Pose2]) -> tuple[float, float]:
    """Return the length of a path (m), and by how much it turns (rad), to either side.

    Turns of matches are noisy: only those that add up count.
    """
    distance = sum(math.hypot(motion.x, motion.y) for motion in motions)
    return distance, abs(sum(motion.theta for motion in motions))


def _differ(wheels: tuple[float, float], scans: tuple[float, float], noise: OdometryNoise) -> bool:
    """Return whether two paths differ in length or turn by more than can be expected.

    Expected is a share of them, and beside it the drift of odometry over the distance driven.
    """
    driven = max(wheels[0], scans[0])
    drifts = (
        _SIGMAS * math.sqrt(noise.forward_variance_per_metre * driven),
        _SIGMAS * math.sqrt(noise.heading_variance_per_metre * driven),
    )
    least = (_LEAST_DISTANCE, _LEAST_TURN)
    return any(
        max(w, s) > enough and abs(w - s) > math.hypot(_DIFFERENCE * max(w, s), drift)
        for w, s, enough, drift in zip(wheels, scans, least, drifts, strict=True)
    )
