"""The devices a vehicle can have, and the settings of its driver.

To add a device, write a class with the protocol of devices.py and a section of its own settings,
and add a line to BASES, LASERS or CAMERAS. The name of that line selects it (base_type, ...).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, make_dataclass
from typing import Any, NamedTuple

from explore_slam.mounts import CameraMountConfig, LaserMountConfig
from explore_slam.settings import Section, section, setting
from explore_slam.vehicle.devices import Base, Camera, Clock, Laser
from explore_slam.vehicle.driver_config import BaseConfig, CameraConfig, LaserConfig, SafetyConfig
from explore_slam.vehicle.kinect import Kinect, KinectConfig
from explore_slam.vehicle.lms200 import Lms200, Lms200Config
from explore_slam.vehicle.pioneer_robot import PioneerConfig, PioneerRobot


class DeviceKind[Common: Section, Made](NamedTuple):
    """A kind of device: section of its own settings, and how to make one.

    make takes the common settings of its role, its own settings and a clock.
    """

    settings: type[Section]
    make: Callable[[Common, Any, Clock], Made]


BASES: Mapping[str, DeviceKind[BaseConfig, Base]] = {
    'pioneer': DeviceKind(PioneerConfig, PioneerRobot),
}
LASERS: Mapping[str, DeviceKind[LaserConfig, Laser]] = {
    'lms200': DeviceKind(Lms200Config, Lms200),
}
CAMERAS: Mapping[str, DeviceKind[CameraConfig, Camera]] = {
    'kinect': DeviceKind(KinectConfig, Kinect),
}

_OWN_SETTINGS: dict[str, type[Section]] = {
    **{name: kind.settings for name, kind in BASES.items()},
    **{name: kind.settings for name, kind in LASERS.items()},
    **{name: kind.settings for name, kind in CAMERAS.items()},
}
DevicesConfig: type[Section] = make_dataclass(
    'DevicesConfig',
    [(name, settings, section(settings)) for name, settings in _OWN_SETTINGS.items()],
    bases=(Section,),
    frozen=True,
)


@dataclass(frozen=True)
class DriverConfig(Section):
    """All settings of the driver of one vehicle."""

    base_type: str = setting('pioneer', 'Kind of base', choices=tuple(BASES), tier='basic')
    laser_type: str = setting('lms200', 'Kind of laser', choices=tuple(LASERS), tier='basic')
    camera_type: str = setting('kinect', 'Kind of camera', choices=tuple(CAMERAS), tier='basic')
    base: BaseConfig = section(BaseConfig)
    laser: LaserConfig = section(LaserConfig)
    camera: CameraConfig = section(CameraConfig)
    laser_mount: LaserMountConfig = section(LaserMountConfig)
    camera_mount: CameraMountConfig = section(CameraMountConfig)
    safety: SafetyConfig = section(SafetyConfig)
    devices: Section = section(DevicesConfig)
    retry_after: float = setting(
        0.25, 'First wait before a lost device is connected again; doubles up to 1 s', unit='s',
        low=0.05, high=10.0,
    )  # fmt: skip


def make_base(config: DriverConfig, clock: Clock) -> Base | None:
    """Return the configured base, not connected; None where enable_base is false."""
    if not config.base.enable_base:
        return None
    own = getattr(config.devices, config.base_type)
    return BASES[config.base_type].make(config.base, own, clock)


def make_laser(config: DriverConfig, clock: Clock) -> Laser | None:
    """Return the configured laser, not connected; None where enable_laser is false."""
    if not config.laser.enable_laser:
        return None
    own = getattr(config.devices, config.laser_type)
    return LASERS[config.laser_type].make(config.laser, own, clock)


def make_camera(config: DriverConfig, clock: Clock) -> Camera | None:
    """Return the configured camera, not connected; None where enable_camera is false."""
    if not config.camera.enable_camera:
        return None
    own = getattr(config.devices, config.camera_type)
    return CAMERAS[config.camera_type].make(config.camera, own, clock)
