"""Supervision of a device: connect, poll, reconnect after a failure, report health."""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from explore_slam.errors import ExploreSlamError
from explore_slam.vehicle.devices import Device, SlowDevice

_log = logging.getLogger(__name__)
_LONGEST_WAIT = 1.0  # s between attempts to connect
_REPEAT_LOG = 30.0  # s after which a persistent failure is logged again


@dataclass
class Health:
    """Health of a device, for diagnostics."""

    connected: bool = False
    message: str = 'not yet connected'
    attempts: int = 0
    losses: int = 0
    records: int = 0
    waiting: bool = False  # connecting, and not because of a failure: message says for what


class Supervisor:
    """Owns the thread that uses one device, so that failures of devices are independent.

    on_record(record) is called for each record, on_connected() after each connection, on_poll()
    after each poll, i.e. at least every poll_timeout (s) while connected; all in that thread.
    retry_after: first wait (s) before reconnecting, doubled up to 1 s.
    """

    def __init__(
        self,
        name: str,
        device: Device[Any],
        on_record: Callable[[Any], None],
        *,
        on_connected: Callable[[], None] = lambda: None,
        on_poll: Callable[[], None] = lambda: None,
        retry_after: float = 0.25,
        poll_timeout: float = 0.1,
    ) -> None:
        self.name = name
        self.health = Health()
        self._device = device
        self._on_record = on_record
        self._on_connected = on_connected
        self._on_poll = on_poll
        self._retry_after = retry_after
        self._poll_timeout = poll_timeout
        self._patient = True
        self._tried = threading.Event()
        self._end = threading.Event()
        self._logged = ('', 0.0)
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._slow = device if isinstance(device, SlowDevice) else None
        if self._slow is not None:
            self._slow.progress.on_text = self._report_progress

    def start(self, patient: bool = True) -> None:
        """Start the thread: connect and poll.

        patient: keep trying when the first connection fails. Otherwise the thread ends then, and
        the reason is in health.message.
        """
        self._patient = patient
        if self._slow is not None:
            self._slow.progress.interrupted.clear()
        self._thread.start()

    def await_attempt(self, timeout: float) -> bool:
        """Wait at most timeout (s) for the first attempt to connect; return its success."""
        return self._tried.wait(timeout) and self.health.connected

    def stop(self, timeout: float = 3.0) -> None:
        """Stop the thread, which closes the device; wait for it at most timeout (s)."""
        self._end.set()
        if self._slow is not None:
            self._slow.progress.interrupted.set()
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
                            self._on_record(record)
                        self._on_poll()
                except Exception as error:  # a bug in one device must not stop the supervision
                    if not (self._patient or self._tried.is_set()):
                        self.health.message = _text_of(error)
                        break
                    if self._end.is_set():
                        break
                    self._lose(error)
                    self._tried.set()
                    self._end.wait(wait)
                    wait = min(2.0 * wait, _LONGEST_WAIT)
        finally:
            self._device.close()
            self.health.connected = self.health.waiting = False
            self._tried.set()

    def _connect(self) -> None:
        self.health.attempts += 1
        what = self._device.connect()
        self.health.connected, self.health.waiting = True, False
        self.health.message = f'{what}'
        self._logged = ('', 0.0)
        _log.info('%s: connected: %s', self.name, what)
        self._on_connected()
        self._tried.set()

    def _report_progress(self, text: str) -> None:
        if not self.health.waiting:  # once; the message counts on
            _log.info('%s: %s', self.name, text)
        self.health.waiting = True
        self.health.message = text

    def _lose(self, error: Exception) -> None:
        if self.health.connected:
            self.health.losses += 1
        self.health.connected = self.health.waiting = False
        known = isinstance(error, ExploreSlamError)
        text = _text_of(error)
        self.health.message = text
        if self._slow is not None:
            self._slow.suspend()
        else:
            self._device.close()
        last, when = self._logged
        now = time.monotonic()
        if text != last or now - when > _REPEAT_LOG:
            self._logged = (text, now)
            _log.error('%s: %s', self.name, text, exc_info=None if known else error)


def _text_of(error: Exception) -> str:
    known = isinstance(error, ExploreSlamError)
    return str(error) if known else f'{type(error).__name__}: {error}'
