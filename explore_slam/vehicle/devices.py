"""What the driver of a vehicle needs of a base, a laser scanner and a camera: protocols.

A device is used by one thread (supervisor.Supervisor). Another device is a class with these
methods and a line in registry.py.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from explore_slam.data import LaserScan, OdometryReading, RgbdFrame
from explore_slam.geometry import Array

Clock = Callable[[], float]  # s, gives the stamps of records
Statistics = dict[str, Any]  # name -> counter or state, for diagnostics


class Progress:
    """What a connection that takes long reports to its supervisor, which may interrupt it."""

    def __init__(self) -> None:
        self.interrupted = threading.Event()
        self.on_text: Callable[[str], None] = lambda _: None

    def tell(self, text: str) -> None:
        """Report what is waited for."""
        self.on_text(text)


@runtime_checkable
class SlowDevice(Protocol):
    """A device that may take long to connect, or that must not be closed between attempts.

    Optional beside Device: the supervisor looks for it.
    """

    progress: Progress

    def suspend(self) -> None:
        """Give up the session after a failure, but keep what the next connect can use.

        A port that switches the power of its device stays open. Never raises.
        """


class Device[Record](Protocol):
    """A device that is connected, polled for records and closed; it can be connected again."""

    def connect(self) -> object:
        """Make the device ready and return a description of it.

        Raises VehicleError that says what is wrong and what to do.
        """

    def poll(self, timeout: float) -> list[Record]:
        """Return the records received within timeout (s).

        Raises VehicleError when the device is lost.
        """

    def close(self) -> None:
        """Release the device and leave it in a safe state; never raises."""

    def statistics(self) -> Statistics:
        """Return counters and states for diagnostics."""


@dataclass(frozen=True)
class BaseState:
    """What a base reports at one time, in SI units; fields it cannot measure keep defaults."""

    odometry: OdometryReading
    linear: float  # m/s
    angular: float  # rad/s
    received: float  # s, stamp clock
    motors_on: bool
    battery: float  # V
    charging: bool = False
    emergency_stop: bool = False  # the button is pressed
    stalled: bool = False  # some wheel is
    front_bumpers: int = 0  # one bit per pressed segment
    rear_bumpers: int = 0
    faults: int | None = None  # code of the manufacturer
    charge: float | None = None  # of the battery, 0 to 1; None: not measured
    sonar_points: Array | None = None  # echoes (N, 2) m, vehicle frame; None: no reading


class Base(Device[BaseState], Protocol):
    """A mobile base. Its motors stay off until enable_motors(True)."""

    def set_velocity(self, linear: float, angular: float) -> None:
        """Command a velocity (m/s, rad/s), valid until the next one."""

    def enable_motors(self, on: bool) -> None:
        """Switch the motors on or off."""


class Laser(Device[LaserScan], Protocol):
    """A laser scanner; scans are in the frame of its mount."""

    @property
    def last_received(self) -> float:
        """Monotonic time (s) of the last byte received, -inf before the first one."""


class Camera(Device[RgbdFrame], Protocol):
    """An RGB-D camera with depth registered to colour."""
