"""The scanner side of the LMS-200's telegrams, with scans from any source.

Source: SICK, "Telegrams for Configuring and Operating the LMS 2xx".
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import LaserScan
from explore_slam.vehicle.lms200_scan import (
    BEYOND,
    CONFIGURATION_LENGTH,
    MILLIMETRES,
    MIRROR_PERIOD,
    NO_ECHO,
    OVERFLOW,
    VARIANTS,
    ScannerConfiguration,
)
from explore_slam.vehicle.lms200_telegrams import (
    ACK,
    BAUD_MODES,
    NAK,
    PASSWORD,
    Mode,
    Reply,
    Request,
    TelegramDecoder,
    encode_telegram,
)

_ACK_DELAY = 0.005  # s; the manual allows 60 ms
_REPLY_DELAY = 0.02  # s after the acknowledgement
_MODE_DELAY = 0.05  # s more for a change of mode; the manual allows 3 s
_WRITE_DELAY = 0.1  # s more for writing the EEPROM
BOOT_TIME = 0.5  # s; a real scanner takes 20 to 65 s
_STREAM_DELAY = 0.02  # s from the reply to the first scan
_TYPE = b'LMS200;S18063;V02.19 '
_STATUS_LENGTH = 152  # bytes of a status block
# offsets of its fields: operating mode, defect, serial number, variant, revolutions of the mirror,
# measuring mode, field of view, resolution, restart mode, baud rate, evaluation, number of the
# field set, unit, laser on, version of the boot software
_AT_MODE, _AT_SERIAL, _AT_REVOLUTIONS, _AT_MEASURING = 7, 9, 66, 101
_AT_ANGLE, _AT_RESOLUTION, _AT_RESTART, _AT_BAUD, _AT_EVALUATION = 106, 108, 110, 115, 117
_AT_FIELD_SET, _AT_UNIT, _AT_LASER_ON, _AT_BOOT_VERSION = 120, 121, 122, 123
_VERSION, _BOOT_VERSION, _SERIAL = b'V02.19 ', b'V02.02 ', b'05270497'
_BAUD_CODES = {9600: 0x8067, 19200: 0x8033, 38400: 0x8019, 500000: 0x8001}
_RESTART = _EVALUATION = 2
# bytes of a configuration that clients write: up to the unit (old drivers), as ARIA does, whole
_BLOCK_LENGTHS = range(7, CONFIGURATION_LENGTH + 1)
_FINE, _SEVERE = 0x10, 0x13  # status bytes
_ADDRESS = 0x80
_RATE_OF_MODE = {mode: rate for rate, mode in BAUD_MODES.items()}
# configuration as delivered: measuring mode 4 (14 bits of a distance), mm
_STOCK = bytes((0, 0, 0x70, 0, 0, 4, MILLIMETRES, 0, 0, 2, 2)) + bytes(21) + bytes((2, 0))


@dataclass
class ScannerFaults:
    """Faults of the scanner; may be changed at any time."""

    stalled: bool = False  # the mirror does not turn: no scans, but replies
    severe: bool = False  # the status byte reports an error
    polluted: bool = False  # the status byte reports a dirty front screen
    missed_requests: int = 0  # number of requests that get no reply


class Lms200Scanner:
    """An emulated LMS-200 (protocol SerialDevice).

    scan() returns what it sees, None while nothing is known. Scans are sent at whole revolutions
    of the mirror as fast as the line allows: every 213 ms at 38400 Bd and 0.5°, as by a real one.
    """

    def __init__(
        self,
        scan: Callable[[], LaserScan | None],
        *,
        baud: int = 9600,
        configuration: bytes = _STOCK,
        variant: tuple[int, int] = (180, 50),
        streaming: bool = False,
        mode_delay: float = _MODE_DELAY,
        boot_time: float = BOOT_TIME,
        answers_while_booting: bool = False,
    ) -> None:
        """Make a scanner that has booted.

        boot_time: s from power-on to the power-on telegram.
        answers_while_booting: it obeys requests before that telegram, and forgets what was set.
        """
        self.faults = ScannerFaults()
        self.configuration = ScannerConfiguration(configuration)
        self.baud = baud
        self.streaming = streaming
        self.variant = variant
        self.writes = 0  # EEPROM cycles
        self.scans = 0
        self._scan = scan
        self._installing = False
        self._mode_delay = mode_delay
        self._boot_time = boot_time
        self._answers_while_booting = answers_while_booting
        self._power = True
        self._booting: float | None = None  # s, when the power-on telegram is due
        self._revolutions_from = 0.0  # s, when the mirror began to turn
        self._decoder = TelegramDecoder(replies=False)
        self._replies: deque[tuple[float, bytes, int | None]] = deque()  # when, what, new rate
        self._next_scan = 0.0

    @property
    def booted(self) -> bool:
        """Whether it has power, and has sent its power-on telegram since."""
        return self._power and self._booting is None

    def reset(self, now: float) -> None:
        """Restart as after a loss of power: 9600 Bd, on request."""
        self._forget()
        self._booting = now + self._boot_time

    def set_power(self, on: bool, now: float) -> None:
        """Switch the supply on or off (protocol PoweredDevice); it boots when it comes."""
        self._power = on
        if on:
            self.reset(now)
        else:
            self._forget()

    def _forget(self) -> None:
        self.baud, self.streaming, self._installing = 9600, False, False
        self._replies.clear()
        self._decoder.clear()

    # -- the device -------------------------------------------------------------------------------

    def receive(self, data: bytes, now: float) -> None:
        """Receive bytes of the host."""
        if not (self.booted or (self._power and self._answers_while_booting)):
            return
        rejected = self._decoder.rejected
        for telegram in self._decoder.feed(data):
            if telegram.address != 0:
                continue
            if self.faults.missed_requests > 0:
                self.faults.missed_requests -= 1
                continue
            self._replies.append((now + _ACK_DELAY, ACK, None))
            self._handle(telegram.command, telegram.data, now + _ACK_DELAY + _REPLY_DELAY)
        if self._decoder.rejected > rejected:
            self._replies.append((now + _ACK_DELAY, NAK, None))

    def transmit(self, now: float) -> bytes:
        """Return the bytes that the scanner sends now."""
        data = bytearray()
        if not self._power:
            return b''
        if self._booting is not None and now >= self._booting:
            self._booting = None
            self._forget()
            self._revolutions_from = now
            self._reply(now, Reply.POWER_ON, _TYPE)
        while self._replies and self._replies[0][0] <= now:
            _, telegram, rate = self._replies.popleft()
            data += telegram
            if rate is not None:
                self.baud = rate
        if self.streaming and not self.faults.stalled and now >= self._next_scan:
            telegram = self._scan_telegram()
            data += telegram
            self._next_scan = self._after(telegram, now)
        return bytes(data)

    def _after(self, telegram: bytes, now: float) -> float:
        """Return when the next scan can be sent, a whole number of revolutions later."""
        revolutions = {100: 1, 50: 2, 25: 4}[self.variant[1]]
        period = revolutions * MIRROR_PERIOD
        periods = math.ceil(10.0 * len(telegram) / self.baud / period)
        behind = now - self._next_scan > 2.0 * periods * period
        return (now if behind else self._next_scan) + periods * period

    def _reply(
        self, when: float, command: int, data: bytes = b'', rate: int | None = None
    ) -> None:
        telegram = encode_telegram(command, data + bytes([self._status()]), _ADDRESS)
        self._replies.append((when, telegram, rate))

    def _status(self) -> int:
        return (_SEVERE if self.faults.severe else _FINE) | self.faults.polluted << 7

    def _status_block(self, now: float) -> bytes:
        """Return the data of a status reply, with the fields that clients read."""
        block = bytearray(_STATUS_LENGTH)

        def put(offset: int, data: bytes) -> None:
            block[offset : offset + len(data)] = data

        mode = Mode.STREAM if self.streaming else Mode.ON_REQUEST
        turns = int((now - self._revolutions_from) / MIRROR_PERIOD) & 0xFFFF
        put(0, _VERSION)
        put(_AT_MODE, bytes([Mode.INSTALLATION if self._installing else mode, self.faults.severe]))
        put(_AT_SERIAL, _SERIAL)
        put(_AT_REVOLUTIONS, turns.to_bytes(2, 'little'))
        put(_AT_MEASURING, bytes([self.configuration.mode]))
        put(_AT_ANGLE, self.variant[0].to_bytes(2, 'little'))
        put(_AT_RESOLUTION, self.variant[1].to_bytes(2, 'little'))
        put(_AT_RESTART, bytes([_RESTART]))
        put(_AT_BAUD, _BAUD_CODES[self.baud].to_bytes(2, 'little'))
        put(_AT_EVALUATION, bytes([_EVALUATION]))
        put(_AT_FIELD_SET, bytes([1]))
        put(_AT_UNIT, bytes([self.configuration.unit]))
        put(_AT_LASER_ON, bytes([1]))
        put(_AT_BOOT_VERSION, _BOOT_VERSION)
        return bytes(block)

    def _handle(self, command: int, data: bytes, when: float) -> None:
        if command == Request.MODE and data:
            self._change_mode(data, when + self._mode_delay)
        elif command == Request.TYPE:
            self._reply(when, Reply.TYPE, _TYPE)
        elif command == Request.STATUS:
            self._reply(when, Reply.STATUS, self._status_block(when))
        elif command == Request.VARIANT and len(data) >= 4:
            wanted = (int.from_bytes(data[:2], 'little'), int.from_bytes(data[2:4], 'little'))
            accepted = wanted in VARIANTS
            self.variant = wanted if accepted else self.variant
            self._reply(when + self._mode_delay, Reply.VARIANT, bytes([accepted]) + data[:4])
        elif command == Request.READ_CONFIGURATION:
            self._reply(when, Reply.CONFIGURATION, self.configuration.block)
        elif command == Request.WRITE_CONFIGURATION:
            accepted = self._installing and len(data) in _BLOCK_LENGTHS
            if accepted:  # a short block leaves the rest as it is
                rest = self.configuration.block[len(data) :]
                self.configuration = ScannerConfiguration(data + rest)
                self.writes += 1
            block = self.configuration.block if accepted else data
            self._reply(when + _WRITE_DELAY, Reply.WRITTEN, bytes([accepted]) + block)
        elif command == Request.SCAN:
            self._replies.append((when, self._scan_telegram(), None))
        elif command == Request.RESET:
            self.reset(when)
            self._reply(when, Reply.RESET)
        else:
            self._reply(when, Reply.UNKNOWN)

    def _change_mode(self, data: bytes, when: float) -> None:
        mode, accepted, rate = data[0], True, None
        if mode in (Mode.STREAM, Mode.ON_REQUEST):
            self.streaming = mode == Mode.STREAM
            self._installing = False
            self._next_scan = when + _STREAM_DELAY
        elif mode == Mode.INSTALLATION:
            accepted = data[1:] == PASSWORD
            self._installing = accepted
            self.streaming = self.streaming and not accepted
        elif mode in _RATE_OF_MODE:
            rate = _RATE_OF_MODE[Mode(mode)]
        else:
            accepted = False
        self._reply(when, Reply.MODE, bytes([not accepted]), rate)

    # -- scans ------------------------------------------------------------------------------------

    def _scan_telegram(self) -> bytes:
        self.scans += 1
        values = self._values(self._scan())
        head = len(values) | self.configuration.unit << 14
        return encode_telegram(
            Reply.SCAN,
            head.to_bytes(2, 'little') + values.astype('<u2').tobytes() + bytes([self._status()]),
            _ADDRESS,
        )

    def _values(self, scan: LaserScan | None) -> NDArray[np.int64]:
        """Return the values (N,) of this variant's beams from right to left."""
        angle, hundredths = self.variant
        count = 100 * angle // hundredths + 1
        base = (1 << self.configuration.value_bits) - 16
        if scan is None:
            return np.full(count, base + NO_ECHO)
        beams = np.radians(np.linspace(-0.5 * angle, 0.5 * angle, count))
        nearest = np.rint((beams - scan.angle_min) / scan.angle_increment).astype(int)
        inside = (nearest >= 0) & (nearest < len(scan.ranges))
        ranges = scan.ranges[np.clip(nearest, 0, len(scan.ranges) - 1)].astype(np.float64)
        scale = 1000.0 if self.configuration.unit == MILLIMETRES else 100.0
        known = np.where(np.isfinite(ranges), ranges, 0.0)
        values = np.rint(known * scale).astype(np.int64)
        values = np.where(values > base + BEYOND - 1, base + BEYOND, np.maximum(values, 1))
        values = np.where(np.isposinf(ranges) | ~inside, base + NO_ECHO, values)
        values = np.where(np.isnan(ranges), base + OVERFLOW, values)
        return np.where(np.isneginf(ranges), 1, values)
