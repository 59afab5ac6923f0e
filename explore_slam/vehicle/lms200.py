"""Driver of a SICK LMS-200 laser scanner on a serial line.

Source of telegrams and times: SICK, "Telegrams for Configuring and Operating the LMS 2xx".
"""

import contextlib
import logging
import math
import time
from dataclasses import dataclass

from explore_slam.data import LaserScan
from explore_slam.errors import ConfigError, VehicleError
from explore_slam.settings import Section, setting
from explore_slam.vehicle.arcos_packets import BAUD_CODES, PacketDecoder, encode_command
from explore_slam.vehicle.devices import Clock, Progress, Statistics
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
from explore_slam.vehicle.serial_port import LASER_TCP_PORT, BaudRateError, SerialPort

_log = logging.getLogger(__name__)
RANGE_MIN = 0.01  # m, minimum range in a scan
DEFAULT_BITS = 13  # bits of a distance until the configuration is read (8 m in mm)
_WRITE_MODES = {13: 0, 14: 4, 15: 6}  # bits of a distance -> measuring mode to write
_POWER_ON_RATE = 9600  # Bd, of the power-on telegram
_RATES = (_POWER_ON_RATE, 38400, 500000, 19200)  # Bd, tried in this order: all that it has
_REPLY_TIMEOUT = 0.3  # s; the acknowledgement comes within 60 ms, the reply after it
_LONGEST_SCAN = 0.9  # s, 812 bytes at 9600 Bd
_SLOW_TIMEOUT = 3.5  # s; changes of mode and configuration take up to 3 s
_RATE_CHANGE_TIME = 0.05  # s after the reply until the scanner listens at the new rate
_ATTEMPTS = 3  # requests may be missed while a scan is sent
_LONGEST_REPLY = 200  # bytes of a reply beside scans
_REQUEST_BYTES = 8  # telegram of a change of mode
_FRAME_BYTES = 8  # bytes of a telegram beside its data
_FATAL = 3  # severity (0-4) from which measurements are invalid
_NOISE = 2048  # bytes without a telegram, longer than two scans: of another baud rate
_KEPT = 4096  # bytes kept for the diagnosis of a wrong device
_ROBOT_TIMEOUT = 0.25  # s for the reply of a robot at this port
_UNSTEADY = 3  # power-on telegrams in one connection that are more than those of a start
_ALL_RATES_EVERY = 4  # rounds of searching, in between only the rate of a laser that has booted
_BOOT_LISTENING = 2.0  # s between attempts to reach a laser that may be booting
_SUPPLY = 'is its supply (24 V) steady, and the battery charged?'
_LONGEST_READ = 0.2  # s after which an interruption is noticed


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


class _NotReadyError(VehicleError):
    """The scanner does not answer yet; restarted: it has just booted, so that it will."""

    def __init__(self, text: str, restarted: bool = False) -> None:
        super().__init__(text)
        self.restarted = restarted


class _RefusedError(VehicleError):
    """The scanner answers, but refuses what it is asked for."""


