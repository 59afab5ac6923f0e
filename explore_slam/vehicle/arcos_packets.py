"""ARCOS (P2OS) framing: encoding of packets and an incremental decoder.

A packet is FA FB, count, payload, checksum; count covers payload and checksum. Source: Pioneer 3
operations manual (MobileRobots), chapter "Client-Server Communication".
"""

from enum import IntEnum

HEADER = b'\xfa\xfb'
LONGEST_COUNT = 200  # bytes after the count byte (manual)
_SHORTEST_COUNT = 3  # one payload byte and the checksum
BAUD_CODES = {9600: 0, 19200: 1, 38400: 2, 57600: 3, 115200: 4}  # arguments of HOSTBAUD
RATE_CHANGE_DELAY = 0.01  # s from HOSTBAUD until the robot uses the new baud rate
RATE_CHANGE_TIMEOUT = 0.9  # s without a packet at a new baud rate until the robot goes back


class Command(IntEnum):
    """Client command numbers (manual, table of client commands)."""

    PULSE = 0
    OPEN = 1
    CLOSE = 2
    ENABLE = 4
    SETA = 5
    SETV = 6
    SETO = 7
    SETRV = 10
    VEL = 11
    CONFIG = 18
    RVEL = 21
    SETRA = 23
    SONAR = 28
    STOP = 29
    VEL2 = 32
    BUMPSTALL = 44
    HOSTBAUD = 50
    ESTOP = 55
    BATTERYINFO = 62
    REVCOUNT = 88
    DRIFTFACTOR = 89
    TICKSMM = 93


_POSITIVE, _NEGATIVE, _STRING = 0x3B, 0x1B, 0x2B  # argument types
_LARGEST_ARGUMENT = 0xFFFF  # magnitude, u16


def checksum(payload: bytes) -> int:
    """Return the sum of big-endian byte pairs modulo 2¹⁶; an odd last byte is XORed in."""
    total = sum(payload[0 : len(payload) - 1 : 2]) << 8
    total += sum(payload[1::2])
    total &= 0xFFFF
    return total ^ payload[-1] if len(payload) % 2 else total


def encode_packet(payload: bytes) -> bytes:
    """Return the packet of a payload; raises ValueError unless it has 1 to 198 bytes."""
    count = len(payload) + 2
    if not _SHORTEST_COUNT <= count <= LONGEST_COUNT:
        raise ValueError(f'payload of {len(payload)} bytes, expected 1 to {LONGEST_COUNT - 2}')
    return HEADER + bytes([count]) + payload + checksum(payload).to_bytes(2, 'big')


def encode_command(command: int, argument: int | bytes | None = None) -> bytes:
    """Return the packet of a command.

    argument: None, an integer (clamped to ±65535), or bytes.
    """
    payload = bytes([command])
    if isinstance(argument, bytes):
        payload += bytes([_STRING, len(argument)]) + argument
    elif argument is not None:
        kind = _NEGATIVE if argument < 0 else _POSITIVE
        payload += bytes([kind]) + min(abs(argument), _LARGEST_ARGUMENT).to_bytes(2, 'little')
    return encode_packet(payload)


def decode_command(payload: bytes) -> tuple[int, int | bytes | None]:
    """Return command and argument of a client's payload; None for no or a malformed argument."""
    command, kind = payload[0], payload[1] if len(payload) > 1 else None
    if kind in (_POSITIVE, _NEGATIVE) and len(payload) >= 4:
        value = int.from_bytes(payload[2:4], 'little')
        return command, -value if kind == _NEGATIVE else value
    if kind == _STRING and len(payload) >= 3:
        return command, payload[3 : 3 + payload[2]]
    return command, None


class PacketDecoder:
    """Incremental decoder that resynchronizes after garbage; buffers at most one packet."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.rejected = 0  # headers followed by a bad count or checksum

    @property
    def pending(self) -> int:
        """Number of buffered bytes of an incomplete packet."""
        return len(self._buffer)

    def clear(self) -> None:
        """Discard an incomplete packet."""
        self._buffer.clear()

    def feed(self, data: bytes) -> list[bytes]:
        """Add received bytes; return the payloads that are now complete."""
        buffer = self._buffer
        buffer += data
        payloads: list[bytes] = []
        start = 0
        while True:
            found = buffer.find(HEADER, start)
            if found < 0:
                half = len(buffer) > start and buffer.endswith(HEADER[:1])
                start = len(buffer) - half
                break
            start = found
            if len(buffer) < start + 3:
                break
            count = buffer[start + 2]
            if not _SHORTEST_COUNT <= count <= LONGEST_COUNT:
                self.rejected += 1
                start += 1
                continue
            end = start + 3 + count
            if len(buffer) < end:
                break
            payload = bytes(buffer[start + 3 : end - 2])
            if checksum(payload) == int.from_bytes(buffer[end - 2 : end], 'big'):
                payloads.append(payload)
                start = end
            else:  # the header may have been data of a broken packet: rescan from the next byte
                self.rejected += 1
                start += 1
        del buffer[:start]
        return payloads
