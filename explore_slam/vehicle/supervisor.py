"""Keeps one device of a vehicle running: connects, polls, and after a failure tries again."""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from explore_slam.errors import ExploreSlamError

_log = logging.getLogger(__name__)
_LONGEST_WAIT = 1.0  # s between attempts
_REPEAT_LOG = 30.0  # s after which a failure that lasts is logged again


class Device(Protocol):
    """What a supervisor runs: PioneerRobot, Lms200, Kinect."""

    def connect(self) -> Any:
        """Make the device ready; raises VehicleError when it is not to be had."""

    def poll(self, timeout: float) -> list[Any]:
        """Return what came within timeout (s); raises VehicleError when the device is lost."""

    def close(self) -> None:
        """Leave the device in a safe state; never raises."""


@dataclass
class Health:
    """How a device fares, for reports."""

    connected: bool = False
    message: str = 'not yet connected'
    attempts: int = 0
    losses: int = 0
    records: int = 0
    last_record: float = -float('inf')  # monotonic s


class Supervisor:
    """Owns the thread that talks to one device; a failure of one leaves the others alone.

    on_record(record) takes what came, on_connected() follows every connection, on_turn() is
    called after every poll, at least every poll_timeout s; all in this thread.
    """

    def __init__(
        self,
        name: str,
        device: Device,
        on_record: Callable[[Any], None],
        *,
        on_connected: Callable[[], None] = lambda: None,
        on_turn: Callable[[], None] = lambda: None,
        retry_after: float = 0.25,
        poll_timeout: float = 0.1,
    ) -> None:
        self.name = name
        self.health = Health()
        self._device = device
        self._on_record = on_record
        self._on_connected = on_connected
        self._on_turn = on_turn
        self._retry_after = retry_after
        self._poll_timeout = poll_timeout
        self._end = threading.Event()
        self._logged = ('', 0.0)
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Begin to connect and poll."""
        self._thread.start()

    def stop(self, timeout: float = 3.0) -> None:
        """Close the device and end the thread."""
        self._end.set()
        if self._thread.is_alive():
            self._thread.join(timeout)

    def _run(self) -> None:
        wait = self._retry_after
        try:
            while not self._end.is_set():
                try:
                    self._connect()
                    wait = self._retry_after
                    while not self._end.is_set():
                        for record in self._device.poll(self._poll_timeout):
                            self.health.records += 1
                            self.health.last_record = time.monotonic()
                            self._on_record(record)
                        self._on_turn()
                except Exception as error:  # a bug in one part must not end the others
                    self._lose(error)
                    self._end.wait(wait)
                    wait = min(2.0 * wait, _LONGEST_WAIT)
        finally:
            self._device.close()
            self.health.connected = False

    def _connect(self) -> None:
        self.health.attempts += 1
        what = self._device.connect()
        self.health.connected = True
        self.health.message = f'{what}'
        self._logged = ('', 0.0)
        _log.info('%s: connected: %s', self.name, what)
        self._on_connected()

    def _lose(self, error: Exception) -> None:
        if self.health.connected:
            self.health.losses += 1
        self.health.connected = False
        known = isinstance(error, ExploreSlamError)
        text = str(error) if known else f'{type(error).__name__}: {error}'
        self.health.message = text
        self._device.close()
        last, when = self._logged
        now = time.monotonic()
        if text != last or now - when > _REPEAT_LOG:
            self._logged = (text, now)
            _log.error('%s: %s', self.name, text, exc_info=None if known else error)
