"""A serial line with an emulated device at its end: pty or TCP, real timing, faults.

Any client of the device's protocol can be at the other end.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, cast

import numpy as np

from explore_slam.simulation.emulators.serial_transport import PtyTransport, TcpTransport

_TICK = 0.004  # s between exchanges while bytes are being sent, twice as much otherwise


class SerialDevice(Protocol):
    """An emulated device; all calls come from one thread. now: seconds of the line's clock."""

    @property
    def baud(self) -> int:
        """The present baud rate of the device."""

    def receive(self, data: bytes, now: float) -> None:
        """Receive bytes of the host."""

    def transmit(self, now: float) -> bytes:
        """Return the bytes that the device sends at this time."""


class PoweredDevice(SerialDevice, Protocol):
    """An emulated device whose power supply is switched by the control lines of the port."""

    def set_power(self, on: bool, now: float) -> None:
        """Switch the supply on or off."""


@dataclass
class LineFaults:
    """Faults of the line; may be changed at any time. Rates are per byte in both directions."""

    drop_rate: float = 0.0
    duplicate_rate: float = 0.0
    corrupt_rate: float = 0.0
    silent: bool = False  # no byte passes in either direction
    deaf: bool = False  # no byte reaches the device


class SerialLine:
    """Runs a device behind a pty or a TCP port, in a thread.

    link: symbolic link to the pty. tcp_port: port to listen at instead, 0 for any free one.
    powered: the device (a PoweredDevice) has power only while a client has the port open, as
    where DTR or RTS of the port switches it: the laser of many Pioneers.
    realtime: bytes take 10 bits each at the device's baud rate. A host at another baud rate sends
    and receives garbage.
    clock: time (s) of device and line, real or simulated.
    The attribute on_sent(time, data), if set, is called when a chunk has been sent.
    """

    def __init__(
        self,
        device: SerialDevice,
        link: Path | None = None,
        *,
        tcp_port: int | None = None,
        powered: bool = False,
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
        if tcp_port is None:
            self._transport = PtyTransport(link, held=not powered)
        else:
            self._transport = TcpTransport(tcp_port)
        self._powered: PoweredDevice | None = None
        self._power = False
        if powered:
            self._powered = cast(PoweredDevice, device)
            self._powered.set_power(False, clock())
        self._thread = threading.Thread(target=self._run, name='serial-line', daemon=True)

    @property
    def path(self) -> str:
        """What a client opens: a device file, or tcp://host:port."""
        return self._transport.path

    def start(self) -> 'SerialLine':
        """Connect the cable and run the device."""
        self.plug()
        self._thread.start()
        return self

    def plug(self) -> None:
        """Connect the cable (again): a new pty under the same link, or the same TCP port."""
        with self._lock:
            self._transport.open()

    def unplug(self) -> None:
        """Disconnect the cable: the client's port becomes invalid."""
        with self._lock:
            self._transport.close()
            self._outbox.clear()

    def stop(self) -> None:
        """Stop the device and remove the link."""
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
        """Pass bytes in both directions, with faults."""
        matched = self._transport.host_rate() in (0, self.device.baud)
        data = self._transport.read()
        self._switch_power(now)
        if data and not (self.faults.deaf or self.faults.silent):
            self.device.receive(self._disturb(data) if matched else self._garble(data), now)
        fresh = self.device.transmit(now)
        if not self._transport.connected or self.faults.silent:
            self._outbox.clear()
            return
        if fresh:
            fresh = self._disturb(fresh) if matched else self._garble(fresh)
            if not self._outbox:
                self._budget = 0.0  # time during which the line was idle is lost
            self._outbox += fresh
        self._send(now, elapsed)

    def _switch_power(self, now: float) -> None:
        """Give the device power while a client has the port open."""
        if self._powered is None or self._transport.host_open == self._power:
            return
        self._power = not self._power
        self._powered.set_power(self._power, now)
        self._outbox.clear()

    def _send(self, now: float, elapsed: float) -> None:
        """Send as many bytes as the line transmits in the elapsed time (s)."""
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
        """Drop, corrupt and duplicate bytes."""
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
        """Return what is received at a wrong baud rate."""
        return self._generator.bytes(max(len(data) // 2, 1))
