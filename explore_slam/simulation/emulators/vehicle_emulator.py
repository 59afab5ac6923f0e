"""Emulated hardware of one vehicle: a Pioneer and an LMS-200 at two serial lines."""

import time
from collections.abc import Callable
from pathlib import Path

from explore_slam.data import LaserScan
from explore_slam.simulation.emulators.arcos_robot import ArcosRobot, Body
from explore_slam.simulation.emulators.lms200_scanner import BOOT_TIME, Lms200Scanner
from explore_slam.simulation.emulators.serial_line import SerialLine


class VehicleEmulator:
    """A Pioneer at the pty `<folder>/<name>_base`, a laser at `<folder>/<name>_laser`.

    clock: time (s) of devices and lines, real or simulated.
    laser_boot_time: s for which the laser boots when its port is opened, which switches its power;
    0: it has power all the time.
    """

    def __init__(
        self,
        folder: Path,
        name: str,
        body: Body,
        scan: Callable[[], LaserScan | None],
        *,
        subclass: str = 'p3dx-sh',
        clock: Callable[[], float] = time.monotonic,
        laser_baud: int = 9600,
        laser_boot_time: float = 0.0,
        seed: int = 0,
    ) -> None:
        self.robot = ArcosRobot(body, subclass=subclass, name=name)
        powered = laser_boot_time > 0.0
        boot_time = laser_boot_time if powered else BOOT_TIME
        self.scanner = Lms200Scanner(scan, baud=laser_baud, boot_time=boot_time)
        self.base_line = SerialLine(self.robot, folder / f'{name}_base', clock=clock, seed=seed)
        self.laser_line = SerialLine(
            self.scanner,
            folder / f'{name}_laser',
            powered=powered,
            clock=clock,
            seed=seed + 1,
        )

    def start(self) -> 'VehicleEmulator':
        """Connect both cables and run the devices."""
        self.base_line.start()
        self.laser_line.start()
        return self

    def stop(self) -> None:
        """Stop the devices and remove their ports."""
        self.base_line.stop()
        self.laser_line.stop()

    def __enter__(self) -> 'VehicleEmulator':
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()
