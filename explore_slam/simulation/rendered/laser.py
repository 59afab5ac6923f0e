"""The simulated laser scanner: rays cast against walls, furniture and vehicle bodies."""

import math
from typing import Any, NamedTuple

import numpy as np

from explore_slam.data import LaserScan
from explore_slam.geometry import Array, Pose2
from explore_slam.mounts import LaserMountConfig
from explore_slam.simulation.config import SimulatedLaserConfig
from explore_slam.simulation.rendered.model import BODY, PAINTED, RenderedWorld
from explore_slam.simulation.rendered.mujoco_import import mujoco

RANGE_MIN = 0.05  # m, least range in a scan
# s; beams measured within this time begin at one point: 2 mm apart at 0.4 m/s
_SAME_ORIGIN = 0.005


class TimedPose(NamedTuple):
    """A true pose and its time (s)."""

    time: float
    pose: Pose2


class LaserScanner:
    """The scanner of one vehicle: all beams at one moment, or one after the other (sweep_time).

    body: MuJoCo id of the vehicle's own body, which its beams ignore.
    """

    def __init__(
        self,
        config: SimulatedLaserConfig,
        mount: LaserMountConfig,
        body: int,
        rng: np.random.Generator,
    ) -> None:
        self._config = config
        self._mount = mount.pose
        self._body = body
        self._rng = rng
        span, beams = math.radians(config.simulated_field_of_view), config.simulated_beams
        self.angle_min = -0.5 * span
        self.angle_increment = span / (beams - 1)
        self._angles: Array = self.angle_min + self.angle_increment * np.arange(
            beams, dtype=np.float64
        )
        self._time_increment = config.simulated_sweep_time / (beams - 1)
        self._hit = np.zeros(beams, np.int32)
        self._distance = np.zeros(beams)
        self._groups = np.zeros(6, np.uint8)
        self._groups[[BODY, PAINTED]] = 1
        self._stamp: float | None = None  # of the sweep that has begun
        self._done = 0  # its beams that have been measured
        self._next = False  # whether the next sweep begins as soon as this one is complete

    def measure(self, stamp: float, pose: Pose2, world: RenderedWorld, data: Any) -> LaserScan:
        """Return the scan of a vehicle at its true pose; +inf is no return (REP-117)."""
        self._cast(0, self._angles + pose.compose(self._mount).theta, pose, world, data)
        return self._scan(stamp)

    @property
    def is_sweeping(self) -> bool:
        """Whether a sweep has begun and is not complete."""
        return self._stamp is not None

    def begin(self, stamp: float) -> None:
        """Begin a sweep, whose first beam is measured at the stamp (s) or after the last sweep."""
        if self.is_sweeping:
            self._next = True
        else:
            self._stamp, self._done = stamp, 0

    def advance(
        self, before: TimedPose, after: TimedPose, world: RenderedWorld, data: Any
    ) -> LaserScan | None:
        """Measure the beams that are due until after; return the scan when it is complete.

        before, after: the last time step of the vehicle. Its pose in between is interpolated;
        other bodies are where they are at its end.
        """
        if self._stamp is None:
            return None
        beams = self._angles.size
        times = self._stamp + self._time_increment * np.arange(self._done, beams)
        due = times[times <= after.time + 1e-9]
        shares = np.clip((due - before.time) / (after.time - before.time), 0.0, 1.0)
        step = before.pose.between(after.pose)
        size = max(round(_SAME_ORIGIN / self._time_increment), 1)
        for first in range(0, len(due), size):
            own = shares[first : first + size]
            middle = float(own.mean())
            pose = before.pose.compose(
                Pose2(middle * step.x, middle * step.y, middle * step.theta)
            )
            number = self._done + first
            angles = self._angles[number : number + len(own)]
            headings = before.pose.theta + own * step.theta + self._mount.theta + angles
            self._cast(number, headings, pose, world, data)
        self._done += len(due)
        if self._done < beams:
            return None
        stamp, self._stamp = self._stamp, None
        if self._next:
            self._next = False
            self.begin(after.time)
        return self._scan(stamp)

    def _cast(
        self, first: int, headings: Array, pose: Pose2, world: RenderedWorld, data: Any
    ) -> None:
        """Cast the beams from number first on, with headings (n,) rad, from a pose."""
        mount, count = pose.compose(self._mount), len(headings)
        directions = np.zeros((count, 3))
        directions[:, 0] = np.cos(headings)
        directions[:, 1] = np.sin(headings)
        limit = self._config.simulated_scan_range
        world.show_near(mount.x, mount.y, limit)
        mujoco.mj_multiRay(
            world.model,
            data,
            np.array([mount.x, mount.y, self._config.simulated_laser_z]),
            directions.ravel(),
            self._groups,
            1,
            self._body,
            self._hit[first : first + count],
            self._distance[first : first + count],
            None,
            count,
            limit,
        )

    def _scan(self, stamp: float) -> LaserScan:
        """Return the distances measured last as a scan, with noise."""
        config, limit = self._config, self._config.simulated_scan_range
        noise = self._rng.standard_normal(self._angles.size) * config.simulated_scan_noise
        ranges = np.maximum(self._distance + noise, RANGE_MIN)
        ranges[(self._distance < 0.0) | (ranges > limit)] = np.inf
        return LaserScan(
            stamp,
            self.angle_min,
            self.angle_increment,
            ranges.astype(np.float32),
            RANGE_MIN,
            limit,
            self._mount,
            time_increment=self._time_increment,
            scan_time=1.0 / config.simulated_scan_rate if config.simulated_scan_rate else 0.0,
        )
