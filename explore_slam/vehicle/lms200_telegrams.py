"""SICK LMS-200 framing: encoding of telegrams and an incremental decoder.

A telegram is 02, address, length (u16 LE, of command and data), command, data, CRC (u16 LE).
Replies have bit 7 of the address set; their data end with a status byte. Source: SICK, "Telegrams
for Configuring and Operating the LMS 2xx".
"""

from enum import IntEnum
from typing import NamedTuple

START = 0x02
ACK, NAK = b'\x06', b'\x15'
LONGEST = 1024  # bytes of command and data; the longest scan (0.25°) has 806
_POLYNOMIAL = 0x8005  # of the CRC
_REPLY = 0x80  # bit of the address in replies


class Request(IntEnum):
    """Command bytes of the host."""

    RESET = 0x10
    MODE = 0x20
    SCAN = 0x30
    STATUS = 0x31
    TYPE = 0x3A
    VARIANT = 0x3B
    READ_CONFIGURATION = 0x74
    WRITE_CONFIGURATION = 0x77


class Mode(IntEnum):
    """First data byte of Request.MODE."""

    INSTALLATION = 0x00
    STREAM = 0x24
    ON_REQUEST = 0x25
    BAUD_38400 = 0x40
    BAUD_19200 = 0x41
    BAUD_9600 = 0x42
    BAUD_500000 = 0x48


class Reply(IntEnum):
    """Command bytes of the scanner."""

    POWER_ON = 0x90
    RESET = 0x91
    UNKNOWN = 0x92
    MODE = 0xA0
    SCAN = 0xB0
    STATUS = 0xB1
    TYPE = 0xBA
    VARIANT = 0xBB
    CONFIGURATION = 0xF4
    WRITTEN = 0xF7


BAUD_MODES = {
    9600: Mode.BAUD_9600,
    19200: Mode.BAUD_19200,
    38400: Mode.BAUD_38400,
    500000: Mode.BAUD_500000,
}
PASSWORD = b'SICK_LMS'  # of the installation mode, as delivered


class Telegram(NamedTuple):
    """A telegram; status: its last data byte, None in telegrams of the host."""

    address: int
    command: int
    data: bytes
    status: int | None


def _make_table() -> tuple[list[int], list[int]]:
    """Return the contributions of the high and the low byte to the CRC shifted by one bit."""
    shift, carry = [], []
    for value in range(256):
        word = value << 8
        doubled = word << 1
        shift.append((doubled ^ _POLYNOMIAL) & 0xFFFF if word & 0x8000 else doubled & 0xFFFF)
        carry.append(value << 1)
    return shift, carry


_SHIFT, _CARRY = _make_table()


def crc(data: bytes) -> int:
    """Return the CRC of a telegram's bytes from the start byte on.

    Per byte the value is shifted left by one bit, reduced by the polynomial, and XORed with the
    byte and its predecessor.
    """
    value, previous = 0, 0
    for byte in data:
        value = _SHIFT[value >> 8] ^ _CARRY[value & 0xFF] ^ (previous << 8 | byte)
        previous = byte
    return value


def encode_telegram(command: int, data: bytes = b'', address: int = 0) -> bytes:
    """Return the bytes of a telegram; address 0 is broadcast."""
    body = bytes([START, address]) + (1 + len(data)).to_bytes(2, 'little')
    body += bytes([command]) + data
    return body + crc(body).to_bytes(2, 'little')


class TelegramDecoder:
    """Incremental decoder that resynchronizes after garbage; buffers at most one telegram.

    replies: decode telegrams of the scanner (with status byte), else those of the host.
    """

    def __init__(self, replies: bool = True) -> None:
        self._replies = replies
        self._buffer = bytearray()
        self.rejected = 0  # starts followed by a wrong length or CRC

    @property
    def pending(self) -> int:
        """Number of buffered bytes of an incomplete telegram."""
        return len(self._buffer)

    def clear(self) -> None:
        """Discard an incomplete telegram."""
        self._buffer.clear()

    def feed(self, data: bytes) -> list[Telegram]:
        """Add received bytes; return the telegrams that are now complete."""
        buffer = self._buffer
        buffer += data
        telegrams: list[Telegram] = []
        start = 0
        while True:
            found = buffer.find(START, start)
            start = len(buffer) if found < 0 else found
            if len(buffer) < start + 2:
                break
            if bool(buffer[start + 1] & _REPLY) != self._replies:
                start += 1
                continue
            if len(buffer) < start + 4:
                break
            length = buffer[start + 2] | buffer[start + 3] << 8
            if not 1 + self._replies <= length <= LONGEST:
                self.rejected += 1
                start += 1
                continue
            end = start + 4 + length
            if len(buffer) < end + 2:
                break
            frame = bytes(buffer[start:end])
            if crc(frame) == buffer[end] | buffer[end + 1] << 8:
                telegrams.append(self._telegram(frame))
                start = end + 2
            else:  # 02 may have been data of a broken telegram: rescan from the next byte
                self.rejected += 1
                start += 1
        del buffer[:start]
        return telegrams

    def _telegram(self, frame: bytes) -> Telegram:
        if self._replies:
            return Telegram(frame[1] & ~_REPLY, frame[4], frame[5:-1], frame[-1])
        return Telegram(frame[1], frame[4], frame[5:], None)
