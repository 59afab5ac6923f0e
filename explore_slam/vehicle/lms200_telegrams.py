"""SICK LMS-200 framing: pure functions over bytes and an incremental decoder.

A telegram is 02, address, length (u16 LE: command and data), command, data, CRC (u16 LE);
replies have bit 7 of the address set and end their data with a status byte. Source: SICK,
Telegrams for Configuring and Operating the LMS 2xx.
"""

from enum import IntEnum
from typing import NamedTuple

START = 0x02
ACK, NAK = b'\x06', b'\x15'
LONGEST = 1024  # bytes of command and data; the longest scan has 808
_REPLY = 0x80


class Request(IntEnum):
    """Command bytes of the host that are used here."""

    RESET = 0x10
    MODE = 0x20
    SCAN = 0x30
    STATUS = 0x31
    TYPE = 0x3A
    VARIANT = 0x3B
    READ_CONFIGURATION = 0x74
    WRITE_CONFIGURATION = 0x77


class Mode(IntEnum):
    """Data byte of Request.MODE."""

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
PASSWORD = b'SICK_LMS'


class Telegram(NamedTuple):
    """One telegram; data without the status byte, which is None in telegrams of the host."""

    address: int
    command: int
    data: bytes
    status: int | None


def _make_table() -> tuple[list[int], list[int]]:
    # the CRC is linear: its shift by one byte pair depends on the high byte alone
    shift, carry = [], []
    for value in range(256):
        word = value << 8
        doubled = word << 1
        shift.append((doubled ^ 0x8005) & 0xFFFF if word & 0x8000 else doubled & 0xFFFF)
        carry.append(value << 1)
    return shift, carry


_SHIFT, _CARRY = _make_table()


def crc(data: bytes) -> int:
    """Return the check sum over everything from the start byte on."""
    value, previous = 0, 0
    for byte in data:
        value = _SHIFT[value >> 8] ^ _CARRY[value & 0xFF] ^ (previous << 8 | byte)
        previous = byte
    return value


def encode_telegram(command: int, data: bytes = b'', address: int = 0) -> bytes:
    """Return the bytes of a telegram."""
    body = bytes([START, address]) + (1 + len(data)).to_bytes(2, 'little')
    body += bytes([command]) + data
    return body + crc(body).to_bytes(2, 'little')


class TelegramDecoder:
    """Finds telegrams in a stream that may hold anything; keeps at most one telegram's bytes.

    replies: expect what the scanner sends (with a status byte), else what the host sends.
    """

    def __init__(self, replies: bool = True) -> None:
        self._replies = replies
        self._buffer = bytearray()
        self.rejected = 0  # starts followed by a bad length or check sum

    @property
    def pending(self) -> int:
        """Bytes kept for a telegram that is not yet whole."""
        return len(self._buffer)

    def clear(self) -> None:
        """Forget a telegram begun."""
        self._buffer.clear()

    def feed(self, data: bytes) -> list[Telegram]:
        """Return the telegrams completed by these bytes."""
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
            else:  # a 02 in the data of something broken: look again from the next byte
                self.rejected += 1
                start += 1
        del buffer[:start]
        return telegrams

    def _telegram(self, frame: bytes) -> Telegram:
        if self._replies:
            return Telegram(frame[1] & ~_REPLY, frame[4], frame[5:-1], frame[-1])
        return Telegram(frame[1], frame[4], frame[5:], None)
