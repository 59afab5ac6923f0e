"""Content of the LMS-200's telegrams: scans, configuration, status byte.

Source: SICK, "Telegrams for Configuring and Operating the LMS 2xx".
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

MIRROR_PERIOD = 0.01332  # s per revolution, 75 Hz
VARIANTS = ((180, 100), (180, 50), (100, 100), (100, 50), (100, 25))  # field of view °, step 0.01°
CONFIGURATION_LENGTH = 34  # bytes of the block that 74 reads and 77 writes
_MODE, _UNIT = 5, 6  # its offsets of measuring mode and unit
CENTIMETRES, MILLIMETRES = 0, 1
# measuring mode -> bits of a distance; higher bits are flags of the monitored fields
VALUE_BITS = {0: 13, 1: 13, 2: 13, 3: 14, 4: 14, 5: 15, 6: 15, 0x0F: 15}
RANGE_BITS = {8: 13, 16: 14, 32: 15}  # maximum range (m) in mm -> bits of a distance
# values from 2^bits - 16 are codes; these are their last hexadecimal digits
NO_ECHO, DAZZLE, OVERFLOW, LOW_SIGNAL, CHANNEL_ERROR, BEYOND = 0xF, 0xE, 0xD, 0xB, 0xA, 0x7
_NO_RETURN = (NO_ECHO, BEYOND)


_SEVERITIES = ('no error', 'info', 'a warning', 'an error', 'a fatal error')


class StatusByte(NamedTuple):
    """Last data byte of every reply: severity 0 (fine) to 4 (fatal), dirty front screen."""

    severity: int
    polluted: bool

    @property
    def text(self) -> str:
        """The severity in the words of the manual."""
        return _SEVERITIES[min(self.severity, len(_SEVERITIES) - 1)]


def parse_status_byte(value: int) -> StatusByte:
    """Parse the status byte of a reply."""
    return StatusByte(value & 0b111, bool(value & 1 << 7))


@dataclass(frozen=True)
class ScannerConfiguration:
    """The configuration block of the scanner."""

    block: bytes

    @property
    def mode(self) -> int:
        """Measuring mode: number of bits of a distance and meaning of the others."""
        return self.block[_MODE]

    @property
    def unit(self) -> int:
        """Unit of distances: CENTIMETRES or MILLIMETRES."""
        return self.block[_UNIT]

    @property
    def value_bits(self) -> int:
        """Number of bits of a distance."""
        return VALUE_BITS.get(self.mode, 13)

    def changed(self, mode: int, unit: int) -> 'ScannerConfiguration':
        """Return the configuration with another measuring mode and unit."""
        block = bytearray(self.block)
        block[_MODE], block[_UNIT] = mode, unit
        return ScannerConfiguration(bytes(block))


def parse_configuration(data: bytes) -> ScannerConfiguration | None:
    """Parse the data of an F4 telegram; None where they are too short."""
    if len(data) < _UNIT + 1:
        return None
    return ScannerConfiguration(data[:CONFIGURATION_LENGTH])


class RawScan(NamedTuple):
    """A B0 telegram: values (N,) u16 from right to left with flag bits, unit, whether partial."""

    values: NDArray[np.uint16]
    unit: int
    partial: bool


def parse_scan(data: bytes) -> RawScan | None:
    """Parse the data of a B0 telegram; None where they are incomplete. Never raises."""
    if len(data) < 2:
        return None
    head = data[0] | data[1] << 8
    count, unit = head & 0x3FF, head >> 14
    if count == 0 or len(data) < 2 + 2 * count or unit > MILLIMETRES:
        return None
    values = np.frombuffer(data, '<u2', count, 2).astype(np.uint16)
    return RawScan(values, unit, bool(head & 1 << 13))


def scan_ranges(scan: RawScan, value_bits: int) -> NDArray[np.float32]:
    """Return ranges (N,) m as in REP-117: +inf no return, NaN invalid, -inf too close."""
    values = (scan.values & ((1 << value_bits) - 1)).astype(np.int64)
    ranges = values * (0.001 if scan.unit == MILLIMETRES else 0.01)
    codes = values - ((1 << value_bits) - 16)
    ranges[codes >= BEYOND] = np.nan
    ranges[np.isin(codes, _NO_RETURN)] = np.inf
    ranges[values == 0] = -np.inf
    return ranges.astype(np.float32)


def maximum_range(value_bits: int, unit: int) -> float:
    """Return the maximum distance (m) that a value can represent."""
    return float((1 << value_bits) - 16 + BEYOND - 1) * (0.001 if unit == MILLIMETRES else 0.01)
