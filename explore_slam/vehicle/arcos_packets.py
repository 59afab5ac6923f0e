"""ARCOS (P2OS) framing: pure functions over bytes and an incremental decoder.

A packet is FA FB, count, payload, checksum; count covers payload and checksum. Source: the
Pioneer 3 operations manual, chapter on client-server communication.
"""

from enum import IntEnum

HEADER = b'\xfa\xfb'
LONGEST_COUNT = 200  # bytes after the count byte, as the manual bounds them
_SHORTEST_COUNT = 3  # one payload byte and the checksum


class Command(IntEnum):
    """Command numbers of the client."""

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


_POSITIVE, _NEGATIVE, _STRING = 0x3B, 0x1B, 0x2B


def checksum(payload: bytes) -> int:
    """Return the sum of big-endian byte pairs modulo 2**16, an odd last byte XORed in."""
    total = sum(payload[0 : len(payload) - 1 : 2]) << 8
    total += sum(payload[1::2])
    total &= 0xFFFF
    return total ^ payload[-1] if len(payload) % 2 else total


def encode_packet(payload: bytes) -> bytes:
    """Return the frame of a payload of 1 to 198 bytes."""
    count = len(payload) + 2
    if not _SHORTEST_COUNT <= count <= LONGEST_COUNT:
        raise ValueError(f'payload of {len(payload)} bytes, expected 1 to {LONGEST_COUNT - 2}')
    return HEADER + bytes([count]) + payload + checksum(payload).to_bytes(2, 'big')


def encode_command(command: int, argument: int | bytes | None = None) -> bytes:
    """Return the frame of a command with no, an integer (-65535 to 65535) or a bytes argument."""
    payload = bytes([command])
    if isinstance(argument, bytes):
        payload += bytes([_STRING, len(argument)]) + argument
    elif argument is not None:
        kind = _NEGATIVE if argument < 0 else _POSITIVE
        payload += bytes([kind]) + min(abs(argument), 0xFFFF).to_bytes(2, 'little')
    return encode_packet(payload)


def decode_command(payload: bytes) -> tuple[int, int | bytes | None]:
    """Return (command, argument) of a client's payload; None for an argument without sense."""
    command, kind = payload[0], payload[1] if len(payload) > 1 else None
    if kind in (_POSITIVE, _NEGATIVE) and len(payload) >= 4:
        value = int.from_bytes(payload[2:4], 'little')
        return command, -value if kind == _NEGATIVE else value
    if kind == _STRING and len(payload) >= 3:
        return command, payload[3 : 3 + payload[2]]
    return command, None


class PacketDecoder:
    """Finds packets in a stream that may hold anything; keeps at most one packet's bytes."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.rejected = 0  # headers followed by a bad count or checksum

    @property
    def pending(self) -> int:
        """Bytes kept for a packet that is not yet whole."""
        return len(self._buffer)

    def clear(self) -> None:
        """Forget a packet begun."""
        self._buffer.clear()

    def feed(self, data: bytes) -> list[bytes]:
        """Return the payloads completed by these bytes."""
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
            else:  # what looked like a header may have been data: look again from the next byte
                self.rejected += 1
                start += 1
        del buffer[:start]
        return payloads
