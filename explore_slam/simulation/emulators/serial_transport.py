"""The device's end of a client's serial port: a pseudo terminal, or a TCP server."""

import contextlib
import os
import pty
import select
import socket
import termios
import time
import tty
from pathlib import Path

from explore_slam.errors import SimulationError
from explore_slam.files import replace_link

_TERMIOS_RATES = {
    getattr(termios, f'B{rate}'): rate
    for rate in (9600, 19200, 38400, 57600, 115200, 500000)
    if hasattr(termios, f'B{rate}')
}


class PtyTransport:
    """A pseudo terminal whose clients may come and go.

    held: also keep the client's end open, so that nothing that is sent before a client comes is
    lost. Without it, host_open tells whether a client has opened the port.
    """

    def __init__(self, link: Path | None, *, held: bool = True) -> None:
        self._link = link
        self._held = held
        self._master = self._slave = -1
        self._name = ''

    @property
    def path(self) -> str:
        """What a client opens: a device file, or tcp://host:port."""
        return str(self._link) if self._link is not None else self._name

    @property
    def connected(self) -> bool:
        """Whether bytes can be sent to a client."""
        return self._master >= 0 and self.host_open

    @property
    def host_open(self) -> bool:
        """Whether a client has the port open; True where its end is held open."""
        if self._held or self._master < 0:
            return self._master >= 0
        poll = select.poll()
        poll.register(self._master, select.POLLIN)
        return not any(event & select.POLLHUP for _, event in poll.poll(0))

    def open(self) -> None:
        """Connect, or connect again."""
        self.close()
        self._master, self._slave = pty.openpty()
        self._name = os.ttyname(self._slave)
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        if not self._held:  # from now on the kernel reports a hangup until a client opens it
            os.close(self._slave)
            self._slave = -1
        if self._link is not None:
            replace_link(self._link, self._name)

    def close(self) -> None:
        """Disconnect."""
        if self._master < 0:
            return
        for end in (self._master, self._slave):
            if end >= 0:
                os.close(end)
        self._master = self._slave = -1
        if self._link is not None and self._link.is_symlink():
            self._link.unlink()

    def wait(self, timeout: float) -> None:
        """Wait at most timeout (s) for bytes of the host."""
        master = self._master
        if not self.host_open:  # select would return at once
            time.sleep(timeout)
            return
        with contextlib.suppress(OSError, ValueError):
            select.select([master], [], [], timeout)

    def host_rate(self) -> int:
        """Return the baud rate of the host's end, 0 where it has none."""
        if self._master < 0:
            return 0
        # both ends of a pseudo terminal have the settings of the client's end
        return _TERMIOS_RATES.get(termios.tcgetattr(self._master)[5], 1)

    def read(self) -> bytes:
        """Return the bytes received from the host."""
        try:
            return os.read(self._master, 4096) if self._master >= 0 else b''
        except OSError:
            return b''

    def write(self, data: bytes) -> int:
        """Send bytes; return how many need not be sent again."""
        try:
            return os.write(self._master, data)
        except BlockingIOError:
            return len(data)  # the client does not read: a UART would lose the bytes too
        except OSError:
            return len(data)


class TcpTransport:
    """A listening socket for one client at a time, like the TCP simulators of ARCOS."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._server: socket.socket | None = None
        self._client: socket.socket | None = None

    @property
    def path(self) -> str:
        """What a client opens: a device file, or tcp://host:port."""
        return f'tcp://127.0.0.1:{self._port}'

    @property
    def connected(self) -> bool:
        """Whether bytes can be sent to a client."""
        return self._client is not None

    @property
    def host_open(self) -> bool:
        """Whether a client is connected."""
        return self._client is not None

    def open(self) -> None:
        """Connect, or connect again."""
        self.close()
        server = socket.socket()
        server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            server.bind(('127.0.0.1', self._port))
        except OSError as error:
            server.close()
            raise SimulationError(f'TCP port {self._port}: cannot listen: {error}') from error
        self._port = server.getsockname()[1]
        server.listen(1)
        server.setblocking(False)
        self._server = server

    def close(self) -> None:
        """Disconnect."""
        for end in (self._client, self._server):
            if end is not None:
                end.close()
        self._client = self._server = None

    def wait(self, timeout: float) -> None:
        """Wait at most timeout (s) for bytes of the host."""
        end = self._client or self._server
        if end is None:
            time.sleep(timeout)
            return
        with contextlib.suppress(OSError, ValueError):
            select.select([end], [], [], timeout)

    def host_rate(self) -> int:
        """Return the baud rate of the host's end, 0 where it has none."""
        return 0

    def read(self) -> bytes:
        """Return the bytes received from the host."""
        if self._client is None and self._server is not None:
            with contextlib.suppress(OSError):
                self._client, _ = self._server.accept()
                self._client.setblocking(False)
                self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if self._client is None:
            return b''
        try:
            data = self._client.recv(4096)
        except BlockingIOError:
            return b''
        except OSError:
            data = b''
        if not data:
            self._client.close()
            self._client = None
        return data

    def write(self, data: bytes) -> int:
        """Send bytes; return how many need not be sent again."""
        assert self._client is not None
        try:
            return self._client.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            return len(data)
