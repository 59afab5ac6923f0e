"""Feed random and mutated byte strings to all parsers of the serial protocols.

    python benchmarks/vehicle_fuzz.py --strings 1000000

Each string must cause no exception, keep memory bounded, and leave later packets readable.
"""

import argparse
import sys
import time
from collections.abc import Callable

import numpy as np

from explore_slam.vehicle import arcos_packets, arcos_status, lms200_scan, lms200_telegrams

LONGEST = 400  # bytes of a random string
PACKET = arcos_packets.encode_packet(b'\x32' + bytes(range(60)))
SCAN = b'\x69\x41' + bytes(range(256)) * 3  # 361 values of 0.5°, in mm
VALID_PACKET = arcos_packets.encode_packet(b'\x32' + bytes(20))
VALID_TELEGRAM = lms200_telegrams.encode_telegram(0xBA, b'LMS200\x10', 0x80)
TELEGRAM = lms200_telegrams.encode_telegram(0xB0, SCAN[:724] + b'\x10', 0x80)


def strings(generator: np.random.Generator, seeds: list[bytes]) -> bytes:
    """Return a random string: noise, noise of header bytes, or a mutated valid packet."""
    kind = generator.integers(4)
    if kind == 0:
        return generator.bytes(int(generator.integers(LONGEST)))
    if kind == 1:
        alphabet = np.frombuffer(bytes([0xFA, 0xFB, 2, 0x80, 0xB0, 3, 200, 0xD6]), np.uint8)
        return generator.choice(alphabet, int(generator.integers(LONGEST))).tobytes()
    data = bytearray(seeds[int(generator.integers(len(seeds)))])
    for _ in range(int(generator.integers(1, 6))):
        at = int(generator.integers(len(data)))
        change = generator.integers(4)
        if change == 0:
            data[at] = int(generator.integers(256))
        elif change == 1:
            del data[at : at + int(generator.integers(1, 8))]
        elif change == 2:
            data[at:at] = generator.bytes(int(generator.integers(1, 8)))
        else:
            del data[at:]
        if not data:
            break
    return bytes(data)


def fuzz_stream(make: Callable[[], object], valid: bytes, bound: int) -> Callable[[bytes], None]:
    """Return a check with one decoder for all strings."""
    decoder = make()

    def check(data: bytes) -> None:
        decoder.feed(data)
        assert decoder.pending <= bound, f'{decoder.pending} bytes kept'
        # A false header may hold back as many bytes as it announces, never more.
        for _ in range(bound // len(valid) + 2):
            if decoder.feed(valid):
                break
        else:
            raise AssertionError('no valid packet found after the string')

    return check


def check_status(data: bytes) -> None:
    """Parse the string as payload of all kinds of ARCOS packets."""
    for payload in (data, b'\x32' + data, b'\x33' + data):
        arcos_status.parse_status(payload)
    arcos_status.parse_configuration(b'\x20' + data)
    arcos_status.parse_identity(b'\x02' + data)
    if data:
        arcos_packets.decode_command(data)


def check_scan(data: bytes) -> None:
    """Parse the string as payload of all kinds of telegrams."""
    for content in (data, SCAN[:2] + data, data[:2] + SCAN):
        scan = lms200_scan.parse_scan(content)
        if scan is not None:
            ranges = lms200_scan.scan_ranges(scan, 13)
            assert ranges.shape == scan.values.shape
    lms200_scan.parse_configuration(data)
    lms200_scan.parse_status_byte(data[0] if data else 0)


def main() -> int:
    """Run all checks; return 1 at the first failure."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n', maxsplit=1)[0])
    parser.add_argument('--strings', type=int, default=1_000_000, help='per parser')
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--parser', help='part of the name of a parser (default: all)')
    arguments = parser.parse_args()
    checks = {
        'ARCOS framing': fuzz_stream(arcos_packets.PacketDecoder, VALID_PACKET, 203),
        'ARCOS content': check_status,
        'LMS-200 framing': fuzz_stream(lms200_telegrams.TelegramDecoder, VALID_TELEGRAM, 1030),
        'LMS-200 content': check_scan,
    }
    for name, check in checks.items():
        if arguments.parser and arguments.parser not in name:
            continue
        generator = np.random.default_rng(arguments.seed)
        began = time.process_time()
        for index in range(arguments.strings):
            data = strings(generator, [PACKET, TELEGRAM])
            try:
                check(data)
            except Exception as error:
                print(f'{name}: string {index}: {data.hex()}: {type(error).__name__}: {error}')
                return 1
        seconds = time.process_time() - began
        rate = arguments.strings / seconds
        print(f'{name:16} {arguments.strings} strings, no exception, {rate:.0f} strings/s')
    return 0


if __name__ == '__main__':
    sys.exit(main())