class Lms200:
    """An LMS-200 (protocols Laser and SlowDevice): configures it and reads its stream of scans.

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
        self._faulty = 0  # unusable scans since the last valid one
        self._telegrams = 0  # decoded while listening for a reply
        self._tried_for_robot = False
        # in this connection: rounds of searching for the scanner, rates tried, rates that the
        # adapter lacks, power-on telegrams
        self._rounds = 0
        self._tried: list[int] = []
        self._refused: list[int] = []
        self._restarts = 0
        self.progress = Progress()

    @property
    def rejected(self) -> int:
        """Number of telegrams with a wrong CRC or length."""
        return self._decoder.rejected

    # -- setup ------------------------------------------------------------------------------------

    def connect(self) -> str:
        """Find the baud rate, configure the scanner, start the stream; return its type.

        The port stays open while the scanner does not answer, up to laser_startup_timeout: where
        the port switches its power, closing the port would restart it. It boots for 20 to 65 s,
        ends that with a power-on telegram, and is also found if that telegram was lost.
        Raises VehicleError that says what is wrong and what to do; the port is released then,
        unless the scanner answers but refuses a setting: it may still be booting.
        """
        if self._port is None:
            self._port = SerialPort(
                self.config.laser_port, self._last_baud, tcp_port=LASER_TCP_PORT
            )
        self._tried_for_robot = False
        self._rounds = self._restarts = 0
        self._tried, self._refused = [], []
        began = time.monotonic()
        try:
            while True:
                try:
                    return self._set_up()
                except _NotReadyError as error:
                    self._await_power_on(began, error)
        except _RefusedError:
            raise
        except VehicleError:
            self._release()
            raise

    def _set_up(self) -> str:
        """Carry out all steps of the connection; _NotReadyError where they may be repeated."""
        assert self._port is not None
        self._find_scanner()
        found = self._port.baud
        self._change_rate()
        kind = self._ask(Request.TYPE, b'', Reply.TYPE)
        self.device_type = kind.data.decode('ascii', 'replace').strip()
        self._set_variant()
        self._configure()
        self._ask(Request.MODE, bytes([Mode.STREAM]), Reply.MODE, _SLOW_TIMEOUT)
        self._scanned = self.last_received = time.monotonic()
        self._faulty = 0
        if self._port.is_network or found == self._port.baud:
            return self.device_type
        return f'{self.device_type} (found at {found} Bd, now at {self._port.baud} Bd)'

    def _await_power_on(self, began: float, cause: '_NotReadyError') -> None:
        """Listen for the power-on telegram for a while; VehicleError when the time is over."""
        port = self._port
        assert port is not None
        limit, waited = self.config.laser_startup_timeout, time.monotonic() - began
        text, unsteady = str(cause), self._restarts >= _UNSTEADY
        if unsteady:
            text = f'{port.url}: the laser has restarted {self._restarts} times; {_SUPPLY}'
        if waited >= limit:
            raise VehicleError(f'{text} (waited {waited:.0f} s: laser_startup_timeout)')
        if cause.restarted:  # it is ready now
            if unsteady:
                self.progress.tell(text)
            return
        self.progress.tell(
            f'{text}; the port stays open for a laser that boots now (20 to 65 s): '
            f'{waited:.0f} of {limit:.0f} s'
        )
        if not port.is_network:
            port.set_baud(_POWER_ON_RATE)
        with contextlib.suppress(_NotReadyError):  # it says that it has restarted
            self._listen(Reply.POWER_ON, min(_BOOT_LISTENING, limit - waited))

    def _rates(self) -> list[int]:
        """Return the baud rates to try, the likely ones first."""
        assert self._port is not None
        if self._port.is_network:
            return [self._port.baud]
        if self._rounds % _ALL_RATES_EVERY:  # a laser that boots will be at this one
            return [_POWER_ON_RATE]
        rates = (self._last_baud, self.own.laser_baud, *_RATES)
        return list(dict.fromkeys(rates))

    def _find_scanner(self) -> None:
        """Find the scanner's baud rate and stop its stream."""
        port = self._port
        assert port is not None
        collected = b''
        for rate in self._rates():
            try:
                port.set_baud(rate)
            except BaudRateError:
                _add_new(self._refused, rate)
                continue
            _add_new(self._tried, rate)
            port.discard()
            self._decoder.clear()
            silent = True
            for attempt in range(_ATTEMPTS):
                port.write(encode_telegram(Request.MODE, bytes([Mode.ON_REQUEST])))
                decoded = self._telegrams
                received, found = self._listen(Reply.MODE, _REPLY_TIMEOUT)
                collected = (collected + received)[-_KEPT:]
                if found is not None:
                    if rate != self.own.laser_baud and not port.is_network:
                        _log.info('%s: laser found at %d Bd', port.url, rate)
                    self._last_baud = rate
                    return
                silent = silent and not received
                if (silent and attempt > 0) or (
                    len(received) > _NOISE and self._telegrams == decoded
                ):  # another baud rate
                    break
            if not self._tried_for_robot and rate in BAUD_CODES:
                collected = (collected + self._ask_for_robot())[-_KEPT:]
            self._refuse_robot(collected)
        if not self._tried_for_robot:
            self._look_for_fast_robot()
        self._tried_for_robot = True
        self._rounds += 1
        text = _diagnose_port(collected, self._tried, self._refused)
        raise _NotReadyError(f'{port.url}: {text}')

    def _look_for_fast_robot(self) -> None:
        """Raise VehicleError where a robot is at this port, at a rate that no laser has."""
        assert self._port is not None
        if self._port.is_network:
            return
        for rate in (rate for rate in BAUD_CODES if rate not in BAUD_MODES):
            with contextlib.suppress(BaudRateError):
                self._port.set_baud(rate)
                self._port.discard()
                self._decoder.clear()
                self._refuse_robot(self._ask_for_robot())

    def _refuse_robot(self, collected: bytes) -> None:
        """Raise VehicleError if a packet of a robot is among the bytes received."""
        assert self._port is not None
        if PacketDecoder().feed(collected):
            raise VehicleError(
                f'{self._port.url}: a Pioneer robot is at this port, not an LMS-200; swap '
                'base_port and laser_port'
            )

    def _ask_for_robot(self) -> bytes:
        """Return what a Pioneer at this port, which a laser's requests leave silent, replies."""
        assert self._port is not None
        self._port.write(encode_command(0))
        received, _ = self._listen(Reply.MODE, _ROBOT_TIMEOUT)
        return received

    def _listen(self, reply: int, timeout: float) -> tuple[bytes, Telegram | None]:
        """Return the bytes received until this reply, and the reply (None without one).

        _NotReadyError when the scanner has restarted; VehicleError when interrupted.
        """
        assert self._port is not None
        end = time.monotonic() + timeout
        latest = end + _LONGEST_SCAN
        received, decoded = b'', self._telegrams
        while (left := end - time.monotonic()) > 0.0:
            if len(received) > _NOISE and self._telegrams == decoded:
                break
            if self.progress.interrupted.is_set():
                raise VehicleError(f'{self._port.url}: interrupted')
            data = self._port.read(min(left, _LONGEST_READ))
            received += data
            if data:  # wait for the rest of what is being sent
                end = min(max(end, time.monotonic() + 0.5 * _REPLY_TIMEOUT), latest)
            for telegram in self._decoder.feed(data):
                self._telegrams += 1
                if telegram.command == Reply.POWER_ON:
                    self._last_baud = self._port.baud
                    self._restarts += 1
                    raise _NotReadyError(
                        f'{self._port.url}: the laser has restarted', restarted=True
                    )
                if telegram.command == reply:
                    return received, telegram
        return received, None

    def _ask(
        self, request: int, data: bytes, reply: int, timeout: float = _REPLY_TIMEOUT
    ) -> Telegram:
        """Repeat a request until its reply comes; _NotReadyError without one."""
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
        raise _NotReadyError(
            f'{self._port.url}: the laser does not reply to request {request:02X}; '
            'is its power steady and its cable good?'
        )

    def _change_mode(self, mode: int, data: bytes = b'', timeout: float = _SLOW_TIMEOUT) -> None:
        """Change the operating mode; raises VehicleError where the scanner refuses."""
        telegram = self._ask(Request.MODE, bytes([mode]) + data, Reply.MODE, timeout)
        if telegram.data[:1] != b'\0':
            raise _RefusedError(
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
            raise _RefusedError(
                f'{self.config.laser_port}: the laser refuses {angle}° at {hundredths / 100}°, '
                'expected 100 or 180 at 1 or 0.5, or 100 at 0.25'
            )

    def _configure(self) -> None:
        """Read the configuration; write it only if it must change, since EEPROMs wear out."""
        answer = self._ask(Request.READ_CONFIGURATION, b'', Reply.CONFIGURATION)
        present = parse_configuration(answer.data)
        if present is None:
            raise _RefusedError(
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
            raise _RefusedError(f'{self.config.laser_port}: the laser refuses its configuration')
        self.configuration = wanted

    def suspend(self) -> None:
        """Give up the stream, but keep the port open: closing it may cut the laser's power."""

    def close(self) -> None:
        """Stop the stream and release the port; never raises."""
        if self._port is None:
            return
        try:
            self._port.write(encode_telegram(Request.MODE, bytes([Mode.ON_REQUEST])))
            time.sleep(self._port.transmission_time(_REQUEST_BYTES))
        except VehicleError:
            pass
        self._release()

    def _release(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None

    # -- stream -----------------------------------------------------------------------------------

    def poll(self, timeout: float) -> list[LaserScan]:
        """Return the scans received within timeout (s).

        Raises VehicleError when the line is lost or no valid scan came for scanner_timeout.
        """
        if self._port is None:
            raise VehicleError(f'{self.config.laser_port}: not connected')
        try:
            data = self._port.read(timeout)
        except VehicleError:
            self._release()
            raise
        now = time.monotonic()
        if data:
            self.last_received = now
        scans = []
        for telegram in self._decoder.feed(data):
            if telegram.command == Reply.POWER_ON:
                self._last_baud = self._port.baud
                raise VehicleError(f'{self.config.laser_port}: the laser was switched off and on')
            if telegram.command != Reply.SCAN:
                continue
            self.status = parse_status_byte(telegram.status or 0)
            scan = self._scan(telegram)
            if scan is None:
                self.unusable += 1
                self._faulty += 1
            else:
                scans.append(scan)
        if scans:
            self._scanned = now
            self._faulty = 0
            self.scans += len(scans)
        elif now - self._scanned > self.config.scanner_timeout:
            raise VehicleError(
                f'{self.config.laser_port}: no valid scan for {now - self._scanned:.1f} s; '
                f'{self._explain_silence(now)}'
            )
        return scans

    def _explain_silence(self, now: float) -> str:
        """Explain why no valid scan comes, from what comes instead."""
        dirty = '; its front screen is dirty: clean it' if self.status.polluted else ''
        if self._faulty and self.status.severity >= _FATAL:
            return (
                f'the laser reports {self.status.text} (severity {self.status.severity}) and '
                f'marks its scans as invalid{dirty}; check its supply (24 V), or switch it off '
                'and on'
            )
        if self._faulty:
            return (
                f'{self._faulty} scans came that are partial or of another field of view or '
                f'resolution{dirty}; does another program configure the laser?'
            )
        if now - self.last_received < self.config.scanner_timeout:
            return f'bytes come, but no telegram of a scan{dirty}; is the cable good?'
        return f'is the laser switched on and its cable plugged in?{dirty}'

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


def _add_new(rates: list[int], rate: int) -> None:
    """Append a rate that is not in the list yet."""
    if rate not in rates:
        rates.append(rate)


def _diagnose_port(collected: bytes, rates: list[int], refused: list[int]) -> str:
    """Explain why no scanner was found, from the bytes received instead of its replies.

    rates: those tried. refused: those that the adapter of the port lacks.
    """
    tried = '/'.join(str(rate) for rate in rates)
    lacking = ''.join(f'; this port cannot be set to {rate} Bd' for rate in refused)
    if collected:
        return (
            f'{len(collected)} bytes received at {tried} Bd, but no telegram of an LMS-200; '
            f'is it another device, or still booting?{lacking}'
        )
    return f'no reply from an LMS-200 at {tried} Bd; is it switched on and plugged in?{lacking}'
