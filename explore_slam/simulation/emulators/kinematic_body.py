"""A minimal simulated vehicle on an empty plane, for emulators without a simulator."""

import math
import threading
import time
from collections.abc import Callable

import numpy as np

from explore_slam.data import LaserScan
from explore_slam.geometry import IDENTITY, Pose2, wrap_angle
from explore_slam.mounts import STOCK_LASER_X

LASER_RANGE = 8.0  # m, of an LMS-200 in mm
_LONGEST_STEP = 0.005  # s of integration


class KinematicBody:
    """A unicycle with limited accelerations and exact odometry.

    It is integrated up to the clock (s) at each call. The attribute obstacles holds discs
    (x, y, radius) m that its laser sees. laser_x: laser ahead of the vehicle origin (m).
    """

    def __init__(
        self,
        start: Pose2 = IDENTITY,
        *,
        acceleration: float = 1.0,
        turn_acceleration: float = 4.0,
        laser_x: float = STOCK_LASER_X,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.obstacles: list[tuple[float, float, float]] = []
        self._pose = start
        self._limits = (acceleration, turn_acceleration)
        self._laser_x = laser_x
        self._clock = clock
        self._wanted = (0.0, 0.0)
        self._velocity = (0.0, 0.0)
        self._time = clock()
        self._lock = threading.Lock()

    def set_velocity(self, linear: float, angular: float) -> None:
        """Command a velocity (m/s, rad/s)."""
        with self._lock:
            self._advance()
            self._wanted = (linear, angular)

    def odometry(self) -> Pose2:
        """Return the wheel odometry, here the true pose."""
        with self._lock:
            self._advance()
            return self._pose

    def velocity(self) -> tuple[float, float]:
        """Return the present velocity (m/s, rad/s)."""
        with self._lock:
            self._advance()
            return self._velocity

    def scan(self) -> LaserScan:
        """Return a scan of 361 beams over 180°."""
        pose = self.odometry().compose(Pose2(self._laser_x, 0.0, 0.0))
        angles = np.radians(np.linspace(-90.0, 90.0, 361))
        directions = np.column_stack([np.cos(pose.theta + angles), np.sin(pose.theta + angles)])
        ranges = np.full(len(angles), np.inf)
        for x, y, radius in self.obstacles:
            offset = np.array([x - pose.x, y - pose.y])
            along = directions @ offset
            miss = offset @ offset - along**2
            hit = (along > 0.0) & (miss < radius**2)
            near = along[hit] - np.sqrt(radius**2 - miss[hit])
            ranges[hit] = np.minimum(ranges[hit], near)
        ranges[ranges > LASER_RANGE] = np.inf
        return LaserScan(
            max(self._time, 0.0),
            -math.pi / 2,
            math.radians(0.5),
            ranges.astype(np.float32),
            0.01,
            LASER_RANGE,
        )

    def _advance(self) -> None:
        """Integrate up to the clock in short steps along exact arcs."""
        now = self._clock()
        while now - self._time > 1e-9:
            step = min(now - self._time, _LONGEST_STEP)
            self._time += step
            v, w = (
                speed + min(max(wanted - speed, -limit * step), limit * step)
                for speed, wanted, limit in zip(
                    self._velocity, self._wanted, self._limits, strict=True
                )
            )
            self._velocity = (v, w)
            if v == 0.0 and w == 0.0:
                if self._wanted == (0.0, 0.0):
                    self._time = now
                continue
            turn = 0.5 * w * step
            reach = v * step * (math.sin(turn) / turn if abs(turn) > 1e-9 else 1.0)
            heading = self._pose.theta + turn
            self._pose = Pose2(
                self._pose.x + reach * math.cos(heading),
                self._pose.y + reach * math.sin(heading),
                wrap_angle(self._pose.theta + w * step),
            )
