"""Odometry of one vehicle: a bounded history, interpolated at the stamps of frames and scans."""

import logging
import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from explore_slam.data import OdometryReading
from explore_slam.geometry import IDENTITY, Array, Pose2, rotated, wrap_angle
from explore_slam.slam import OdometryNoise, compound

logger = logging.getLogger(__name__)

# m; slack of the speed limit, for stamps that jitter: 0.03 s at the default limit of 3 m/s
_JUMP_SLACK = 0.1
# rad/s and rad; faster than any base turns (a Create 3: 1.9, a TurtleBot3 Burger: 2.8)
JUMP_TURN_RATE = 20.0
_JUMP_TURN_SLACK = 0.3
_RESTART_GAP = 0.4  # s without readings; no driver restarts faster, and they come at 10 Hz or more
_RESTART_INTERVALS = 2.0  # usual intervals between readings; a shorter gap is none for that driver
_SLOWEST = 1.0  # s between readings; as long as nothing is known about a driver
_LOST_SHARE = 0.5  # of the readings that a gap has room for; if more were sent, the driver ran on
# m and rad; a driver that has just started reads zero, apart from the drift of a gyroscope. A base
# that drives through its origin comes as close only where a reading happens to be taken there.
_ORIGIN_EXACT = 0.005
# The first readings may be lost (best effort), and the base may have moved since: at a manoeuvring
# speed of 0.05 m/s (rad/s) in the gap, up to half a metre (radian).
_ORIGIN_TOLERANCE = 0.05  # m and rad
_ORIGIN_SPEED = 0.05  # m/s and rad/s
_ORIGIN_TOLERANCE_LIMIT = 0.5  # m and rad
_ORIGIN_NOISE = 0.02  # m and rad; of readings of a base that stands still
_RESTART_CONTRAST = 3.0  # times as far from zero was the last reading of the old driver at least
_IMU_RESTART_DISTANCE = 0.3  # m; from here to zero at any heading, which an IMU may keep
# What a base can add to the speeds that it has shown: a TurtleBot3 Burger accelerates by 2.5 m/s²
# and 3.2 rad/s², bases that turn on the spot by up to 10 rad/s²
_ACCELERATION = 2.5  # m/s²
_TURN_ACCELERATION = 10.0  # rad/s²
_RECENT_READINGS = 10  # by which the usual interval is judged
_SPEEDING_UP = 0.5  # s for which a base goes on accelerating beyond the speeds that it has shown
_STAMP_JITTER = 0.03  # s
_VELOCITY_REACH = 0.1  # s to either side: two readings of a Pioneer, which sends ten per second
_TRIM_MINIMUM = 64  # readings; shorter histories are not worth trimming


class Step(NamedTuple):
    """A motion in the frame in which it begins, with its covariance (3, 3).

    covariance None: measured by wheel odometry alone, so that the odometry noise model applies.
    """

    increment: Pose2
    covariance: Array | None

    def covariance_or(self, noise: OdometryNoise) -> Array:
        """Return the covariance (3, 3), by default that of the odometry noise model."""
        return noise.covariance(self.increment) if self.covariance is None else self.covariance


def compound_steps(
    pose: Pose2, covariance: Array, steps: Iterable[Step], noise: OdometryNoise
) -> tuple[Pose2, Array]:
    """Return pose and covariance (3, 3) after odometry steps, in the frame of the first pose."""
    for step in steps:
        pose, covariance = compound(pose, covariance, step.increment, step.covariance_or(noise))
    return pose, covariance


def _from_origin(pose: Pose2) -> float:
    """Return the larger of distance (m) and heading (rad) from where odometry begins."""
    return max(math.hypot(pose.x, pose.y), abs(wrap_angle(pose.theta)))


def _returns_to_origin(reading: Pose2, last: Pose2, tolerance: float) -> bool:
    """Return whether a reading is near zero, and the last one was far from it.

    tolerance: m and rad. The heading is ignored where the position shows it: an IMU may keep it.
    """
    distance, last_distance = _from_origin(reading), _from_origin(last)
    if distance <= tolerance and last_distance > _RESTART_CONTRAST * max(distance, _ORIGIN_NOISE):
        return True
    return (
        math.hypot(reading.x, reading.y) <= min(tolerance, _ORIGIN_NOISE)
        and math.hypot(last.x, last.y) > _IMU_RESTART_DISTANCE
    )


