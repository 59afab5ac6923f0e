"""The emulated scanner against the bytes of a real one and of its host."""

import json

import numpy as np
import pytest

from explore_slam.data import LaserScan
from explore_slam.simulation.emulators.lms200_scanner import Lms200Scanner
from explore_slam.vehicle.lms200_scan import parse_scan
from explore_slam.vehicle.lms200_telegrams import (
    Mode,
    Reply,
    Request,
    TelegramDecoder,
    encode_telegram,
)

RANGES = np.linspace(1.0, 4.6, 361).astype(np.float32)
SCAN = LaserScan(0.0, -np.pi / 2, np.pi / 360, RANGES, 0.01, 8.0)


class Host:
    def __init__(self, **options):
        self.now = 0.0
        self.scanner = Lms200Scanner(lambda: SCAN, **options)
        self.decoder = TelegramDecoder()
        self.raw = b''

    def run(self, seconds):
        telegrams = []
        for _ in range(round(seconds / 0.002) + 1):
            data = self.scanner.transmit(self.now)
            self.raw += data
            telegrams += self.decoder.feed(data)
            self.now += 0.002
        return telegrams

    def ask(self, request, data=b'', seconds=0.5):
        self.scanner.receive(encode_telegram(request, data), self.now)
        return self.run(seconds)


def test_acknowledges_within_60_ms_then_answers():
    host = Host()
    host.scanner.receive(encode_telegram(Request.TYPE), 0.0)
    host.run(0.06)
    assert host.raw.startswith(b'\x06')
    [telegram] = host.ask(Request.TYPE)[-1:]
    assert telegram.command == Reply.TYPE
    assert telegram.status == 0x10


def test_streams_at_38400_as_a_real_one_does():
    host = Host()
    host.ask(Request.MODE, bytes([Mode.BAUD_38400]))
    assert host.scanner.baud == 38400
    host.ask(Request.MODE, bytes([Mode.STREAM]), 0.0)
    scans = [t for t in host.run(10.0) if t.command == Reply.SCAN]
    assert len(scans) == pytest.approx(10.0 / 0.2131, abs=1)  # 213 ms in the recordings
    values = parse_scan(scans[0].data).values
    np.testing.assert_allclose(values * 0.001, RANGES, atol=0.0006)


def test_configuration_is_only_written_in_installation_mode():
    host = Host()
    block = bytearray(host.scanner.configuration.block)
    block[6] = 0
    [refused] = host.ask(Request.WRITE_CONFIGURATION, bytes(block))
    assert (refused.data[0], host.scanner.writes) == (0, 0)
    host.ask(Request.MODE, b'\x00SICK_LMS')
    [accepted] = host.ask(Request.WRITE_CONFIGURATION, bytes(block))
    assert (accepted.data[0], host.scanner.writes) == (1, 1)
    assert host.scanner.configuration.unit == 0


def test_wrong_password_unknown_command_other_address_broken_telegram():
    host = Host()
    [answer] = host.ask(Request.MODE, b'\x00SICK_XXX')
    assert answer.data[0] == 1
    [answer] = host.ask(0x66)
    assert answer.command == Reply.UNKNOWN
    host.scanner.receive(encode_telegram(Request.TYPE, address=3), host.now)
    assert host.run(0.3) == []
    broken = bytearray(encode_telegram(Request.TYPE))
    broken[-1] ^= 1
    host.raw = b''
    host.scanner.receive(bytes(broken) + bytes(20), host.now)
    host.run(0.3)
    assert host.raw == b'\x15'


def test_reset_falls_back_to_9600_and_says_so():
    host = Host(baud=38400, streaming=True)
    telegrams = host.ask(Request.RESET, seconds=1.5)
    assert host.scanner.baud == 9600
    assert telegrams[-1].command == Reply.POWER_ON


def test_invalid_ranges_become_codes():
    ranges = RANGES.copy()
    ranges[:4] = np.inf, np.nan, -np.inf, 30.0
    host = Host()
    host.scanner._scan = lambda: LaserScan(0.0, -np.pi / 2, np.pi / 360, ranges, 0.01, 80.0)
    [telegram] = host.ask(Request.SCAN, b'\x01')
    assert list(parse_scan(telegram.data).values[:4]) == [0x3FFF, 0x3FFD, 1, 0x3FF7]


@pytest.mark.data
def test_answers_a_recorded_host_as_the_real_scanner_did(recordings):
    rows = json.loads((recordings('lms200') / '2017_Aug_04_232500.json').read_text())
    host, expected = Host(), []
    for kind, _, text in rows:
        data = bytes.fromhex(text)
        if kind == 'tx':
            host.scanner.receive(data, host.now)
            got = [t for t in host.run(0.4) if t.command != Reply.SCAN]
        elif data[4] != Reply.SCAN:
            [real] = TelegramDecoder().feed(data)
            expected.append(real.command)
            assert got[0].command == real.command
            assert got[0].status == real.status
            if real.command != Reply.STATUS:
                assert got[0].data == real.data
                continue
            # counters and temperatures are its own; how it measures is not
            for own in (
                slice(0, 8),
                slice(9, 17),
                slice(101, 102),
                slice(106, 111),
                slice(115, 130),
            ):
                assert got[0].data[own] == real.data[own]
    assert len(expected) == 11


@pytest.mark.parametrize('length', [7, 32, 34])
def test_configuration_blocks_of_other_clients_may_be_short(length):
    host = Host()
    stock = host.scanner.configuration.block
    block = bytes((0, 0, 70, 0, 0, 5, 0)) + bytes(range(length - 7))
    host.ask(Request.MODE, b'\x00SICK_LMS')
    [reply] = host.ask(Request.WRITE_CONFIGURATION, block)
    assert reply.data == b'\x01' + block + stock[length:]
    assert host.scanner.configuration.block == block + stock[length:]
    assert (host.scanner.configuration.mode, host.scanner.configuration.unit) == (5, 0)
    [refused] = host.ask(Request.WRITE_CONFIGURATION, block[:6])
    assert refused.data[0] == 0


def test_the_status_telegram_says_how_it_measures():
    host = Host(baud=38400)
    host.ask(Request.VARIANT, bytes((100, 0, 25, 0)))
    host.ask(Request.MODE, bytes([Mode.STREAM]), 0.3)
    [status] = [t.data for t in host.ask(Request.STATUS) if t.command == Reply.STATUS]
    assert len(status) == 152
    assert (status[:7], status[7], status[9:17]) == (b'V02.19 ', Mode.STREAM, b'05270497')
    assert status[101] == host.scanner.configuration.mode
    angle, resolution = status[106:108], status[108:110]
    assert [int.from_bytes(word, 'little') for word in (angle, resolution)] == [100, 25]
    assert (status[115:117], status[121], status[123:130]) == (b'\x19\x80', 1, b'V02.02 ')
