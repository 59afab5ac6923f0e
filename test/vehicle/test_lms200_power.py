"""A laser whose power follows the open port: waiting for its start, and what disturbs that."""

import os
import threading
import time

import numpy as np
import pytest

from explore_slam.errors import VehicleError
from explore_slam.settings import with_values
from explore_slam.simulation.emulators.arcos_robot import ArcosRobot
from explore_slam.simulation.emulators.kinematic_body import KinematicBody
from explore_slam.simulation.emulators.lms200_scanner import Lms200Scanner
from explore_slam.simulation.emulators.serial_line import SerialLine
from explore_slam.vehicle import DriverConfig, Supervisor, lms200, make_laser


class CountingScanner(Lms200Scanner):
    """An LMS-200 that counts how often its power was switched on."""

    power_cycles = 0

    def set_power(self, on, now):
        self.power_cycles += on
        super().set_power(on, now)


class RestartingScanner(CountingScanner):
    """An LMS-200 whose weak supply drops out whenever it has booted."""

    def transmit(self, now):
        waited = not self.booted
        data = super().transmit(now)
        if waited and self.booted:
            self.reset(now)
        return data


class Rig:
    """A scanner at a powered line, and the supervisor of its driver."""

    def __init__(self, folder, tcp=False, settings=None, kind=CountingScanner, **options):
        body = KinematicBody()
        body.obstacles = [(2.0, 0.3, 0.4)]
        self.scanner = kind(body.scan, **options)
        port = 0 if tcp else None
        self.line = SerialLine(self.scanner, folder / 'laser', tcp_port=port, powered=True).start()
        values = {'laser_port': self.line.path, **(settings or {})}
        self.laser = make_laser(with_values(DriverConfig(), values), time.time)
        self.scans, self.came = [], threading.Event()
        self.part = Supervisor('laser', self.laser, self.take, retry_after=0.05)

    def take(self, scan):
        self.scans.append(scan)
        self.came.set()

    def await_scan(self, limit=20.0):
        self.came.clear()
        return self.came.wait(limit)

    def close(self):
        self.part.stop()
        self.line.stop()


@pytest.fixture
def rig(tmp_path):
    made = []

    def make(**options):
        made.append(Rig(tmp_path, **options))
        return made[-1]

    yield make
    for one in made:
        one.close()


@pytest.fixture
def two_rates(monkeypatch):
    """Let the driver try two rates only, that of a laser that has booted among them."""
    monkeypatch.setattr(lms200, '_RATES', (9600,))


def until(condition, limit=10.0):
    end = time.monotonic() + limit
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    return condition()


@pytest.mark.parametrize(
    'options',
    [
        {'boot_time': 0.5, 'answers_while_booting': True},
        {'boot_time': 0.5, 'tcp': True},
    ],
)
def test_the_port_stays_open_until_the_laser_has_booted(rig, options):
    one = rig(**options)
    assert not one.scanner.booted  # it has no power yet
    one.part.start()
    assert one.await_scan()
    assert one.scanner.power_cycles == 1
    assert np.isfinite(one.scans[0].ranges).any()
    assert one.part.health.connected
    assert one.part.health.losses == 0


@pytest.mark.usefixtures('two_rates')
def test_what_is_waited_for_is_said_meanwhile(rig):
    one = rig(boot_time=2.2)
    one.part.start()
    assert until(lambda: one.part.health.waiting)
    assert 'boots now' in one.part.health.message
    assert 'of 70 s' in one.part.health.message
    assert not one.part.health.connected
    assert one.await_scan()
    assert one.part.health.message.startswith('LMS200')
    assert one.scanner.power_cycles == 1


@pytest.mark.usefixtures('two_rates')
def test_a_lost_power_on_telegram_and_lost_bytes_delay_the_start_only(rig):
    one = rig(boot_time=0.6)
    one.line.faults.deaf = one.line.faults.silent = True
    one.part.start()
    assert until(lambda: one.scanner.booted)
    one.line.faults.deaf = one.line.faults.silent = False
    assert one.await_scan()
    assert one.scanner.power_cycles == 1


@pytest.mark.usefixtures('two_rates')
def test_a_fault_in_mid_run_is_named_as_what_it_is_and_does_not_cut_the_power(rig):
    one = rig(boot_time=0.3, settings={'scanner_timeout': 0.6})
    one.part.start()
    assert one.await_scan()
    one.scanner.faults.severe = one.scanner.faults.polluted = True
    assert until(lambda: 'severity 3' in one.part.health.message)
    assert 'reports an error' in one.part.health.message
    assert 'front screen is dirty' in one.part.health.message
    one.scanner.faults.severe = False
    assert one.await_scan()
    losses = one.part.health.losses
    one.scanner.reset(time.monotonic())  # its supply has dropped out
    assert until(lambda: one.part.health.losses > losses)
    assert one.await_scan()
    assert one.scanner.power_cycles == 1


def test_closing_the_driver_switches_the_laser_off_and_waiting_can_be_interrupted(rig):
    one = rig(boot_time=30.0)
    one.part.start()
    assert until(lambda: one.scanner.power_cycles == 1)
    began = time.monotonic()
    one.part.stop()
    assert time.monotonic() - began < 1.0
    assert until(lambda: not one.scanner._power)


@pytest.mark.usefixtures('two_rates')
def test_the_wait_ends_with_laser_startup_timeout_and_releases_the_port(rig):
    one = rig(boot_time=60.0, settings={'laser_startup_timeout': 1.0})
    with pytest.raises(VehicleError, match='no reply from an LMS-200 at 38400/9600 Bd'):
        one.laser.connect()
    assert until(lambda: not one.scanner._power)


@pytest.mark.usefixtures('two_rates')
def test_the_end_of_the_wait_names_all_rates_that_were_tried(rig, monkeypatch):
    monkeypatch.setattr(lms200, '_BOOT_LISTENING', 0.1)
    one = rig(boot_time=60.0, settings={'laser_startup_timeout': 2.5})
    with pytest.raises(VehicleError, match=r'at 38400/9600 Bd.*laser_startup_timeout'):
        one.laser.connect()
    assert one.laser._rounds > 1  # the later ones try 9600 Bd only


@pytest.mark.usefixtures('two_rates')
def test_a_laser_that_restarts_again_and_again_is_named(rig):
    one = rig(boot_time=0.2, kind=RestartingScanner, settings={'laser_startup_timeout': 2.5})
    said = []
    one.laser.progress.on_text = said.append
    with pytest.raises(VehicleError, match=r'restarted \d+ times; is its supply .24 V. steady'):
        one.laser.connect()
    assert any('restarted 3 times' in text for text in said)


@pytest.mark.parametrize('baud', [9600, 115200])
def test_a_silent_robot_at_the_port_is_named_at_once(tmp_path, baud):
    with SerialLine(ArcosRobot(KinematicBody(), baud=baud), tmp_path / 'base') as line:
        settings = with_values(DriverConfig(), {'laser_port': line.path})
        began = time.monotonic()
        with pytest.raises(VehicleError, match='a Pioneer robot is at this port'):
            make_laser(settings, time.time).connect()
        assert time.monotonic() - began < 5.0


def test_the_power_follows_any_client_that_opens_the_port(rig):
    one = rig(boot_time=0.2)
    path = one.line.path
    for cycle in (1, 2):
        port = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        assert until(lambda: one.scanner.booted)
        assert one.scanner.power_cycles == cycle
        os.close(port)
        assert until(lambda: not one.scanner._power)
