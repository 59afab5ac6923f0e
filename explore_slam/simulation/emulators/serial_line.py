"""A serial cable with a simulated device at its far end: pty or TCP, real timing, faults.

The near end is any client of the device's protocol: this project's drivers, or another's.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from explore_slam.simulation.emulators.serial_transport import PtyTransport, TcpTransport

_TICK = 0.004  # s between looks at the device while bytes are on the way


class SerialDevice(Protocol):
    """What sits at the far end; all calls come from one thread, now is monotonic seconds."""

    @property
    def baud(self) -> int:
        """The rate (Bd) at which the device talks now."""

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes of the host."""

    def transmit(self, now: float) -> bytes:
        """Return what the device wants to send at this time."""


@dataclass
class LineFaults:
    """What goes wrong on the line; change it at any time. Rates are per byte, both ways."""

    drop_rate: float = 0.0
    duplicate_rate: float = 0.0
    corrupt_rate: float = 0.0
    silent: bool = False  # the device hears and says nothing
    deaf: bool = False  # the device does not hear


class SerialLine:
    """Runs a device behind a pty (`link` is a symbolic link to it) or a TCP port.

    realtime: bytes take 10 bits each at the device's rate; a host at another rate sends and
    receives garbage. on_sent(time, data) is called when the last byte of a chunk is out. clock
    (s) is the time the device and the line live in: real time, or simulated time.
    """

    def __init__(
        self,
        device: SerialDevice,
        link: Path | None = None,
        *,
        tcp_port: int | None = None,
        realtime: bool = True,
        clock: Callable[[], float] = time.monotonic,
        seed: int = 0,
    ) -> None:
        self.device = device
        self.faults = LineFaults()
        self.link = link
        self.realtime = realtime
        self._clock = clock
        self.on_sent: Callable[[float, bytes], None] | None = None
        self._generator = np.random.default_rng(seed)
        self._outbox = bytearray()
        self._budget = 0.0
        self._lock = threading.RLock()
        self._end = threading.Event()
        self._transport: PtyTransport | TcpTransport
        self._transport = PtyTransport(link) if tcp_port is None else TcpTransport(tcp_port)
        self._thread = threading.Thread(target=self._run, name='serial-line', daemon=True)

    @property
    def path(self) -> str:
        """What a client opens: a device path, or tcp://host:port."""
        return self._transport.path

    def start(self) -> 'SerialLine':
        """Plug the cable in and run the device."""
        self.plug()
        self._thread.start()
        return self

    def plug(self) -> None:
        """(Re)connect the cable: a new pty under the same link, or the TCP port again."""
        with self._lock:
            self._transport.open()

    def unplug(self) -> None:
        """Pull the cable: the client's port is dead from now on."""
        with self._lock:
            self._transport.close()
            self._outbox.clear()

    def stop(self) -> None:
        """End the device and remove the link."""
        self._end.set()
        if self._thread.is_alive():
            self._thread.join(2.0)
        self.unplug()

    def __enter__(self) -> 'SerialLine':
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _run(self) -> None:
        last = self._clock()
        while not self._end.is_set():
            wait = _TICK if self._outbox else 2.0 * _TICK
            self._transport.wait(wait)
            with self._lock:
                now = self._clock()
                self._exchange(now, now - last)
                last = now

    def _exchange(self, now: float, elapsed: float) -> None:
        matched = self._transport.host_rate() in (0, self.device.baud)
        data = self._transport.read()
        if data and not (self.faults.deaf or self.faults.silent):
            self.device.receive(self._disturb(data) if matched else self._garble(data), now)
        fresh = self.device.transmit(now)
        if not self._transport.connected or self.faults.silent:
            self._outbox.clear()
            return
        if fresh:
            fresh = self._disturb(fresh) if matched else self._garble(fresh)
            if not self._outbox:
                self._budget = 0.0  # an idle line saves nothing up
            self._outbox += fresh
        self._send(now, elapsed)

    def _send(self, now: float, elapsed: float) -> None:
        if not self._outbox:
            return
        count = len(self._outbox)
        if self.realtime and self._transport.host_rate():
            self._budget += elapsed * self.device.baud / 10.0
            count = min(int(self._budget), count)
            self._budget -= count
        if count <= 0:
            return
        chunk = bytes(self._outbox[:count])
        written = self._transport.write(chunk)
        del self._outbox[:written]
        if self.on_sent is not None and written:
            self.on_sent(now, chunk[:written])

    def _disturb(self, data: bytes) -> bytes:
        f = self.faults
        if f.drop_rate == f.duplicate_rate == f.corrupt_rate == 0.0:
            return data
        draw = self._generator.random((3, len(data)))
        result = bytearray()
        for byte, drop, duplicate, corrupt in zip(data, *draw, strict=True):
            if drop < f.drop_rate:
                continue
            damaged = byte ^ int(self._generator.integers(1, 256))
            result.append(damaged if corrupt < f.corrupt_rate else byte)
            if duplicate < f.duplicate_rate:
                result.append(byte)
        return bytes(result)

    def _garble(self, data: bytes) -> bytes:
        return self._generator.bytes(max(len(data) // 2, 1))
