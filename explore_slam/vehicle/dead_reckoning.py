"""Dead reckoning: the present pose in the map from the latest map pose and odometry."""

import math
from collections import deque

from explore_slam.data import OdometryReading
from explore_slam.geometry import IDENTITY, Pose2, wrap_angle

# Chosen by hand: the horizon exceeds the path follower's pose_timeout (20 s), the extrapolation
# the time between readings at 10 Hz, and the top speed the limit of maximum_speed (2 m/s);
# test_dead_reckoning shows what they decide.
_HORIZON = 60.0  # s of odometry kept; older map poses are ignored
_EXTRAPOLATION = 0.3  # s beyond the newest reading
_LARGEST_FACTOR = 3.0  # of extrapolation, in intervals between the last two readings
_JUMP, _TOP_SPEED = 1.0, 3.0  # m, m/s; a reading farther from the last one is a reset base


class DeadReckoning:
    """Interpolated odometry, anchored in the map. All stamps (s) are of one clock."""

    def __init__(self) -> None:
        self._readings: deque[OdometryReading] = deque()
        self._map_to_odometry: Pose2 | None = None
        self._pending: tuple[float, Pose2] | None = None
        self.pose_stamp = -math.inf

    def add_odometry(self, reading: OdometryReading) -> None:
        """Add an odometry reading; a jump in time or position discards all earlier ones."""
        if self._readings:
            last = self._readings[-1]
            gap = reading.stamp - last.stamp
            if gap == 0.0:
                return
            moved = math.hypot(reading.pose.x - last.pose.x, reading.pose.y - last.pose.y)
            if gap < 0.0 or moved > _JUMP + _TOP_SPEED * gap:
                self._readings.clear()
                self._map_to_odometry = None
                self.pose_stamp = -math.inf
        self._readings.append(reading)
        while self._readings[0].stamp < reading.stamp - _HORIZON:
            self._readings.popleft()
        if self._pending is not None:
            self.set_pose(*self._pending)

    def set_pose(self, stamp: float, pose: Pose2) -> None:
        """Set the pose in the map at a stamp; if odometry of that time is missing, wait for it."""
        if not self._readings or stamp > self._readings[-1].stamp + _EXTRAPOLATION:
            self._pending = (stamp, pose)
            return
        self._pending = None
        if stamp < self._readings[0].stamp - _EXTRAPOLATION:
            return
        self._map_to_odometry = pose.compose(self.odometry_at(stamp).inverse())
        self.pose_stamp = stamp

    def odometry_at(self, stamp: float) -> Pose2:
        """Return the odometry pose at a stamp, interpolated or (at most 0.3 s) extrapolated."""
        readings = self._readings
        if len(readings) < 2 or stamp <= readings[0].stamp:
            return readings[0].pose if readings else IDENTITY
        if stamp >= readings[-1].stamp:
            ahead = min(stamp - readings[-1].stamp, _EXTRAPOLATION)
            a, b = readings[-2], readings[-1]
            step = a.pose.between(b.pose)
            f = min(ahead / (b.stamp - a.stamp), _LARGEST_FACTOR)
            return b.pose.compose(Pose2(f * step.x, f * step.y, wrap_angle(f * step.theta)))
        i = len(readings) - 1
        while readings[i - 1].stamp > stamp:  # from the newest: most queries are recent
            i -= 1
        a, b = readings[i - 1], readings[i]
        f = (stamp - a.stamp) / (b.stamp - a.stamp)
        step = a.pose.between(b.pose)
        return a.pose.compose(Pose2(f * step.x, f * step.y, f * step.theta))

    def map_pose(self, now: float) -> Pose2 | None:
        """Return the pose in the map at a time (s), None before the first map pose."""
        if self._map_to_odometry is None:
            return None
        return self._map_to_odometry.compose(self.odometry_at(now))
