"""Serial lines and TCP connections with one interface, and errors that say what to do."""

import contextlib
import errno
import os
import select
import termios
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import serial

from explore_slam.errors import VehicleError

_BITS_PER_BYTE = 10.0  # 8N1: start bit, 8 data bits, stop bit
_WRITE_TIMEOUT = 1.0  # s
_CHUNK = 4096  # bytes read at once
TCP_SCHEME = 'tcp://'
ROBOT_TCP_PORT = 8101  # of robots behind Ethernet and of simulators of ARCOS
LASER_TCP_PORT = 8102  # of lasers behind Ethernet (default of ARIA)
# TypeError: raised by pyserial if another thread has closed the port
_FAILURES = (serial.SerialException, termios.error, OSError, TypeError, ValueError)


class BaudRateError(VehicleError):
    """The adapter of a port does not have a baud rate."""


class SerialPort:
    """A serial device or `tcp://host:port`, 8N1, opened exclusively.

    tcp_port: used where the address has none.
    All failures raise VehicleError; afterwards, close the port and open a new one.
    """

    def __init__(self, url: str, baud: int, tcp_port: int = ROBOT_TCP_PORT) -> None:
        self.url = url
        self.is_network = url.lower().startswith(TCP_SCHEME)
        if self.is_network:
            self.url = f'{TCP_SCHEME}{_address(url, tcp_port)}'
        self._port = self._open(baud)

    def _open(self, baud: int) -> serial.SerialBase:
        try:
            if self.is_network:
                network = self.url.replace(TCP_SCHEME, 'socket://', 1)
                return serial.serial_for_url(network, timeout=0, write_timeout=_WRITE_TIMEOUT)
            return serial.Serial(
                self.url, baud, timeout=0, write_timeout=_WRITE_TIMEOUT, exclusive=True
            )
        except _FAILURES as error:
            raise VehicleError(f'{self.url}: {_advice(self.url, error)}') from error

    @property
    def baud(self) -> int:
        """Baud rate of the line."""
        return int(self._port.baudrate)

    def set_baud(self, baud: int) -> None:
        """Change the baud rate; no effect on a network connection.

        Raises BaudRateError where the adapter does not have this rate; the old one is kept then.
        """
        if self.is_network or self._port.baudrate == baud:
            return
        old = self._port.baudrate
        try:
            self._port.baudrate = baud
        except _FAILURES as error:
            with self._errors('lost'):
                self._port.baudrate = old
            raise BaudRateError(f'{self.url}: cannot be set to {baud} Bd: {error}') from error

    def transmission_time(self, count: int) -> float:
        """Return the transmission time (s) of this many bytes; 0 for a network connection."""
        return 0.0 if self.is_network else _BITS_PER_BYTE * count / self.baud

    def read(self, timeout: float) -> bytes:
        """Return the received bytes; wait at most timeout (s) for the first one."""
        with self._errors('lost'):
            # select instead of the port's own timeout: changing that reconfigures the line
            ready, _, _ = select.select([self._port.fileno()], [], [], timeout)
            return bytes(self._port.read(_CHUNK)) if ready else b''

    def write(self, data: bytes) -> None:
        """Send bytes."""
        with self._errors('lost'):
            self._port.write(data)

    def discard(self) -> None:
        """Discard bytes received but not read."""
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
        except _FAILURES as error:
            raise VehicleError(f'{self.url}: {what}: {error}') from error


def _address(url: str, tcp_port: int) -> str:
    """Return host:port of a tcp:// address; VehicleError where it has no host or a bad port."""
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = None
    if not host or port == 0 or parts.path not in ('', '/') or parts.query:
        raise VehicleError(
            f"{url}: expected '{TCP_SCHEME}host' or '{TCP_SCHEME}host:port', "
            f'port from 1 to 65535 (default {tcp_port})'
        )
    bracketed = f'[{host}]' if ':' in host else host
    return f'{bracketed}:{tcp_port if port is None else port}'


def _advice(url: str, error: Exception) -> str:
    """Explain why a port cannot be opened, and what to do about it."""
    number = getattr(error, 'errno', None)
    text = str(error)
    if url.startswith(TCP_SCHEME):
        return f'cannot connect ({text}); is the device switched on and its address right?'
    if number == errno.ENOENT or not Path(url).exists():
        return 'no such port; is the cable plugged in? `ls /dev/serial/by-id` lists the ports'
    if number == errno.EACCES:
        return (
            'no permission; add the user to the group that owns the port (usually `dialout`): '
            '`sudo usermod -aG dialout $USER`, then log in again'
        )
    if number in (errno.EBUSY, errno.EAGAIN) or 'lock' in text:
        return f'busy; another program uses it (`fuser -v {os.path.realpath(url)}` shows which)'
    return f'cannot be opened as a serial line ({text})'
