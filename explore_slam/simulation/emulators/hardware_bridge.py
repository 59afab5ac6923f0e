"""Joins the simulator to emulated hardware: simulated vehicles behind real serial protocols.

Whoever steps the simulator hands every event to take() and applies commands(); the devices'
threads read and write under a lock. Devices and lines live in simulated time, so that stamps
stay right when the simulator falls behind real time for a moment.
"""

import threading
from collections.abc import Iterable
from pathlib import Path

from explore_slam.data import LaserScan, OdometryReading
from explore_slam.errors import SimulationError
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.simulation.emulators.vehicle_emulator import VehicleEmulator
from explore_slam.simulation.records import SimEvent


class BridgedVehicle:
    """A simulated vehicle as the emulators see it: Body of the robot, scan source of the laser."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._command = (0.0, 0.0)
        self._velocity = (0.0, 0.0)
        self._odometry = IDENTITY
        self._scan: LaserScan | None = None

    def set_velocity(self, linear: float, angular: float) -> None:
        """Take what the robot's motors do (m/s, rad/s)."""
        with self._lock:
            self._command = (linear, angular)

    def command(self) -> tuple[float, float]:
        """Return what the motors do (m/s, rad/s)."""
        with self._lock:
            return self._command

    def odometry(self) -> Pose2:
        """Return the pose by the wheels."""
        with self._lock:
            return self._odometry

    def velocity(self) -> tuple[float, float]:
        """Return what is driven (m/s, rad/s)."""
        with self._lock:
            return self._velocity

    def scan(self) -> LaserScan | None:
        """Return the newest scan."""
        with self._lock:
            return self._scan

    def take(self, record: object, velocity: tuple[float, float]) -> bool:
        """Take an odometry reading or a scan; False for what is no hardware's business."""
        with self._lock:
            self._velocity = velocity
            if isinstance(record, OdometryReading):
                self._odometry = record.pose
            elif isinstance(record, LaserScan):
                self._scan = record
            else:
                return False
            return True


class HardwareBridge:
    """Emulators of all vehicles: `<folder>/<vehicle>_base` and `<folder>/<vehicle>_laser`."""

    def __init__(self, folder: Path, vehicles: Iterable[str], seed: int = 0) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise SimulationError(f'{folder} cannot be made for serial ports: {error}') from error
        self._time = 0.0
        self.bodies = {name: BridgedVehicle() for name in vehicles}
        self.emulators = {
            name: VehicleEmulator(
                folder, name, body, body.scan, clock=lambda: self._time, seed=seed + 2 * index
            )
            for index, (name, body) in enumerate(self.bodies.items())
        }
        for emulator in self.emulators.values():
            emulator.start()

    @property
    def paths(self) -> dict[str, tuple[str, str]]:
        """Vehicle -> paths of its base and its laser."""
        return {
            name: (emulator.base_line.path, emulator.laser_line.path)
            for name, emulator in self.emulators.items()
        }

    def advance(self, now: float) -> None:
        """Let simulated time (s) be now, for devices and lines."""
        self._time = now

    def commands(self) -> dict[str, tuple[float, float]]:
        """Return vehicle -> what its motors do (m/s, rad/s)."""
        return {name: body.command() for name, body in self.bodies.items()}

    def take(self, event: SimEvent, velocity: tuple[float, float]) -> bool:
        """Take an event; True when it now goes through the hardware and not to topics."""
        return self.bodies[event.vehicle].take(event.record, velocity)

    def close(self) -> None:
        """Pull all cables."""
        for emulator in self.emulators.values():
            emulator.stop()
