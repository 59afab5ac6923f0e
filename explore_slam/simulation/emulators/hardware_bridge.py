"""Connection of a simulator to emulated hardware: vehicles behind real serial protocols.

The owner of the simulator passes each event to forward() and applies commands(); the devices'
threads read and write under a lock. Devices and lines use simulated time, so that stamps stay
right when the simulator falls behind real time.
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
    """A simulated vehicle as the emulators see it: body of the base, scans of the laser."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._command = (0.0, 0.0)
        self._velocity = (0.0, 0.0)
        self._odometry = IDENTITY
        self._scan: LaserScan | None = None

    def set_velocity(self, linear: float, angular: float) -> None:
        """Set the velocity of the base's motors (m/s, rad/s)."""
        with self._lock:
            self._command = (linear, angular)

    def command(self) -> tuple[float, float]:
        """Return the velocity of the base's motors (m/s, rad/s)."""
        with self._lock:
            return self._command

    def odometry(self) -> Pose2:
        """Return the wheel odometry."""
        with self._lock:
            return self._odometry

    def velocity(self) -> tuple[float, float]:
        """Return the present velocity (m/s, rad/s)."""
        with self._lock:
            return self._velocity

    def scan(self) -> LaserScan | None:
        """Return the newest scan, None before the first one."""
        with self._lock:
            return self._scan

    def update(self, record: object, velocity: tuple[float, float]) -> bool:
        """Set the newest odometry reading or scan; return False for any other record."""
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
    """Emulators of all vehicles: `<folder>/<vehicle>_base` and `<folder>/<vehicle>_laser`.

    laser_boot_time: s for which a laser boots whose power its port switches; 0: always on.
    """

    def __init__(
        self,
        folder: Path,
        vehicles: Iterable[str],
        seed: int = 0,
        laser_boot_time: float = 0.0,
    ) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise SimulationError(
                f'{folder}: cannot create the folder for serial ports: {error}'
            ) from error
        self._time = 0.0
        self.bodies = {name: BridgedVehicle() for name in vehicles}
        self.emulators = {
            name: VehicleEmulator(
                folder,
                name,
                body,
                body.scan,
                clock=lambda: self._time,
                seed=seed + 2 * index,
                laser_boot_time=laser_boot_time,
            )
            for index, (name, body) in enumerate(self.bodies.items())
        }
        for emulator in self.emulators.values():
            emulator.start()

    @property
    def paths(self) -> dict[str, tuple[str, str]]:
        """Paths of base and laser of each vehicle."""
        return {
            name: (emulator.base_line.path, emulator.laser_line.path)
            for name, emulator in self.emulators.items()
        }

    def advance(self, now: float) -> None:
        """Set the simulated time (s) of devices and lines."""
        self._time = now

    def commands(self) -> dict[str, tuple[float, float]]:
        """Return the velocity (m/s, rad/s) of each vehicle's motors."""
        return {name: body.command() for name, body in self.bodies.items()}

    def forward(self, event: SimEvent, velocity: tuple[float, float]) -> bool:
        """Pass an event to the vehicle's devices; return whether they send it on."""
        return self.bodies[event.vehicle].update(event.record, velocity)

    def close(self) -> None:
        """Stop all devices and remove their ports."""
        for emulator in self.emulators.values():
            emulator.stop()
