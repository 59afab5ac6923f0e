"""Poses of the sensors on a vehicle: one section of settings per sensor, for all that use it.

Vehicle frame: x forward, y left, z up, origin midway between the drive wheels on the ground
(REP-103, REP-105).
"""

from dataclasses import dataclass
from typing import NamedTuple

from explore_slam.geometry import Pose2, Pose3
from explore_slam.settings import Section, setting

# m; LMS-200 on a P3-DX as delivered: LaserX 18 mm in p3dx.p, 21 mm in p3dx-sh.p of ARIA
STOCK_LASER_X = 0.02


@dataclass(frozen=True)
class LaserMountConfig(Section):
    """Pose of the laser scanner in the vehicle frame; the default is that of a stock P3-DX."""

    laser_x: float = setting(
        STOCK_LASER_X,
        'Laser ahead of the vehicle origin',
        unit='m',
        low=-10.0,
        high=10.0,
        tier='basic',
    )
    laser_y: float = setting(
        0.0, 'Laser left of the vehicle origin', unit='m', low=-10.0, high=10.0, tier='basic'
    )
    laser_yaw: float = setting(
        0.0,
        'Heading of the laser in the vehicle frame',
        unit='rad',
        low=-3.2,
        high=3.2,
        tier='basic',
    )

    @property
    def pose(self) -> Pose2:
        """Pose of the laser in the vehicle frame."""
        return Pose2(self.laser_x, self.laser_y, self.laser_yaw)


@dataclass(frozen=True)
class CameraMountConfig(Section):
    """Pose of the camera body (x forward, y left, z up) in the vehicle frame."""

    camera_x: float = setting(
        0.1, 'Camera ahead of the vehicle origin', unit='m', low=-10.0, high=10.0, tier='basic'
    )
    camera_y: float = setting(
        0.0, 'Camera left of the vehicle origin', unit='m', low=-10.0, high=10.0, tier='basic'
    )
    camera_z: float = setting(
        0.4, 'Camera above the vehicle origin', unit='m', low=-10.0, high=10.0, tier='basic'
    )
    camera_roll: float = setting(
        0.0, 'Camera roll, fixed axes', unit='rad', low=-3.2, high=3.2, tier='basic'
    )
    camera_pitch: float = setting(
        0.0,
        'Camera pitch, fixed axes; positive looks down',
        unit='rad',
        low=-3.2,
        high=3.2,
        tier='basic',
    )
    camera_yaw: float = setting(
        0.0, 'Camera yaw, fixed axes', unit='rad', low=-3.2, high=3.2, tier='basic'
    )


class ExplicitMounts(NamedTuple):
    """Poses of laser and of optical frame that settings give explicitly; None: not set.

    Transforms are compared with these. Defaults of settings are not: they say nothing about a
    vehicle.
    """

    laser: Pose2 | None = None
    camera: Pose3 | None = None
