"""The simulated laser scanner: rays cast against walls, furniture and vehicle bodies."""

import math
from typing import Any

import numpy as np

from explore_slam.data import LaserScan
from explore_slam.geometry import Pose2
from explore_slam.mounts import LaserMountConfig
from explore_slam.simulation.config import SimulatedLaserConfig
from explore_slam.simulation.rendered.model import BODY, PAINTED, RenderedWorld
from explore_slam.simulation.rendered.mujoco_import import mujoco

RANGE_MIN = 0.05  # m, least range in a scan


class LaserScanner:
    """The scanner of one vehicle.

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
        self._angles = self.angle_min + self.angle_increment * np.arange(beams)
        self._hit = np.zeros(beams, np.int32)
        self._distance = np.zeros(beams)
        self._groups = np.zeros(6, np.uint8)
        self._groups[[BODY, PAINTED]] = 1

    def measure(self, stamp: float, pose: Pose2, world: RenderedWorld, data: Any) -> LaserScan:
        """Return the scan of a vehicle at its true pose; +inf is no return (REP-117)."""
        config = self._config
        mount = pose.compose(self._mount)
        directions = np.zeros((self._angles.size, 3))
        directions[:, 0] = np.cos(self._angles + mount.theta)
        directions[:, 1] = np.sin(self._angles + mount.theta)
        limit = config.simulated_scan_range
        world.show_near(mount.x, mount.y, limit)
        mujoco.mj_multiRay(
            world.model,
            data,
            np.array([mount.x, mount.y, config.simulated_laser_z]),
            directions.ravel(),
            self._groups,
            1,
            self._body,
            self._hit,
            self._distance,
            None,
            self._angles.size,
            limit,
        )
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
        )
