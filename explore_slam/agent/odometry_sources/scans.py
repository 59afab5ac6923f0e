"""Odometry by scans alone: constant velocity predicts, matching with the map of scans corrects.

As in KISS-ICP (Vizzo et al., 2023), the motion within a sweep and the first guess of its match
come from a velocity that is taken as constant. Here a Kalman filter estimates it, so that the
covariance says what scans leave open: along a corridor without features that is the whole way.
"""

import logging
from bisect import bisect_left
from collections import deque
from dataclasses import replace

import numpy as np

from explore_slam.agent.odometry import OdometryBuffer, Step, interpolate
from explore_slam.agent.odometry_sources.source import (
    Motion,
    MotionPrior,
    NewScan,
    OdometrySource,
)
from explore_slam.agent.odometry_sources.twists import exponential
from explore_slam.agent.odometry_sources.velocity_filter import VelocityFilter, positive
from explore_slam.data import OdometryReading
from explore_slam.geometry import IDENTITY, Array, Pose2
from explore_slam.registration import ScanMatch, ScanMatcher, scan_cloud
from explore_slam.slam import FastSlamConfig
from explore_slam.sweeps import LONGEST_SWEEP, deskewed

logger = logging.getLogger(__name__)

# s without scans, after which the velocity from before says nothing; lidars turn at 1 Hz or faster
_GAP = 1.0
_WHEELS = 200  # readings; at 100 Hz those of 2 s, in which a sweep and its match are complete
_PATH = 9  # poses by which a sweep is undone; between them, motion is linear
_REFINEMENTS = 3  # at most, of the velocity within a sweep
_REFINED = 0.002  # rad within a sweep; less is noise of the alignment
_NOTHING = 1e-9  # ratio of information that is none but for rounding
_STEP = 0.05  # s between readings where motion is predicted: as odometry at 20 Hz


