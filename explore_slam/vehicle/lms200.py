"""Driver of a SICK LMS-200 laser scanner on a serial line.

Source of telegrams and times: SICK, "Telegrams for Configuring and Operating the LMS 2xx".
"""

import logging
import math
import time
from dataclasses import dataclass

from explore_slam.data import LaserScan
from explore_slam.errors import ConfigError, VehicleError
from explore_slam.settings import Section, setting
from explore_slam.vehicle.arcos_packets import PacketDecoder
from explore_slam.vehicle.devices import Clock, Statistics
from explore_slam.vehicle.driver_config import LaserConfig
from explore_slam.vehicle.lms200_scan import (
    CONFIGURATION_LENGTH,
    MILLIMETRES,
    MIRROR_PERIOD,
    RANGE_BITS,
    VALUE_BITS,
    VARIANTS,
    RawScan,
    ScannerConfiguration,
    StatusByte,
    maximum_range,
    parse_configuration,
    parse_scan,
    parse_status_byte,
    scan_ranges,
)
from explore_slam.vehicle.lms200_telegrams import (
    BAUD_MODES,
    PASSWORD,
    Mode,
    Reply,
    Request,
    Telegram,
    TelegramDecoder,
    encode_telegram,
)
from explore_slam.vehicle.serial_port import SerialPort

_log = logging.getLogger(__name__)
RANGE_MIN = 0.01  # m, minimum range in a scan
DEFAULT_BITS = 13  # bits of a distance until the configuration is read (8 m in mm)
_WRITE_MODES = {13: 0, 14: 4, 15: 6}  # bits of a distance -> measuring mode to write
_RATES = (9600, 38400, 19200)  # Bd, tried in this order: power-on, usual, other
_REPLY_TIMEOUT = 0.3  # s; the acknowledgement comes within 60 ms, the reply after it
_LONGEST_SCAN = 0.9  # s, 812 bytes at 9600 Bd
_SLOW_TIMEOUT = 3.5  # s; changes of mode and configuration take up to 3 s
_RATE_CHANGE_TIME = 0.05  # s after the reply until the scanner listens at the new rate
_ATTEMPTS = 3  # requests may be missed while a scan is sent
_LONGEST_REPLY = 200  # bytes of a reply beside scans
_REQUEST_BYTES = 8  # telegram of a change of mode
_FRAME_BYTES = 8  # bytes of a telegram beside its data
_FATAL = 3  # severity (0-4) from which measurements are invalid
_KEPT = 4096  # bytes kept for the diagnosis of a wrong device


@dataclass(frozen=True)
class Lms200Config(Section):
    """Settings of an LMS-200 beside those of any laser."""

    laser_baud: int = setting(
        38400, 'Baud rate of the scans (500000 requires RS-422)', unit='Bd', low=9600, high=500000
    )
    laser_angle: int = setting(180, 'Field of view: 100 or 180', unit='°', low=100, high=180)
    laser_resolution: float = setting(
        0.5, 'Angle between beams: 1, 0.5, or 0.25 with 100°', unit='°', low=0.25, high=1.0
    )
    laser_range: int = setting(8, 'Maximum range: 8, 16 or 32', unit='m', low=8, high=32)

    def __post_init__(self) -> None:
        super().__post_init__()
        variant = (self.laser_angle, self.laser_resolution)
        known = [(angle, hundredths / 100) for angle, hundredths in VARIANTS]
        if variant not in known:
            raise ConfigError(
                f'laser_angle and laser_resolution are {variant}, expected one of {known}'
            )
        if self.laser_range not in RANGE_BITS:
            raise ConfigError(
                f'laser_range is {self.laser_range}, expected one of {sorted(RANGE_BITS)}'
            )
        if self.laser_baud not in BAUD_MODES:
            raise ConfigError(
                f'laser_baud is {self.laser_baud}, expected one of {sorted(BAUD_MODES)}'
            )


