"""The laser: a SICK LMS-200 on a serial line."""

import logging
import math
import time
from collections.abc import Callable

from explore_slam.data import LaserScan
from explore_slam.errors import VehicleError
from explore_slam.vehicle.arcos_packets import PacketDecoder
from explore_slam.vehicle.driver_config import LaserConfig
from explore_slam.vehicle.lms200_scan import (
    MILLIMETRES,
    RANGE_BITS,
    VALUE_BITS,
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
MIRROR_PERIOD = 0.01332  # s
RANGE_MIN = 0.01  # m
_WRITE_MODES = {13: 0, 14: 4, 15: 6}  # measuring mode to write for so many bits
_REPLY_TIMEOUT = 0.3  # s; ACK within 60 ms, the reply after it
_LONGEST_SCAN = 0.9  # s at 9600 Bd
_SLOW_TIMEOUT = 3.5  # s for changes of mode and configuration
_ATTEMPTS = 3
_FATAL = 3  # severity from which measurements are not to be trusted


class Lms200:
    """Sets the scanner up and reads its stream; one thread calls all of it.

    clock gives the stamps (s); silence is measured on the monotonic clock.
    """

    def __init__(self, config: LaserConfig, clock: Callable[[], float] = time.time) -> None:
        self.config = config
        self.device_type = ''
        self.status = StatusByte(0, False, False)
        self.configuration: ScannerConfiguration | None = None
        self.scans = 0
        self.unusable = 0  # scan telegrams that were partial, short or of another variant
        self.written = 0  # configurations written to the EEPROM
        self.heard = -math.inf  # monotonic time (s) of the last byte
        self._last_baud = config.laser_baud
        self._clock = clock
        self._port: SerialPort | None = None
        self._decoder = TelegramDecoder()
        self._scanned = 0.0

    @property
    def rejected(self) -> int:
        """Telegrams with a bad check sum or length so far."""
        return self._decoder.rejected

    # -- set-up -----------------------------------------------------------------------------------

    def connect(self) -> str:
        """Find the rate, set the scanner up, start the stream; return the scanner's type.

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
        self._scanned = self.heard = time.monotonic()
        return self.device_type

    def _find_scanner(self) -> None:
        """Bring the scanner to rest at whatever rate it runs."""
        port = self._port
        assert port is not None
        rates = [self._last_baud, self.config.laser_baud, 9600, 38400, 19200]
        heard = b''
        for rate in dict.fromkeys(rates):
            port.set_baud(rate)
            port.discard()
            self._decoder.clear()
            silent = True
            for attempt in range(_ATTEMPTS):
                port.write(encode_telegram(Request.MODE, bytes([Mode.ON_REQUEST])))
                came, found = self._listen(Reply.MODE, _REPLY_TIMEOUT)
                heard = (heard + came)[-4096:]
                if found is not None:
                    self._last_baud = rate
                    return
                silent = silent and not came
                if silent and attempt > 0:
                    break
            if port.is_network:
                break
        raise VehicleError(f'{port.url}: {_who_is_there(heard)}')

    def _listen(self, reply: int, timeout: float) -> tuple[bytes, Telegram | None]:
        """Return the bytes that came until this reply, and the reply, None without one."""
        assert self._port is not None
        end = time.monotonic() + timeout
        latest = end + _LONGEST_SCAN
        came = b''
        while (left := end - time.monotonic()) > 0.0:
            data = self._port.read(left)
            came += data
            if data:  # something is on the way: let it finish
                end = min(max(end, time.monotonic() + 0.5 * _REPLY_TIMEOUT), latest)
            for telegram in self._decoder.feed(data):
                if telegram.command == reply:
                    return came, telegram
        return came, None

    def _ask(
        self, request: int, data: bytes, reply: int, timeout: float = _REPLY_TIMEOUT
    ) -> Telegram:
        """Send a request until its reply comes; raises VehicleError when it does not."""
        assert self._port is not None
        for attempt in range(_ATTEMPTS):
            self._port.write(encode_telegram(request, data))
            timeout_now = timeout + self._port.transmission_time(200)
            _, telegram = self._listen(reply, timeout_now)
            if telegram is not None:
                self.status = parse_status_byte(telegram.status or 0)
                return telegram
            _log.debug('%s: request %02x unanswered (%d)', self._port.url, request, attempt + 1)
        raise VehicleError(
            f'{self._port.url}: the laser does not answer request {request:02X}; '
            'is its power steady and its cable good?'
        )

    def _mode(self, mode: int, data: bytes = b'', timeout: float = _SLOW_TIMEOUT) -> None:
        telegram = self._ask(Request.MODE, bytes([mode]) + data, Reply.MODE, timeout)
        if telegram.data[:1] != b'\0':
            raise VehicleError(
                f'{self.config.laser_port}: the laser refuses mode {mode:02X} '
                f'(answer {telegram.data.hex()}, expected 00)'
            )

    def _change_rate(self) -> None:
        port, rate = self._port, self.config.laser_baud
        assert port is not None
        if port.is_network or port.baud == rate:
            return
        if rate not in BAUD_MODES:
            raise VehicleError(f'laser_baud is {rate}, expected one of {sorted(BAUD_MODES)}')
        self._mode(BAUD_MODES[rate])
        port.set_baud(rate)
        self._last_baud = rate
        time.sleep(0.05)
        self._decoder.clear()

    def _set_variant(self) -> None:
        angle, hundredths = self.config.laser_angle, round(100 * self.config.laser_resolution)
        data = angle.to_bytes(2, 'little') + hundredths.to_bytes(2, 'little')
        answer = self._ask(Request.VARIANT, data, Reply.VARIANT, _SLOW_TIMEOUT).data
        if answer[:1] != b'\1':
            raise VehicleError(
                f'{self.config.laser_port}: the laser refuses {angle}° at {hundredths / 100}°, '
                'expected 100 or 180 at 1 or 0.5, or 100 at 0.25'
            )

    def _configure(self) -> None:
        """Read the configuration; write it only where it must change: EEPROMs wear out."""
        answer = self._ask(Request.READ_CONFIGURATION, b'', Reply.CONFIGURATION)
        present = parse_configuration(answer.data)
        if present is None:
            raise VehicleError(
                f'{self.config.laser_port}: configuration is {len(answer.data)} bytes'
            )
        bits = RANGE_BITS[self.config.laser_range]
        fits = present.mode in VALUE_BITS and present.value_bits >= bits
        self.configuration = present
        if present.unit == MILLIMETRES and fits:
            return
        mode = present.mode if fits else _WRITE_MODES[bits]
        wanted = present.changed(mode, MILLIMETRES)
        _log.info('%s: writing the configuration: mode %d, mm', self.config.laser_port, mode)
        self._mode(Mode.INSTALLATION, PASSWORD)
        answer = self._ask(Request.WRITE_CONFIGURATION, wanted.block, Reply.WRITTEN, _SLOW_TIMEOUT)
        self.written += 1
        self._mode(Mode.ON_REQUEST)
        if answer.data[:1] != b'\1':
            raise VehicleError(f'{self.config.laser_port}: the laser refuses its configuration')
        self.configuration = wanted

    def close(self) -> None:
        """End the stream and release the port; never raises."""
        if self._port is None:
            return
        try:
            self._port.write(encode_telegram(Request.MODE, bytes([Mode.ON_REQUEST])))
            time.sleep(self._port.transmission_time(8))
        except VehicleError:
            pass
        self._port.close()
        self._port = None

    # -- while it streams -------------------------------------------------------------------------

    def poll(self, timeout: float) -> list[LaserScan]:
        """Return the scans that came within timeout (s).

        Raises VehicleError when the line is lost or no valid scan came for scanner_timeout.
        """
        if self._port is None:
            raise VehicleError(f'{self.config.laser_port}: not connected')
        data = self._port.read(timeout)
        now = time.monotonic()
        if data:
            self.heard = now
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
        assert self._port is not None
        assert self.configuration is not None
        raw = parse_scan(telegram.data)
        beams = round(self.config.laser_angle / self.config.laser_resolution) + 1
        if raw is None or raw.partial or len(raw.values) != beams:
            return None
        if self.status.severity >= _FATAL:
            return None
        sent = self._port.transmission_time(len(telegram.data) + 8)
        # a simulated clock begins at 0
        stamp = max(self._clock() - sent - 0.5 * MIRROR_PERIOD, 0.0)
        return self.record(raw, stamp)

    def record(self, raw: RawScan, stamp: float) -> LaserScan:
        """Return a raw scan as a record with the angles of this set-up."""
        bits = self.configuration.value_bits if self.configuration else 13
        ranges = scan_ranges(raw, bits)
        if self.config.laser_inverted:
            ranges = ranges[::-1].copy()
        half = math.radians(0.5 * self.config.laser_angle)
        step = math.radians(self.config.laser_resolution)
        return LaserScan(stamp, -half, step, ranges, RANGE_MIN, maximum_range(bits, raw.unit))


def _who_is_there(heard: bytes) -> str:
    """Return why no scanner was found, from the bytes that came instead of its answers."""
    if PacketDecoder().feed(heard):
        return 'a Pioneer robot is at this port, not a laser; exchange base_port and laser_port'
    if heard:
        return f'{len(heard)} bytes came but no telegram of an LMS-200; another device?'
    return 'no answer from an LMS-200; is it switched on (it needs a minute) and plugged in?'