class ScanSource(OdometrySource):
    """Readings predicted at constant velocity, which matching corrects scan by scan.

    Readings of wheels do not count; the newest one is kept for the transforms of the vehicle.
    """

    name = 'scan'
    needs_scans = True
    weak = True

    def __init__(self, vehicle: str) -> None:
        self.vehicle = vehicle
        self.filter = VelocityFilter()
        self._at = -np.inf  # stamp (s) of the filter
        self._wheels: deque[tuple[float, Pose2]] = deque(maxlen=_WHEELS)
        self._increments: deque[Pose2] = deque()  # of readings that are not reckoned yet
        self._reckoned = IDENTITY
        self._gaps = 0

    def add_odometry(self, reading: OdometryReading) -> list[Motion]:
        """Keep what the wheels say; the trajectory does not follow it."""
        if self._wheels and reading.stamp <= self._wheels[-1][0]:
            self._wheels.clear()  # the clock has jumped back
        self._wheels.append((reading.stamp, reading.pose))
        return []

    def cover(
        self, new: NewScan, trajectory: OdometryBuffer, matcher: ScanMatcher
    ) -> list[Motion]:
        """Return predicted readings up to the end of the sweep of a new scan."""
        end = new.end
        if not len(trajectory):
            # one reading before the scan, so that it is within the trajectory
            stamps = {max(end - LONGEST_SWEEP, 0.0), end}
            return [Motion(OdometryReading(stamp, IDENTITY)) for stamp in sorted(stamps)]
        pose, last = trajectory.pose, trajectory.last
        if last - end >= trajectory.clock_jump_threshold:  # it has jumped back
            return [Motion(OdometryReading(end, pose))]
        if end - max(last, self._at) > _GAP:
            self._name_gap(end - last)
            self.filter.forget_velocity()
        if end <= last:
            return []
        motions = []
        count = max(1, round((end - last) / _STEP))
        share = (end - last) / count
        increment = exponential(share * self._velocity_within(new, trajectory, matcher))
        begin = min(self._at, last) if np.isfinite(self._at) else last
        for number in range(1, count + 1):
            pose = pose.compose(increment)
            self._increments.append(increment)
            reached = last + number * share - begin
            stamp = end if number == count else begin + reached
            grown = np.zeros((3, 3))  # before the first match: the map begins there
            if np.isfinite(self._at):
                grown = self.filter.growth(reached) - self.filter.growth(reached - share)
            motions.append(Motion(OdometryReading(stamp, pose), Step(increment, positive(grown))))
        return motions

    def _velocity_within(
        self, new: NewScan, trajectory: OdometryBuffer, matcher: ScanMatcher
    ) -> Array:
        """Return the velocity (3,) within the sweep of a new scan.

        The one before the sweep is that of a vehicle that does not accelerate. The scan, undone by
        it and aligned, shows a better one, by which it is undone again. The filter takes the scan
        later, when it is matched.
        """
        velocity, sweep, scan = self.filter.velocity, new.sweep, new.scan
        if sweep is None or not np.isfinite(self._at) or not matcher.started:
            return velocity
        duration = scan.stamp + sweep.middle - self._at
        if not 0.0 < duration < _GAP:
            return velocity
        prior = trajectory.at(self._at).compose(self.filter.motion(duration))
        covariance = self.filter.predicted(duration)[:3, :3]
        at = scan.stamp + sweep.begin + sweep.duration * np.linspace(0.0, 1.0, _PATH)
        for _ in range(_REFINEMENTS):
            poses = np.array(
                [exponential((stamp - scan.stamp - sweep.middle) * velocity) for stamp in at]
            )
            undone = deskewed(scan, sweep, at, poses, new.laser)
            cloud = scan_cloud(undone, new.laser, matcher.config.matching_range)
            found = matcher.align(cloud, prior, covariance)
            if found is None:
                return velocity
            before, shift = velocity, np.asarray(prior.between(found.pose))
            velocity = self.filter.velocity_after(duration, shift)
            if abs(velocity[2] - before[2]) * sweep.duration < _REFINED:
                break
        return velocity

    def reckoned(self, reading: OdometryReading) -> OdometryReading:
        """Return a reading as the predicted velocities lead to it, without the jumps of matches.

        Readings come in the order in which `cover` has made them.
        """
        if self._increments:
            self._reckoned = self._reckoned.compose(self._increments.popleft())
        return replace(reading, pose=self._reckoned)

    def _name_gap(self, duration: float) -> None:
        if not self._gaps:
            logger.warning(
                '%s: no scan for %.1f s: its motion in that time is unknown, as it has no other '
                'odometry (odometry: scan); similar gaps are not named again',
                self.vehicle, duration,
            )  # fmt: skip
        self._gaps += 1

    def prior(
        self, trajectory: OdometryBuffer, since: float, stamp: float, _slam: FastSlamConfig
    ) -> MotionPrior:
        """Return the prior at constant velocity since the last match."""
        self._catch_up(since)
        duration = stamp - since
        covariance = self.filter.predicted(duration)[:3, :3]
        pose = trajectory.at(since).compose(self.filter.motion(duration))
        return MotionPrior(pose, covariance)

    def _catch_up(self, since: float) -> None:
        """Bring the filter to the last match; that may be where the map of scans began anew."""
        if np.isfinite(self._at) and since > self._at:
            self.filter.wait(since - self._at)
            self.filter.forget_pose()
        self._at = since

    def take_match(
        self, _trajectory: OdometryBuffer, since: float, stamp: float,
        prior: MotionPrior, match: ScanMatch, restarted: bool,
    ) -> Array:  # fmt: skip
        """Update the velocity; return what the error has grown by that scans leave open."""
        duration = stamp - since
        grown = self.filter.growth(duration)
        before = _apart_from_open_direction(prior.covariance, match.information)
        posterior = np.linalg.inv(match.information + np.linalg.inv(before))
        left = posterior @ np.linalg.inv(before)
        shift = np.asarray(prior.pose.between(match.pose))
        self.filter.update(duration, shift, before, posterior)
        self._at = stamp
        if restarted:
            return grown
        drift: Array = left @ grown @ left.T
        return drift + match.window

    def restart_clock(self) -> None:
        """Continue at rest at the new time."""
        self._at = -np.inf
        self.filter = VelocityFilter()

    def base_pose(self, trajectory: OdometryBuffer) -> Pose2:
        """Return the newest pose by the wheels, where there are any, else that of the trajectory.

        The base publishes the transform from its odometry frame by its wheels.
        """
        if not self._wheels:
            return trajectory.pose
        stamps = [stamp for stamp, _ in self._wheels]
        after = bisect_left(stamps, trajectory.last)
        if after in (0, len(stamps)):
            return self._wheels[min(after, len(stamps) - 1)][1]
        (begin, before), (end, later) = self._wheels[after - 1], self._wheels[after]
        return interpolate(before, later, (trajectory.last - begin) / (end - begin))

    def report(self) -> dict[str, float | str]:
        """Return the velocity, and the gaps between scans."""
        vx, _, turn = self.filter.velocity.tolist()
        return {'speed_m_per_s': vx, 'turn_rate_rad_per_s': turn, 'gaps': float(self._gaps)}


def _apart_from_open_direction(covariance: Array, information: Array) -> Array:
    """Return the covariance (3, 3) of a prior, uncorrelated in a direction that a match left open.

    The direction is noisy: matches that leave slightly different ones open would together seem to
    measure the way along a corridor, were errors across it taken to tell of errors along it.
    """
    values, vectors = np.linalg.eigh(information[:2, :2])
    if values[0] > _NOTHING * values[1]:
        return covariance
    turn = np.eye(3)
    turn[:2, :2] = vectors.T  # into the open direction, the one across it, and the heading
    parts = turn @ covariance @ turn.T
    parts[0, 1:] = parts[1:, 0] = 0.0
    apart: Array = turn.T @ parts @ turn
    return apart
