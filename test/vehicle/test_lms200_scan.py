"""Scans, configuration and status byte of the LMS-200."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from explore_slam.vehicle import LaserConfig, Lms200, Lms200Config
from explore_slam.vehicle.lms200_scan import (
    BEYOND,
    CENTIMETRES,
    CHANNEL_ERROR,
    DAZZLE,
    LOW_SIGNAL,
    MILLIMETRES,
    NO_ECHO,
    OVERFLOW,
    RANGE_BITS,
    RawScan,
    ScannerConfiguration,
    maximum_range,
    parse_configuration,
    parse_scan,
    parse_status_byte,
    scan_ranges,
)
from explore_slam.vehicle.lms200_telegrams import Reply, TelegramDecoder


def scan_data(values, head):
    return head.to_bytes(2, 'little') + b''.join(v.to_bytes(2, 'little') for v in values)


@given(st.binary(max_size=900))
def test_any_data_may_be_parsed_as_a_scan(data):
    scan = parse_scan(data)
    if scan is not None:
        assert scan_ranges(scan, 13).shape == scan.values.shape
    parse_configuration(data)


@pytest.mark.parametrize('bits', [13, 14, 15])
def test_invalid_codes_become_what_rep_117_wants(bits):
    top = (1 << bits) - 1
    values = np.array([0, 1, 1500, top - 9, top - 8, top - 5, top - 4, top - 2, top - 1, top])
    flagged = (values | (0xFFFF ^ top)).astype(np.uint16)  # flags of the fields must not matter
    ranges = scan_ranges(RawScan(flagged, MILLIMETRES, False), bits)
    longest = maximum_range(bits, MILLIMETRES)
    assert longest == pytest.approx((top - 9) / 1000)
    expected = [-np.inf, 0.001, 1.5, longest, np.inf, np.nan, np.nan, np.nan, np.nan, np.inf]
    np.testing.assert_allclose(ranges, expected, rtol=1e-6)


def test_centimetres_and_status_byte():
    raw = RawScan(np.array([250], np.uint16), 0, False)
    assert scan_ranges(raw, 13)[0] == pytest.approx(2.5)
    assert parse_status_byte(0x10) == (0, False)
    assert parse_status_byte(0xC3) == (3, True)
    assert parse_status_byte(0x44) == (4, False)
    assert parse_status_byte(0x81) == (1, True)


@pytest.mark.data
def test_scans_of_a_scanner_at_rest_repeat_to_centimetres(recordings):
    stream = (recordings('lms200') / '2017_Aug_04_232500.bin').read_bytes()
    laser = Lms200(LaserConfig())
    laser.configuration = ScannerConfiguration(bytes([0, 0, 0x70, 0, 0, 4, 1]) + bytes(27))
    telegrams = TelegramDecoder().feed(stream)
    records = [laser.record(parse_scan(t.data), 1.0) for t in telegrams if t.command == Reply.SCAN]
    ranges = np.array([record.ranges for record in records])
    known = np.isfinite(ranges).all(axis=0)
    assert np.median(ranges[:, known].std(axis=0)) < 0.01
    assert records[0].angle_min == pytest.approx(-np.pi / 2)
    assert records[0].range_max == pytest.approx(16.374)


def test_a_scan_is_parsed_by_count_unit_and_partial_flag():
    scan = parse_scan(scan_data([1, 2, 513], 3 | 1 << 14))
    assert (scan.values.tolist(), scan.unit, scan.partial) == ([1, 2, 513], MILLIMETRES, False)
    scan = parse_scan(scan_data([7], 1 | 1 << 13) + b'more')
    assert (scan.values.tolist(), scan.unit, scan.partial) == ([7], CENTIMETRES, True)
    scan = parse_scan(scan_data([5], 1 | 0b11 << 11))  # bits 11 and 12: which part it is
    assert (scan.unit, scan.partial) == (CENTIMETRES, False)


@pytest.mark.parametrize(
    'data',
    [
        b'',
        b'\x01',
        scan_data([], 0),
        scan_data([1, 2], 3),
        scan_data([1], 1)[:-1],
        scan_data([1], 1 | 2 << 14),
    ],
)
def test_incomplete_scans_and_unknown_units_are_refused(data):
    assert parse_scan(data) is None


def test_maximum_range_by_bits_and_unit():
    assert maximum_range(13, MILLIMETRES) == pytest.approx(8.182)
    assert maximum_range(13, CENTIMETRES) == pytest.approx(81.82)
    assert maximum_range(15, MILLIMETRES) == pytest.approx(32.758)


def test_the_configuration_has_mode_and_unit_and_keeps_the_rest():
    block = bytes(range(40))
    configuration = parse_configuration(block)
    assert configuration.block == block[:34]
    assert (configuration.mode, configuration.unit, configuration.value_bits) == (5, 6, 15)
    changed = configuration.changed(2, CENTIMETRES)
    assert (changed.mode, changed.unit, changed.value_bits) == (2, CENTIMETRES, 13)
    assert changed.block[:5] + changed.block[7:] == block[:5] + block[7:34]
    assert parse_configuration(bytes(7)).unit == CENTIMETRES
    assert parse_configuration(bytes(6)) is None


@pytest.mark.parametrize(
    ('mode', 'bits'), [(0, 13), (1, 13), (2, 13), (3, 14), (4, 14), (5, 15), (6, 15), (9, 13)]
)
def test_bits_of_a_distance_by_measuring_mode(mode, bits):
    assert ScannerConfiguration(bytes([0, 0, 0, 0, 0, mode, 1])).value_bits == bits


def test_codes_are_those_of_the_manual():
    codes = {
        NO_ECHO: 0x1FFF, DAZZLE: 0x1FFE, OVERFLOW: 0x1FFD, LOW_SIGNAL: 0x1FFB,
        CHANNEL_ERROR: 0x1FFA, BEYOND: 0x1FF7,
    }  # fmt: skip
    assert {(1 << 13) - 16 + digit: value for digit, value in codes.items()} == {
        value: value for value in codes.values()
    }
    assert RANGE_BITS == {8: 13, 16: 14, 32: 15}


def test_a_record_has_angles_and_range_of_its_configuration():
    laser = Lms200(LaserConfig(), Lms200Config(laser_angle=100, laser_resolution=0.25))
    record = laser.record(RawScan(np.arange(1000, 1401).astype(np.uint16), 1, False), 2.5)
    assert record.stamp == 2.5
    assert record.angle_min == pytest.approx(-np.radians(50.0))
    assert record.angle_increment == pytest.approx(np.radians(0.25))
    assert record.ranges[[0, -1]] == pytest.approx([1.0, 1.4])
    assert (record.range_min, record.range_max) == (0.01, pytest.approx(8.182))
