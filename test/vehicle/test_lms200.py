"""The laser's driver against the emulated scanner."""

import time

import numpy as np
import pytest

from explore_slam.errors import ConfigError, VehicleError
from explore_slam.settings import with_values
from explore_slam.simulation.emulators.arcos_robot import ArcosRobot
from explore_slam.simulation.emulators.kinematic_body import KinematicBody
from explore_slam.simulation.emulators.lms200_scanner import Lms200Scanner
from explore_slam.simulation.emulators.serial_line import SerialLine
from explore_slam.vehicle import DriverConfig, Lms200Config, make_base, make_laser

CENTIMETRES = bytes([0, 0, 0x70, 0, 0, 1, 0]) + bytes(27)


@pytest.fixture
def rig(tmp_path):
    """Return a function: options of Lms200Scanner -> (scanner side, its line, driver)."""
    made = []

    def make(config=None, **options):
        body = KinematicBody()
        body.obstacles = [(2.0, 0.3, 0.4), (0.5, -3.0, 1.0)]
        scanner = Lms200Scanner(body.scan, **options)
        line = SerialLine(scanner, tmp_path / 'laser').start()
        laser = driver(line.path, **(config or {}))
        made.append((laser, line))
        return scanner, line, laser

    yield make
    for laser, line in made:
        laser.close()
        line.stop()


def driver(port, **settings):
    return make_laser(with_values(DriverConfig(), {'laser_port': port, **settings}), time.time)


def run(laser, seconds):
    scans = []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        scans += laser.poll(0.05)
    return scans


def test_sets_up_streams_and_measures_what_is_there(rig):
    scanner, _, laser = rig()
    assert 'LMS200' in laser.connect()
    assert scanner.baud == 38400
    scans = run(laser, 1.5)
    assert 5 <= len(scans) <= 8
    truth = scanner._scan().ranges
    known = np.isfinite(truth)
    for scan in scans:
        np.testing.assert_allclose(scan.ranges[known], truth[known], atol=0.00051)
        assert np.isposinf(scan.ranges[~known]).all()
    assert scans[0].angle_min == pytest.approx(-np.pi / 2)
    assert scanner.writes == 0  # stock configuration suits: no EEPROM cycle
    assert (laser.rejected, laser.unusable) == (0, 0)
    gaps = np.diff([scan.stamp for scan in scans])
    assert np.abs(gaps - 0.2131).max() < 0.05


def test_the_configuration_is_written_once_and_only_where_it_must_be(rig):
    scanner, line, laser = rig(configuration=CENTIMETRES)
    laser.connect()
    assert (scanner.writes, scanner.configuration.unit) == (1, 1)
    assert run(laser, 0.6)
    laser.close()
    again = driver(line.path)
    again.connect()
    assert (scanner.writes, again.written) == (1, 0)
    again.close()


@pytest.mark.parametrize('baud', [9600, 19200, 38400, 500000])
@pytest.mark.parametrize('streaming', [False, True])
def test_finds_a_scanner_at_any_rate_even_while_it_streams(rig, baud, streaming):
    scanner, _, laser = rig(baud=baud, streaming=streaming)
    found = laser.connect()
    assert (f'found at {baud} Bd' in found) == (baud != 38400)
    assert scanner.baud == 38400
    assert run(laser, 0.5)


@pytest.mark.parametrize(
    ('angle', 'resolution', 'beams'), [(180, 1.0, 181), (100, 0.5, 201), (100, 0.25, 401)]
)
def test_other_variants(rig, angle, resolution, beams):
    scanner, _, laser = rig({'laser_angle': angle, 'laser_resolution': resolution})
    laser.connect()
    assert scanner.variant == (angle, round(100 * resolution))
    scan = run(laser, 0.6)[-1]
    assert scan.ranges.shape == (beams,)
    assert scan.angle_min == pytest.approx(-np.radians(angle / 2))


def test_variants_that_the_scanner_has_not_are_refused():
    with pytest.raises(ConfigError, match='laser_angle and laser_resolution'):
        Lms200Config(laser_angle=180, laser_resolution=0.25)
    with pytest.raises(ConfigError, match='laser_range'):
        Lms200Config(laser_range=10)


def test_upside_down(rig):
    scanner, _, laser = rig({'laser_inverted': True})
    laser.connect()
    ranges = run(laser, 0.5)[-1].ranges
    np.testing.assert_allclose(ranges[::-1], scanner._scan().ranges, atol=0.00051)


def test_missed_requests_are_repeated(rig):
    scanner, _, laser = rig()
    scanner.faults.missed_requests = 1
    laser.connect()
    assert run(laser, 0.5)


def test_a_baud_rate_at_which_bytes_come_is_tried_three_times(rig):
    scanner, _, laser = rig(baud=38400, streaming=True)
    scanner.faults.missed_requests = 2
    laser.connect()
    assert run(laser, 0.5)


def test_before_the_first_byte_nothing_is_heard(rig):
    _, _, laser = rig()
    assert laser.last_received == -np.inf
    before = time.monotonic()
    laser.connect()
    assert before <= laser.last_received <= time.monotonic()
    assert laser.statistics() == {
        'scans': 0, 'rejected': 0, 'unusable': 0, 'severity': 0, 'polluted': False,
    }  # fmt: skip


def test_a_bad_line_costs_scans_not_the_stream(rig):
    _, line, laser = rig()
    laser.connect()
    line.faults.corrupt_rate = 0.0003
    scans = run(laser, 3.0)
    assert len(scans) >= 4
    assert all(np.nanmax(scan.ranges[np.isfinite(scan.ranges)]) <= 8.2 for scan in scans)


def test_a_standing_mirror_a_pulled_cable_and_lost_power_are_reported(rig):
    scanner, line, laser = rig({'scanner_timeout': 0.6})
    laser.connect()
    scanner.faults.stalled = True
    with pytest.raises(VehicleError, match='no valid scan for'):
        run(laser, 2.0)
    scanner.faults.stalled = False
    laser.connect()
    scanner.reset(time.monotonic())
    with pytest.raises(VehicleError, match=r'no valid scan|switched off and on'):
        run(laser, 2.0)
    laser.connect()
    line.unplug()
    with pytest.raises(VehicleError, match='lost'):
        run(laser, 1.0)
    line.plug()
    began = time.monotonic()
    laser.connect()
    assert time.monotonic() - began < 3.0
    assert run(laser, 0.5)


def test_scans_of_a_scanner_in_trouble_are_not_used(rig):
    scanner, _, laser = rig({'scanner_timeout': 5.0})
    laser.connect()
    run(laser, 0.3)
    scanner.faults.severe = scanner.faults.polluted = True
    run(laser, 0.4)
    assert run(laser, 0.6) == []
    assert laser.unusable >= 2
    assert laser.status.polluted


def test_silence_and_a_robot_at_the_port_have_their_messages(rig, tmp_path):
    _, line, laser = rig({'laser_startup_timeout': 1.0})
    line.faults.silent = True
    with pytest.raises(
        VehicleError, match=r'no reply from an LMS-200.*switched on.*laser_startup_timeout'
    ):
        laser.connect()
    device = ArcosRobot(KinematicBody(), baud=38400)
    with SerialLine(device, tmp_path / 'base') as base:
        config = with_values(DriverConfig(), {'base_port': base.path, 'base_baud': 38400})
        robot = make_base(config, time.time)
        robot.connect()
        robot._port.close()  # the session stays open: the robot goes on talking
        with pytest.raises(VehicleError, match='a Pioneer robot is at this port'):
            driver(base.path).connect()
