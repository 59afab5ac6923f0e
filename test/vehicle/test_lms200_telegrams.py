import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from explore_slam.vehicle.lms200_scan import (
    MILLIMETRES,
    parse_configuration,
    parse_scan,
    scan_ranges,
)
from explore_slam.vehicle.lms200_telegrams import (
    BAUD_MODES,
    PASSWORD,
    Mode,
    Reply,
    Request,
    TelegramDecoder,
    crc,
    encode_telegram,
)

RECORDINGS = ['232204', '232500', '232528', '232544', '232553']


def slow_crc(data):
    """The manual's routine."""
    value, last = 0, 0
    for byte in data:
        value = ((value & 0x7FFF) << 1) ^ 0x8005 if value & 0x8000 else value << 1
        value ^= byte | last << 8
        last = byte
    return value


@given(st.binary(max_size=200))
def test_crc_is_that_of_the_manual(data):
    assert crc(data) == slow_crc(data)


def test_requests_are_those_a_real_host_sent():
    assert encode_telegram(Request.MODE, bytes([Mode.BAUD_38400])).hex() == '0200020020405008'
    assert encode_telegram(Request.TYPE).hex() == '020001003a1e12'
    installation = encode_telegram(Request.MODE, bytes([Mode.INSTALLATION]) + PASSWORD)
    assert installation.hex() == '02000a0020005349434b5f4c4d53bec5'


@given(st.lists(st.binary(min_size=1, max_size=900), max_size=4), st.integers(1, 400))
def test_telegrams_are_found_however_the_bytes_are_cut(contents, cut):
    stream = b''.join(encode_telegram(0xB0, data, 0x80) for data in contents)
    decoder = TelegramDecoder()
    found = [t for at in range(0, len(stream), cut) for t in decoder.feed(stream[at : at + cut])]
    assert [t.data + bytes([t.status]) for t in found] == contents
    assert (decoder.rejected, decoder.pending) == (0, 0)


@settings(max_examples=300)
@given(st.binary(max_size=1500) | st.lists(st.sampled_from([2, 0x80, 0xD6, 0, 3])).map(bytes))
def test_after_garbage_the_next_telegrams_are_found(garbage):
    decoder = TelegramDecoder()
    decoder.feed(garbage)
    assert decoder.pending <= 1030
    valid = [encode_telegram(0xB0, bytes([k]) * 300, 0x80) for k in range(8)]
    found = decoder.feed(b''.join(valid))
    assert [t.data[0] for t in found][-4:] == [4, 5, 6, 7]


def test_hosts_and_scanners_telegrams_are_told_apart():
    request = encode_telegram(Request.TYPE)
    assert TelegramDecoder().feed(request) == []
    [telegram] = TelegramDecoder(replies=False).feed(request)
    assert (telegram.command, telegram.data, telegram.status) == (Request.TYPE, b'', None)


@pytest.mark.data
@pytest.mark.parametrize('name', RECORDINGS)
def test_recordings_of_a_real_scanner_decode_whole(recordings, name):
    base = recordings('lms200') / f'2017_Aug_04_{name}'
    rows = json.loads(base.with_suffix('.json').read_text())
    received = [bytes.fromhex(row[2]) for row in rows if row[0] == 'rx']
    stream = base.with_suffix('.bin').read_bytes()
    decoder = TelegramDecoder()
    found = [t for at in range(0, len(stream), 61) for t in decoder.feed(stream[at : at + 61])]
    assert len(found) == len(received)
    assert (decoder.rejected, decoder.pending) == (0, 0)
    assert {t.status for t in found} == {0x10}
    [settings_read] = [t for t in found if t.command == Reply.CONFIGURATION]
    configuration = parse_configuration(settings_read.data)
    assert (configuration.mode, configuration.unit) == (4, MILLIMETRES)
    scans = [parse_scan(t.data) for t in found if t.command == Reply.SCAN]
    assert len(scans) == sum(len(data) == 732 for data in received)
    for scan in scans:
        assert (len(scan.values), scan.unit, scan.partial) == (361, MILLIMETRES, False)
        ranges = scan_ranges(scan, configuration.value_bits)
        known = ranges[np.isfinite(ranges)]
        assert known.size >= 350
        assert known.min() > 0.1
        assert known.max() < 12.0  # a room


def test_command_bytes_are_those_of_the_manual():
    def values(kind):
        return {member.name: member.value for member in kind}

    assert values(Request) == {
        'RESET': 0x10, 'MODE': 0x20, 'SCAN': 0x30, 'STATUS': 0x31, 'TYPE': 0x3A,
        'VARIANT': 0x3B, 'READ_CONFIGURATION': 0x74, 'WRITE_CONFIGURATION': 0x77,
    }  # fmt: skip
    assert values(Mode) == {
        'INSTALLATION': 0x00, 'STREAM': 0x24, 'ON_REQUEST': 0x25, 'BAUD_38400': 0x40,
        'BAUD_19200': 0x41, 'BAUD_9600': 0x42, 'BAUD_500000': 0x48,
    }  # fmt: skip
    assert values(Reply) == {
        'POWER_ON': 0x90, 'RESET': 0x91, 'UNKNOWN': 0x92, 'MODE': 0xA0, 'SCAN': 0xB0,
        'STATUS': 0xB1, 'TYPE': 0xBA, 'VARIANT': 0xBB, 'CONFIGURATION': 0xF4, 'WRITTEN': 0xF7,
    }  # fmt: skip
    assert BAUD_MODES == {9600: 0x42, 19200: 0x41, 38400: 0x40, 500000: 0x48}