class Lms200:
    """An LMS-200 (protocol Laser): configures the scanner and reads its stream of scans.

    clock gives the stamps (s); silence is measured with the monotonic clock.
    """

    def __init__(
        self,
        config: LaserConfig,
        own: Lms200Config | None = None,
        clock: Clock = time.time,
    ) -> None:
        self.config = config
        self.own = own or Lms200Config()
        self.device_type = ''
        self.status = StatusByte(0, False)
        self.configuration: ScannerConfiguration | None = None
        self.scans = 0
        self.unusable = 0  # scans that were partial, of another variant, or marked as invalid
        self.written = 0  # configurations written to the EEPROM
        self.last_received = -math.inf  # monotonic time (s) of the last byte
        self._last_baud = self.own.laser_baud
        self._clock = clock
        self._port: SerialPort | None = None
        self._decoder = TelegramDecoder()
        self._scanned = 0.0

    @property
    def rejected(self) -> int:
        """Number of telegrams with a wrong CRC or length."""
        return self._decoder.rejected

    # -- setup ------------------------------------------------------------------------------------

    def connect(self) -> str:
        """Find the baud rate, configure the scanner, start the stream; return its type.

        Raises VehicleError that says what is wrong and what to do.
        """
        self.close()
        self._port = SerialPort(self.config.laser_port, self._last_baud)
        try:
            self._find_scanner()
            self._change_rate()
            kind = self._ask(Request.TYPE, b'', Reply.TYPE)
            self.device_type = kind.data.decode('ascii', 'replace').strip()
            self._set_variant()
            self._configure()
            self._ask(Request.MODE, bytes([Mode.STREAM]), Reply.MODE, _SLOW_TIMEOUT)
        except VehicleError:
            self.close()
            raise
        self._scanned = self.last_received = time.monotonic()
        return self.device_type

    def _find_scanner(self) -> None:
        """Find the scanner's baud rate and stop its stream."""
        port = self._port
        assert port is not None
        rates = [self._last_baud, self.own.laser_baud, *_RATES]
        collected = b''
        for rate in dict.fromkeys(rates):
            port.set_baud(rate)
            port.discard()
            self._decoder.clear()
            silent = True
            for attempt in range(_ATTEMPTS):
                port.write(encode_telegram(Request.MODE, bytes([Mode.ON_REQUEST])))
                received, found = self._listen(Reply.MODE, _REPLY_TIMEOUT)
                collected = (collected + received)[-_KEPT:]
                if found is not None:
                    self._last_baud = rate
                    return
                silent = silent and not received
                if silent and attempt > 0:
                    break
            if port.is_network:
                break
        raise VehicleError(f'{port.url}: {_diagnose_port(collected)}')

    def _listen(self, reply: int, timeout: float) -> tuple[bytes, Telegram | None]:
        """Return the bytes received until this reply, and the reply (None without one)."""
        assert self._port is not None
        end = time.monotonic() + timeout
        latest = end + _LONGEST_SCAN
        received = b''
        while (left := end - time.monotonic()) > 0.0:
            data = self._port.read(left)
            received += data
            if data:  # wait for the rest of what is being sent
                end = min(max(end, time.monotonic() + 0.5 * _REPLY_TIMEOUT), latest)
            for telegram in self._decoder.feed(data):
                if telegram.command == reply:
                    return received, telegram
        return received, None

    def _ask(
        self, request: int, data: bytes, reply: int, timeout: float = _REPLY_TIMEOUT
    ) -> Telegram:
        """Repeat a request until its reply comes; raises VehicleError without one."""
        assert self._port is not None
        for attempt in range(_ATTEMPTS):
            self._port.write(encode_telegram(request, data))
            timeout_now = timeout + self._port.transmission_time(_LONGEST_REPLY)
            _, telegram = self._listen(reply, timeout_now)
            if telegram is not None:
                self.status = parse_status_byte(telegram.status or 0)
                return telegram
            _log.debug(
                '%s: no reply to request %02x (attempt %d)', self._port.url, request, attempt + 1
            )
        raise VehicleError(
            f'{self._port.url}: the laser does not reply to request {request:02X}; '
            'is its power steady and its cable good?'
        )

    def _change_mode(self, mode: int, data: bytes = b'', timeout: float = _SLOW_TIMEOUT) -> None:
        """Change the operating mode; raises VehicleError where the scanner refuses."""
        telegram = self._ask(Request.MODE, bytes([mode]) + data, Reply.MODE, timeout)
        if telegram.data[:1] != b'\0':
            raise VehicleError(
                f'{self.config.laser_port}: the laser refuses mode {mode:02X} '
                f'(reply {telegram.data.hex()}, expected 00)'
            )

    def _change_rate(self) -> None:
        """Change to the configured baud rate."""
        port, rate = self._port, self.own.laser_baud
        assert port is not None
        if port.is_network or port.baud == rate:
            return
        self._change_mode(BAUD_MODES[rate])
        port.set_baud(rate)
        self._last_baud = rate
        time.sleep(_RATE_CHANGE_TIME)
        self._decoder.clear()

    def _set_variant(self) -> None:
        """Set field of view and angular resolution."""
        angle, hundredths = self.own.laser_angle, round(100 * self.own.laser_resolution)
        data = angle.to_bytes(2, 'little') + hundredths.to_bytes(2, 'little')
        answer = self._ask(Request.VARIANT, data, Reply.VARIANT, _SLOW_TIMEOUT).data
        if answer[:1] != b'\1':
            raise VehicleError(
                f'{self.config.laser_port}: the laser refuses {angle}° at {hundredths / 100}°, '
                'expected 100 or 180 at 1 or 0.5, or 100 at 0.25'
            )

    def _configure(self) -> None:
        """Read the configuration; write it only if it must change, since EEPROMs wear out."""
        answer = self._ask(Request.READ_CONFIGURATION, b'', Reply.CONFIGURATION)
        present = parse_configuration(answer.data)
        if present is None:
            raise VehicleError(
                f'{self.config.laser_port}: the configuration has {len(answer.data)} bytes, '
                f'expected {CONFIGURATION_LENGTH}'
            )
        bits = RANGE_BITS[self.own.laser_range]
        fits = present.mode in VALUE_BITS and present.value_bits >= bits
        self.configuration = present
        if present.unit == MILLIMETRES and fits:
            return
        mode = present.mode if fits else _WRITE_MODES[bits]
        wanted = present.changed(mode, MILLIMETRES)
        _log.info('%s: writing the configuration: mode %d, mm', self.config.laser_port, mode)
        self._change_mode(Mode.INSTALLATION, PASSWORD)
        answer = self._ask(Request.WRITE_CONFIGURATION, wanted.block, Reply.WRITTEN, _SLOW_TIMEOUT)
        self.written += 1
        self._change_mode(Mode.ON_REQUEST)
        if answer.data[:1] != b'\1':
            raise VehicleError(f'{self.config.laser_port}: the laser refuses its configuration')
        self.configuration = wanted

    def close(self) -> None:
        """Stop the stream and release the port; never raises."""
        if self._port is None:
            return
        try:
            self._port.write(encode_telegram(Request.MODE, bytes([Mode.ON_REQUEST])))
            time.sleep(self._port.transmission_time(_REQUEST_BYTES))
        except VehicleError:
            pass
        self._port.close()
        self._port = None

    # -- stream -----------------------------------------------------------------------------------

    def poll(self, timeout: float) -> list[LaserScan]:
        """Return the scans received within timeout (s).

        Raises VehicleError when the line is lost or no valid scan came for scanner_timeout.
        """
        if self._port is None:
            raise VehicleError(f'{self.config.laser_port}: not connected')
        data = self._port.read(timeout)
        now = time.monotonic()
        if data:
            self.last_received = now
        scans = []
        for telegram in self._decoder.feed(data):
            if telegram.command == Reply.POWER_ON:
                raise VehicleError(f'{self.config.laser_port}: the laser was switched off and on')
            if telegram.command != Reply.SCAN:
                continue
            self.status = parse_status_byte(telegram.status or 0)
            scan = self._scan(telegram)
            if scan is None:
                self.unusable += 1
            else:
                scans.append(scan)
        if scans:
            self._scanned = now
            self.scans += len(scans)
        elif now - self._scanned > self.config.scanner_timeout:
            raise VehicleError(
                f'{self.config.laser_port}: no valid scan for {now - self._scanned:.1f} s; '
                'is the laser switched on and its cable plugged in?'
            )
        return scans

    def _scan(self, telegram: Telegram) -> LaserScan | None:
        """Return the scan of a telegram, None where it is not usable.

        Its stamp is the middle of the revolution that ended when the telegram began.
        """
        assert self._port is not None
        assert self.configuration is not None
        raw = parse_scan(telegram.data)
        beams = round(self.own.laser_angle / self.own.laser_resolution) + 1
        if raw is None or raw.partial or len(raw.values) != beams:
            return None
        if self.status.severity >= _FATAL:
            return None
        sent = self._port.transmission_time(len(telegram.data) + _FRAME_BYTES)
        # not negative: a simulated clock starts at 0
        stamp = max(self._clock() - sent - 0.5 * MIRROR_PERIOD, 0.0)
        return self.record(raw, stamp)

    def record(self, raw: RawScan, stamp: float) -> LaserScan:
        """Convert a raw scan into a record, with angles and ranges of this configuration."""
        bits = self.configuration.value_bits if self.configuration else DEFAULT_BITS
        ranges = scan_ranges(raw, bits)
        if self.config.laser_inverted:
            ranges = ranges[::-1].copy()
        half = math.radians(0.5 * self.own.laser_angle)
        step = math.radians(self.own.laser_resolution)
        return LaserScan(stamp, -half, step, ranges, RANGE_MIN, maximum_range(bits, raw.unit))

    def statistics(self) -> Statistics:
        """Return counters and the last status for diagnostics."""
        return {
            'scans': self.scans,
            'rejected': self.rejected,
            'unusable': self.unusable,
            'severity': self.status.severity,
            'polluted': self.status.polluted,
        }


def _diagnose_port(collected: bytes) -> str:
    """Explain why no scanner was found, from the bytes received instead of its replies."""
    if PacketDecoder().feed(collected):
        return 'a Pioneer robot is at this port, not a laser; swap base_port and laser_port'
    if collected:
        return (
            f'{len(collected)} bytes received but no telegram of an LMS-200; is it another device?'
        )
    return 'no reply from an LMS-200; is it switched on (it takes a minute) and plugged in?'
