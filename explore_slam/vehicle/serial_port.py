"""Serial lines and TCP connections under one interface, with errors that say what to do."""

import contextlib
import errno
import logging
import os
import select
from collections.abc import Iterator
from pathlib import Path

import serial

from explore_slam.errors import VehicleError

_log = logging.getLogger(__name__)


class SerialPort:
    """A device file or `tcp://host:port`, 8N1, opened for this process alone.

    Every failure is a VehicleError; after one, close the port and open another.
    """

    def __init__(self, url: str, baud: int) -> None:
        self.url = url
        self.is_network = url.startswith('tcp://')
        self._port = self._open(baud)

    def _open(self, baud: int) -> serial.SerialBase:
        try:
            if self.is_network:
                network = self.url.replace('tcp://', 'socket://', 1)
                return serial.serial_for_url(network, timeout=0, write_timeout=1.0)
            return serial.Serial(self.url, baud, timeout=0, write_timeout=1.0, exclusive=True)
        except (serial.SerialException, OSError, ValueError) as error:
            raise VehicleError(f'{self.url}: {_advice(self.url, error)}') from error

    @property
    def baud(self) -> int:
        """Rate of the line (Bd)."""
        return int(self._port.baudrate)

    def set_baud(self, baud: int) -> None:
        """Change the rate of the line; a network connection has none."""
        if self.is_network or self._port.baudrate == baud:
            return
        with self._errors('cannot be set to another rate'):
            self._port.baudrate = baud

    def transmission_time(self, count: int) -> float:
        """Return how long (s) this many bytes take on the line, 10 bits each."""
        return 0.0 if self.is_network else 10.0 * count / self.baud

    def read(self, timeout: float) -> bytes:
        """Return what has come, waiting at most timeout (s) for the first byte."""
        with self._errors('lost'):
            # select and not the port's own timeout, whose every change reconfigures the line
            ready, _, _ = select.select([self._port.fileno()], [], [], timeout)
            return bytes(self._port.read(4096)) if ready else b''

    def write(self, data: bytes) -> None:
        """Send bytes."""
        with self._errors('lost'):
            self._port.write(data)

    def discard(self) -> None:
        """Throw away what has come but was not read."""
        while self.read(0.0):
            pass

    def close(self) -> None:
        """Release the line."""
        with contextlib.suppress(Exception):
            self._port.close()

    @contextlib.contextmanager
    def _errors(self, what: str) -> Iterator[None]:
        try:
            yield
        except (serial.SerialException, OSError, TypeError, ValueError) as error:
            # TypeError: pyserial's answer to a port closed by another thread
            raise VehicleError(f'{self.url}: {what}: {error}') from error


def _advice(url: str, error: Exception) -> str:
    """Return what is wrong with a port and what to do about it."""
    number = getattr(error, 'errno', None)
    text = str(error)
    if url.startswith('tcp://'):
        return f'cannot connect ({text}); is the robot switched on and its address right?'
    if number == errno.ENOENT or not Path(url).exists():
        return 'no such port; is the cable plugged in? `ls /dev/serial/by-id` shows what there is'
    if number == errno.EACCES:
        return (
            'no permission; add the user to the group that owns the port (mostly `dialout`): '
            '`sudo usermod -aG dialout $USER`, then log in again'
        )
    if number in (errno.EBUSY, errno.EAGAIN) or 'lock' in text:
        return f'busy; another program uses it (`fuser -v {os.path.realpath(url)}` tells which)'
    return f'cannot be opened as a serial line ({text})'
