"""Odometry of one vehicle: kept for a while, interpolated at the stamps of frames and scans."""

import logging
import math
from bisect import bisect_left, bisect_right
from typing import NamedTuple

from explore_slam.data import OdometryReading
from explore_slam.geometry import IDENTITY, Array, Pose2, wrap_angle
from explore_slam.slam import OdometryNoise

logger = logging.getLogger(__name__)


class Step(NamedTuple):
    """A motion in the frame where it begins, and its covariance (3, 3); None: that of wheels."""

    increment: Pose2
    covariance: Array | None

    def covariance_or(self, noise: OdometryNoise) -> Array:
        """Return the covariance (3, 3): the step's own, or else that of the wheels."""
        return noise.covariance(self.increment) if self.covariance is None else self.covariance


def interpolate(a: Pose2, b: Pose2, share: float) -> Pose2:
    """Return the pose at the share (0 to 1) of the way from a to b, turning the short way."""
    return Pose2(
        a.x + share * (b.x - a.x),
        a.y + share * (b.y - a.y),
        wrap_angle(a.theta + share * wrap_angle(b.theta - a.theta)),
    )


class OdometryBuffer:
    """The newest readings of one vehicle, as one unbroken chain of poses.

    A base that is reset or a clock that jumps back breaks the chain of the readings: the buffer
    then goes on from the last pose it had, as if the vehicle had stood still in between.
    Where something better than wheels has measured a pose, `correct` bends the chain onto it.
    """

    def __init__(self, vehicle: str, span: float, maximum_speed: float, clock_jump: float) -> None:
        self.vehicle = vehicle
        self._span = span
        self._maximum_speed = maximum_speed
        self._clock_jump = clock_jump
        self._stamps: list[float] = []
        self._poses: list[Pose2] = []
        self._covariances: list[Array | None] = []  # of the step that ends there
        self._correction: Pose2 | None = None  # chain = correction ⊕ reading, once it broke
        self.late = 0
        self.breaks = 0

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
        """Newest pose of the chain."""
        return self._poses[-1]

    def add(self, reading: OdometryReading) -> bool:
        """Append a reading; False when it is late or a repetition and was left out."""
        if self._stamps and reading.stamp <= self.last:
            if self.last - reading.stamp < self._clock_jump:
                self.late += 1
                return False
            logger.warning(
                '%s: odometry stamp went back from %.3f s to %.3f s; going on from the new time',
                self.vehicle,
                self.last,
                reading.stamp,
            )
            self._break(reading)
            pose = self.pose
            self._stamps, self._poses, self._covariances = [], [], []
            self._append(reading.stamp, pose)
            return True
        pose = reading.pose
        if self._correction is not None:
            pose = self._correction.compose(pose)
        if self._stamps and self._jumps(reading.stamp, pose):
            logger.warning(
                '%s: odometry jumped from (%.2f, %.2f) to (%.2f, %.2f) in %.3f s; '
                'taken for a reset of the base, not for motion',
                self.vehicle,
                self.pose.x,
                self.pose.y,
                pose.x,
                pose.y,
                reading.stamp - self.last,
            )
            self._break(reading)
            pose = self.pose
        self._append(reading.stamp, pose)
        return True

    def at(self, stamp: float) -> Pose2:
        """Return the pose at a stamp; the ends hold beyond the readings."""
        index = bisect_left(self._stamps, stamp)
        if index == 0:
            return self._poses[0]
        if index == len(self._stamps):
            return self._poses[-1]
        before, after = self._stamps[index - 1], self._stamps[index]
        share = (stamp - before) / (after - before)
        return interpolate(self._poses[index - 1], self._poses[index], share)

    def steps(self, start: float, end: float) -> list[Step]:
        """Return the steps between readings from one stamp to another, ends interpolated."""
        steps, last = [], self.at(start)
        low, high = bisect_right(self._stamps, start), bisect_left(self._stamps, end)
        for index in range(low, high + 1):
            stop = min(end, self._stamps[index]) if index < len(self._stamps) else end
            pose = self.at(stop)
            covariance = self._covariances[index] if index < len(self._stamps) else None
            if covariance is not None and index > 0:
                before = self._stamps[index - 1]
                part = (stop - max(start, before)) / (self._stamps[index] - before)
                covariance = max(part, 0.0) * covariance
            steps.append(Step(last.between(pose), covariance))
            last = pose
        return steps or [Step(IDENTITY, None)]

    def correct(self, since: float, stamp: float, pose: Pose2, covariance: Array) -> None:
        """Put the chain on a measured pose at a stamp, and all that follows with it.

        What it is off grows evenly over the time from the stamp `since`; the covariance (3, 3)
        of the motion from there, in the frame of the pose, is spread likewise.
        """
        index = bisect_left(self._stamps, stamp)
        if index == len(self._stamps) or since >= stamp:
            return
        moved = pose.compose(self.at(stamp).inverse())
        self._poses[index:] = [moved.compose(later) for later in self._poses[index:]]
        if self._stamps[index] != stamp:
            self._stamps.insert(index, stamp)
            self._poses.insert(index, pose)
            self._covariances.insert(index, None)
        self._poses[index] = pose
        last = since
        for node in range(bisect_right(self._stamps, since), index + 1):
            share = (self._stamps[node] - since) / (stamp - since)
            if node < index:
                old = self._poses[node]
                self._poses[node] = interpolate(old, moved.compose(old), share)
            part = (self._stamps[node] - last) / (stamp - since)
            self._covariances[node], last = part * covariance, self._stamps[node]
        self._correction = moved if self._correction is None else moved.compose(self._correction)

    def _append(self, stamp: float, pose: Pose2) -> None:
        self._stamps.append(stamp)
        self._poses.append(pose)
        self._covariances.append(None)
        if len(self._stamps) > 64 and self._stamps[0] < stamp - 2.0 * self._span:
            keep = bisect_left(self._stamps, stamp - self._span)
            del self._stamps[:keep], self._poses[:keep], self._covariances[:keep]

    def _jumps(self, stamp: float, pose: Pose2) -> bool:
        moved = math.hypot(pose.x - self.pose.x, pose.y - self.pose.y)
        return moved > self._maximum_speed * (stamp - self.last) + 0.1

    def _break(self, reading: OdometryReading) -> None:
        self.breaks += 1
        self._correction = self.pose.compose(reading.pose.inverse())