def interpolate(a: Pose2, b: Pose2, fraction: float) -> Pose2:
    """Return the pose at a fraction (0 to 1) from a to b; the heading takes the shorter turn."""
    return Pose2(
        a.x + fraction * (b.x - a.x),
        a.y + fraction * (b.y - a.y),
        wrap_angle(a.theta + fraction * wrap_angle(b.theta - a.theta)),
    )


class _Fix(NamedTuple):
    """A pose measured better than by wheel odometry, and the time since the one before.

    Covariances (3, 3) in the vehicle frame at the pose: white, of the error of this pose alone;
    before, of that of the pose before (zero where there is none); wheels, of the odometry between.
    """

    since: float
    stamp: float
    heading: float
    white: Array
    before: Array
    wheels: Array


class OdometryBuffer:
    """Recent odometry readings of one vehicle as one continuous trajectory.

    resets: jumps of the odometry that were no motion, restarts among them.
    restarts: of the driver, after which the position of the vehicle is unknown.
    When the base is reset or its clock jumps back, the trajectory continues from its last pose, as
    if the vehicle had stood still in between. `correct` bends the trajectory onto a pose that was
    measured better than by wheel odometry, for example by scan matching.
    """

    def __init__(
        self, vehicle: str, duration: float, jump_speed: float, clock_jump_threshold: float
    ) -> None:
        """Create an empty buffer.

        duration: time (s) for which readings are kept at least.
        jump_speed: motion faster than this (m/s) is a reset of the base.
        clock_jump_threshold: stamps that go back by this (s) or more belong to a new clock; by
        less, they are late.
        """
        self.vehicle = vehicle
        self.resets = 0
        self.restarts = 0
        self._duration = duration
        self._jump_speed = jump_speed
        self.clock_jump_threshold = clock_jump_threshold
        self._stamps: list[float] = []
        self._poses: list[Pose2] = []
        self._covariances: list[Array | None] = []  # of the step that ends at each pose
        self._fixes: list[_Fix] = []
        self._correction: Pose2 | None = None  # trajectory = correction ⊕ reading
        self._number: int | None = None  # of the newest reading at its publisher
        self._top_speed = self._top_turn_rate = 0.0  # m/s, rad/s; that the base has shown

    def __len__(self) -> int:
        return len(self._stamps)

    @property
    def first(self) -> float:
        """Oldest stamp (s) held; inf when empty."""
        return self._stamps[0] if self._stamps else math.inf

    @property
    def last(self) -> float:
        """Newest stamp (s) held; -inf when empty."""
        return self._stamps[-1] if self._stamps else -math.inf

    @property
    def pose(self) -> Pose2:
        """Newest pose of the trajectory."""
        return self._poses[-1]

    @property
    def reading(self) -> Pose2:
        """Newest pose as the base has reported it: without the corrections of the trajectory."""
        if self._correction is None:
            return self.pose
        return self._correction.inverse().compose(self.pose)

    def clock_jumps_back(self, reading: OdometryReading) -> bool:
        """Return whether a reading is of a clock that has jumped back, and not merely late."""
        return bool(self._stamps) and self.last - reading.stamp >= self.clock_jump_threshold

    def add(self, reading: OdometryReading, step: Step | None = None) -> bool:
        """Append a reading; return False if it was discarded because it is late or repeated.

        step: the motion since the reading before, where another sensor has measured it, with its
        covariance. The readings of the base then show its restarts and jumps alone.
        """
        if self.clock_jumps_back(reading):
            self._restart_clock(reading)
            return True
        if self._stamps and reading.stamp <= self.last:
            return False
        if self._stamps and self._is_restart(reading):
            logger.warning(
                '%s: odometry begins at zero again, %.1f s after its last reading: the driver was '
                'restarted; the motion since then is unknown and counts as none',
                self.vehicle,
                reading.stamp - self.last,
            )
            self.restarts += 1
            self._continue_from(reading)
            step = None
        pose = self._trajectory_pose(reading)
        if self._stamps and self._is_jump(reading, pose):
            logger.warning(
                '%s: odometry jumped from (%.2f, %.2f) to (%.2f, %.2f) in %.3f s; '
                'treated as a reset of the base, not as motion',
                self.vehicle,
                self.pose.x,
                self.pose.y,
                pose.x,
                pose.y,
                reading.stamp - self.last,
            )
            self._continue_from(reading)
            pose, step = self.pose, None
        if self._stamps and step is not None:
            pose = self.pose.compose(step.increment)
            self._correction = pose.compose(reading.pose.inverse())
        if self._stamps:
            # where readings were lost, all the motion may have been within the time of one
            intervals = max(self._lost_before(reading), 0) + 1
            duration = max((reading.stamp - self.last) / intervals, _STAMP_JITTER)
            moved, turned = self._motion_to(pose)
            speed = min(moved / duration, self._jump_speed)
            turn_rate = min(turned / duration, JUMP_TURN_RATE)
            self._top_speed = max(self._top_speed, speed)
            self._top_turn_rate = max(self._top_turn_rate, turn_rate)
        self._append(reading.stamp, pose, None if step is None else step.covariance)
        self._number = reading.number
        return True

    def at(self, stamp: float) -> Pose2:
        """Return the pose at a stamp (s); beyond the readings, that of the nearest one."""
        index = bisect_left(self._stamps, stamp)
        if index == 0:
            return self._poses[0]
        if index == len(self._stamps):
            return self._poses[-1]
        before, after = self._stamps[index - 1], self._stamps[index]
        fraction = (stamp - before) / (after - before)
        return interpolate(self._poses[index - 1], self._poses[index], fraction)

    def velocity(self, stamp: float) -> Array:
        """Return the velocity (3,) in the vehicle frame at a stamp (s): m/s, m/s, rad/s.

        It is the mean over the readings around it; zero where there are none.
        """
        start = max(stamp - _VELOCITY_REACH, self.first)
        end = min(stamp + _VELOCITY_REACH, self.last)
        if not end - start > 0.0:
            return np.zeros(3)
        moved = self.at(start).between(self.at(end))
        return np.asarray(moved) / (end - start)

    def path(self, start: float, end: float) -> tuple[list[float], list[Pose2]]:
        """Return stamps (s) and poses of the readings from one stamp to a later one.

        The ends are interpolated; beyond the readings, the pose is that of the nearest one.
        """
        low, high = bisect_right(self._stamps, start), bisect_left(self._stamps, end)
        stamps = [start, *self._stamps[low:high], end]
        return stamps, [self.at(start), *self._poses[low:high], self.at(end)]

    def steps(self, start: float, end: float) -> list[Step]:
        """Return the steps from one stamp (s) to another, one per reading; ends interpolated."""
        steps, last = [], self.at(start)
        low, high = bisect_right(self._stamps, start), bisect_left(self._stamps, end)
        for index in range(low, high + 1):
            stop = min(end, self._stamps[index]) if index < len(self._stamps) else end
            pose = self.at(stop)
            covariance = self._covariances[index] if index < len(self._stamps) else None
            if covariance is not None and index > 0:
                before = self._stamps[index - 1]
                fraction = (stop - max(start, before)) / (self._stamps[index] - before)
                covariance = max(fraction, 0.0) * covariance
            steps.append(Step(last.between(pose), covariance))
            last = pose
        return steps or [Step(IDENTITY, None)]

    def correct(
        self, since: float, stamp: float, pose: Pose2, drift: Array, white: Array, wheels: Array
    ) -> None:
        """Bend the trajectory onto a measured pose at a stamp (s); later poses move along.

        The correction grows linearly in time from the stamp `since`. Covariances (3, 3) in the
        frame of the pose: drift, by which the error has grown since then, is distributed over the
        steps likewise; white, of an error that this pose alone has; wheels, of the odometry's
        motion since then, by which poses in between are uncertain.
        """
        index = bisect_left(self._stamps, stamp)
        if index == len(self._stamps) or since >= stamp:
            return
        correction = pose.compose(self.at(stamp).inverse())
        self._poses[index:] = [correction.compose(later) for later in self._poses[index:]]
        if self._stamps[index] != stamp:
            self._stamps.insert(index, stamp)
            self._poses.insert(index, pose)
            self._covariances.insert(index, None)
        self._poses[index] = pose
        last = since
        for node in range(bisect_right(self._stamps, since), index + 1):
            fraction = (self._stamps[node] - since) / (stamp - since)
            if node < index:
                old = self._poses[node]
                self._poses[node] = interpolate(old, correction.compose(old), fraction)
            duration = (self._stamps[node] - last) / (stamp - since)
            self._covariances[node], last = duration * drift, self._stamps[node]
        before = np.zeros((3, 3))
        if self._fixes:
            known = self._fixes[-1]
            before = rotated(known.white, pose.theta - known.heading)
        self._fixes.append(_Fix(since, stamp, pose.theta, white, before, wheels))
        self._correction = (
            correction if self._correction is None else correction.compose(self._correction)
        )

    def white_at(self, stamp: float) -> Array | None:
        """Return the covariance (3, 3) of the error that a pose has by itself, if it was measured.

        It is in the vehicle frame there. At a measured pose it is that of the measurement; a share
        s of the time between two, the errors of both count, and odometry errs like a Brownian
        bridge, with s (1 - s) times its covariance. After the last one its error remains.
        """
        number = bisect_left(self._fixes, stamp, key=lambda fix: fix.stamp)
        if number == len(self._fixes):
            if not self._fixes:
                return None
            fix, white = self._fixes[-1], self._fixes[-1].white
        else:
            fix = self._fixes[number]
            if stamp <= fix.since:
                # wheel odometry leads here from the pose measured before
                if number == 0:
                    return None
                fix = self._fixes[number - 1]
                white = fix.white
            else:
                s = (stamp - fix.since) / (fix.stamp - fix.since)
                white = s * s * fix.white + (1.0 - s) ** 2 * fix.before
                white = white + s * (1.0 - s) * fix.wheels
        return rotated(white, self.at(stamp).theta - fix.heading)

    def _restart_clock(self, reading: OdometryReading) -> None:
        """Continue from the last pose at the stamp of a clock that jumped back."""
        if self._begins_anew(reading):
            self.restarts += 1
            outcome = 'odometry begins at zero again: the driver was restarted; the motion since '
            outcome += 'then is unknown and counts as none'
        else:
            outcome = 'continuing with the new time'
        logger.warning(
            '%s: odometry stamp went back from %.3f s to %.3f s; %s',
            self.vehicle,
            self.last,
            reading.stamp,
            outcome,
        )
        self._continue_from(reading)
        pose = self.pose
        self._stamps, self._poses, self._covariances, self._fixes = [], [], [], []
        self._append(reading.stamp, pose)
        self._number = reading.number

    def _begins_anew(self, reading: OdometryReading) -> bool:
        """Return whether the first reading of a clock that jumped back is of a restarted driver.

        The stamps do not tell how long it was silent: odometry near zero by another publisher is a
        restart, and so is one still nearer to it by the same one: a simulator was reset, or a
        recording begins anew.
        """
        is_another = self._lost_before(reading) < 0
        tolerance = _ORIGIN_TOLERANCE_LIMIT if is_another else _ORIGIN_TOLERANCE
        return _returns_to_origin(reading.pose, self.reading, tolerance)

    def _append(self, stamp: float, pose: Pose2, covariance: Array | None = None) -> None:
        self._stamps.append(stamp)
        self._poses.append(pose)
        self._covariances.append(covariance)
        # trimmed when twice the duration is held, so that the cost per reading stays constant
        if len(self._stamps) > _TRIM_MINIMUM and self._stamps[0] < stamp - 2.0 * self._duration:
            keep = bisect_left(self._stamps, stamp - self._duration)
            del self._stamps[:keep], self._poses[:keep], self._covariances[:keep]
            self._fixes = [fix for fix in self._fixes if fix.stamp >= self._stamps[0]]

    def _lost_before(self, reading: OdometryReading) -> int:
        """Return how many readings were lost; negative: another publisher; 0: none, or unknown."""
        if reading.number is None or self._number is None:
            return 0
        return reading.number - self._number - 1

    def _is_restart(self, reading: OdometryReading) -> bool:
        """Return whether a reading after a gap is the first of a restarted driver.

        Zero is one, unless the driver has sent readings in the gap, which were lost. Where the
        numbers show that it was silent, a reading near zero, or one that the base cannot have
        driven to, is one too; without numbers, one near zero that it cannot have driven to.
        """
        gap = reading.stamp - self.last
        if gap < _RESTART_GAP:
            return False  # a reset of a base that keeps running: a jump, which is no motion
        intervals = np.diff(self._stamps[-_RECENT_READINGS:])
        room = gap / (float(np.median(intervals)) if len(intervals) else _SLOWEST)
        if room < _RESTART_INTERVALS:
            return False
        last, was_silent = self.reading, False
        if reading.number is not None and self._number is not None:
            lost = self._lost_before(reading)
            if lost > 0 and lost >= _LOST_SHARE * (room - 1.0):
                return False
            was_silent = True
        if _returns_to_origin(reading.pose, last, _ORIGIN_EXACT):
            return True
        tolerance = min(_ORIGIN_TOLERANCE + _ORIGIN_SPEED * gap, _ORIGIN_TOLERANCE_LIMIT)
        near = _returns_to_origin(reading.pose, last, tolerance)
        reachable = self._is_reachable(self._trajectory_pose(reading), gap)
        return (near or not reachable) if was_silent else (near and not reachable)

    def _is_jump(self, reading: OdometryReading, pose: Pose2) -> bool:
        """Return whether a reading, at a pose of the trajectory, is no motion of the base."""
        moved, turned = self._motion_to(pose)
        duration = reading.stamp - self.last
        if (
            moved > self._jump_speed * duration + _JUMP_SLACK
            or turned > JUMP_TURN_RATE * duration + _JUMP_TURN_SLACK
        ):
            return True
        # a reading where odometry begins is motion only if the base was fast enough for it
        begins = _returns_to_origin(reading.pose, self.reading, _ORIGIN_EXACT)
        return begins and not self._is_reachable(pose, duration)

    def _is_reachable(self, pose: Pose2, duration: float) -> bool:
        """Return whether the base can have driven to a pose of the trajectory in a time (s).

        Before it has been seen to move, or to stand, it can.
        """
        if len(self._stamps) < 2:
            return True
        moved, turned = self._motion_to(pose)
        speeding_up = min(duration, _SPEEDING_UP)
        accelerated = speeding_up * (duration - 0.5 * speeding_up)  # s², factor of acceleration
        time = duration + _STAMP_JITTER
        travel = self._top_speed * time + _ACCELERATION * accelerated
        turn = self._top_turn_rate * time + _TURN_ACCELERATION * accelerated
        return moved <= travel + _ORIGIN_NOISE and turned <= turn + _ORIGIN_NOISE

    def _motion_to(self, pose: Pose2) -> tuple[float, float]:
        """Return distance (m) and turn (rad) from the newest pose of the trajectory to another."""
        moved = math.hypot(pose.x - self.pose.x, pose.y - self.pose.y)
        return moved, abs(wrap_angle(pose.theta - self.pose.theta))

    def _trajectory_pose(self, reading: OdometryReading) -> Pose2:
        """Return the pose of the trajectory at a reading."""
        if self._correction is None:
            return reading.pose
        return self._correction.compose(reading.pose)

    def _continue_from(self, reading: OdometryReading) -> None:
        """Attach a reading, and those that follow it, to the last pose."""
        self.resets += 1
        self._correction = self.pose.compose(reading.pose.inverse())
