"""The hardware of one vehicle at the far ends of two serial lines: Pioneer and LMS-200."""

import time
from collections.abc import Callable
from pathlib import Path

from explore_slam.data import LaserScan
from explore_slam.simulation.emulators.arcos_robot import ArcosRobot, Body
from explore_slam.simulation.emulators.lms200_scanner import Lms200Scanner
from explore_slam.simulation.emulators.serial_line import SerialLine


class VehicleEmulator:
    """Pioneer at `<folder>/<name>_base`, laser at `<folder>/<name>_laser`, both ptys.

    clock (s) is the time that devices and lines live in.
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
        seed: int = 0,
    ) -> None:
        self.robot = ArcosRobot(body, subclass=subclass, name=name)
        self.scanner = Lms200Scanner(scan, baud=laser_baud)
        self.base_line = SerialLine(self.robot, folder / f'{name}_base', clock=clock, seed=seed)
        self.laser_line = SerialLine(
            self.scanner, folder / f'{name}_laser', clock=clock, seed=seed + 1
        )

    def start(self) -> 'VehicleEmulator':
        """Plug both cables in."""
        self.base_line.start()
        self.laser_line.start()
        return self

    def stop(self) -> None:
        """Pull both cables and end."""
        self.base_line.stop()
        self.laser_line.stop()

    def __enter__(self) -> 'VehicleEmulator':
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()
