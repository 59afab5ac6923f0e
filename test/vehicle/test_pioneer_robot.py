"""The base's driver against the emulated robot, over a pty and over TCP."""

import logging
import math
import socket
import time

import pytest

from explore_slam.errors import VehicleError
from explore_slam.settings import with_values
from explore_slam.simulation.emulators.arcos_robot import ArcosRobot
from explore_slam.simulation.emulators.kinematic_body import KinematicBody
from explore_slam.simulation.emulators.lms200_scanner import Lms200Scanner
from explore_slam.simulation.emulators.serial_line import SerialLine
from explore_slam.vehicle import DriverConfig, make_base
from explore_slam.vehicle.arcos_packets import Command
from explore_slam.vehicle.pioneer_sonar import sonar_points


@pytest.fixture
def rig(tmp_path):
    """Return a function: options of ArcosRobot -> (robot side, its line, driver)."""
    lines, drivers = [], []

    def make(tcp=False, config=None, clock=time.time, **options):
        device = ArcosRobot(KinematicBody(), **options)
        line = SerialLine(device, tmp_path / 'base', tcp_port=0 if tcp else None).start()
        robot = driver(line.path, clock, **(config or {}))
        lines.append(line)
        drivers.append(robot)
        return device, line, robot

    yield make
    for robot in drivers:
        robot.close()
    for line in lines:
        line.stop()


def driver(port, clock=time.time, **settings):
    return make_base(with_values(DriverConfig(), {'base_port': str(port), **settings}), clock)


def wait(condition, seconds=3.0):
    end = time.monotonic() + seconds
    while not (met := condition()) and time.monotonic() < end:
        time.sleep(0.01)
    return met


def connects(robot):
    try:
        robot.connect()
    except VehicleError:
        return False
    return True


def run(robot, seconds, velocity=None, until=lambda _: False):
    states = []
    end = time.monotonic() + seconds
    while time.monotonic() < end and not (states and until(states[-1])):
        if velocity is not None:
            robot.set_velocity(*velocity)
        states += robot.poll(0.02)
    return states


@pytest.mark.parametrize('tcp', [False, True])
def test_drives_and_reports(rig, tcp):
    device, _, robot = rig(tcp, counters=(32760, 32767), name='Alice')
    assert robot.connect() == ('Alice', 'Pioneer', 'p3dx-sh')
    run(robot, 0.3, (0.4, 0.0))
    assert device.body.velocity() == (0.0, 0.0)  # nobody has enabled the motors
    robot.enable_motors(True)
    sent = device.sent
    states = run(robot, 2.0, (0.4, 0.5))
    assert len(states) == pytest.approx(device.sent - sent, abs=2)  # up to those on the line
    last, truth = states[-1], device.odometry()
    assert last.linear == pytest.approx(0.4, abs=0.005)
    assert last.angular == pytest.approx(0.5, abs=0.02)
    assert last.motors_on
    assert last.odometry.pose.x == pytest.approx(truth.x, abs=0.08)  # a packet old
    run(robot, 1.0, (0.0, 0.0))
    last = run(robot, 0.3)[-1]
    assert last.odometry.pose == pytest.approx(device.odometry(), abs=0.0011)
    covariance = last.odometry.covariance
    assert covariance[0, 0] > 0.0
    assert covariance[2, 2] > 0.0
    assert robot.configuration.watchdog_ms == 2000
    assert robot.rejected == 0


@pytest.mark.parametrize('baud', [9600, 38400, 115200, 57600])
def test_finds_the_rate(rig, baud):
    _, _, robot = rig(baud=baud)
    robot.connect()
    assert robot.last_baud == baud
    assert run(robot, 0.5)


def test_changes_to_a_faster_rate_and_stays_where_that_fails(rig):
    device, _, robot = rig(config={'host_baud': 38400})
    robot.connect()
    assert device.baud == 38400
    assert run(robot, 0.5)
    robot.close()
    assert device.baud == 9600


def test_a_session_that_a_crashed_client_left_open_is_closed(rig):
    device, line, robot = rig()
    robot.connect()
    robot.enable_motors(True)
    run(robot, 0.5, (0.3, 0.0))
    robot._port.close()  # as after SIGKILL
    robot._port = None
    other = driver(line.path)
    other.connect()
    assert not device.motors_on
    assert run(other, 0.4)
    other.close()


def test_closing_brings_the_vehicle_to_rest_and_switches_motors_off(rig):
    device, _, robot = rig()
    robot.connect()
    robot.enable_motors(True)
    run(robot, 1.0, (0.5, 0.0))
    assert device.body.velocity()[0] > 0.3
    robot.close()
    assert device.body.velocity() == (0.0, 0.0)
    assert wait(lambda: not device.session_open)
    assert not device.motors_on


def test_the_robots_watchdog_is_fed_while_driving_and_while_idle(rig):
    device, _, robot = rig()
    robot.connect()
    run(robot, 1.0)
    times = [when for when, command, _ in device.commands if command == Command.PULSE]
    assert len(times) >= 2
    robot.set_velocity(0.2, 0.0)
    run(robot, 1.0)
    sent = [when for when, command, _ in device.commands if command == Command.VEL]
    assert len(sent) >= 4


@pytest.mark.parametrize('fault', ['drop_rate', 'duplicate_rate', 'corrupt_rate'])
def test_a_bad_line_costs_packets_not_the_session(rig, fault):
    device, line, robot = rig()
    robot.connect()
    robot.enable_motors(True)
    run(robot, 0.3)  # the first status packet is where odometry begins
    setattr(line.faults, fault, 0.005)
    states = run(robot, 3.0, (0.3, 0.1))
    assert len(states) >= 10
    assert all(abs(state.linear) < 1.0 for state in states)
    setattr(line.faults, fault, 0.0)
    run(robot, 1.5, (0.0, 0.0))
    last = run(robot, 0.3)[-1]
    assert last.odometry.pose == pytest.approx(device.odometry(), abs=0.0011)


def test_bumpers_stalls_sonar_battery_and_the_red_button(rig):
    device, _, robot = rig()
    device.sonar = {3: 1.234, 15: 0.5}
    device.battery = 11.7
    robot.connect()
    robot.enable_motors(True)
    state = run(robot, 0.5)[-1]
    assert state.sonar_points == pytest.approx(sonar_points({3: 1.234, 15: 0.5}))
    assert state.battery == pytest.approx(11.7)
    assert (state.front_bumpers, state.rear_bumpers, state.stalled) == (0, 0, False)
    device.faults.front_bumpers, device.faults.left_stall = 0b100, True
    state = run(robot, 0.5)[-1]
    assert (state.front_bumpers, state.rear_bumpers, state.stalled) == (0b100, 0, True)
    device.faults.emergency_stop = True
    state = run(robot, 0.5)[-1]
    assert state.emergency_stop
    assert not state.motors_on


def test_a_pulled_cable_and_a_silent_robot_are_reported(rig):
    device, line, robot = rig()
    robot.connect()
    pose = run(robot, 0.4)[-1].odometry.pose
    line.unplug()
    with pytest.raises(VehicleError, match='lost'):
        run(robot, 2.0)
    line.plug()
    began = time.monotonic()
    robot.connect()
    assert time.monotonic() - began < 3.0
    assert run(robot, 0.4)[-1].odometry.pose == pose
    line.faults.silent = True
    with pytest.raises(VehicleError, match=r'no status packet for .*switched on'):
        run(robot, 3.0)
    line.faults.silent = False
    device.reset(time.monotonic())
    assert wait(lambda: connects(robot), 10.0)  # when it has booted
    assert run(robot, 0.4)[-1].odometry.pose == pose  # counters begin at 0 again


def test_unknown_subclass_and_its_remedy(rig):
    _, _, robot = rig(subclass='robo7')
    with pytest.raises(VehicleError, match=r"unknown subclass 'robo7'.*distance_factor"):
        robot.connect()
    device, _, robot = rig(subclass='robo7', distance_factor=0.7, config={'distance_factor': 0.7})
    assert robot.connect().subclass == 'robo7'
    robot.enable_motors(True)
    assert run(robot, 5.0, (0.5, 0.0), until=lambda state: state.odometry.pose.x > 0.3)
    assert 0.3 <= device.odometry().x < 0.5


def test_each_wrong_port_has_its_message(rig, tmp_path):
    def refusal(port, **settings):
        with pytest.raises(VehicleError) as refused:
            driver(port, **settings).connect()
        assert str(refused.value).startswith(str(port))
        return str(refused.value)

    assert 'no such port' in refusal(tmp_path / 'nowhere')
    (tmp_path / 'file').write_text('')
    assert 'cannot be opened as a serial line' in refusal(tmp_path / 'file')
    assert 'cannot connect' in refusal('tcp://127.0.0.1:9')
    _, line, robot = rig()
    robot.connect()
    assert 'busy' in refusal(line.path)
    for name, baud, streaming in (('laser', 9600, True), ('fast', 500000, False)):
        scanner = Lms200Scanner(lambda: None, baud=baud, streaming=streaming)
        with SerialLine(scanner, tmp_path / name) as laser:
            assert 'a SICK laser is at this port' in refusal(laser.path, base_baud=9600)


def test_velocities_are_kept_within_the_maximum(rig):
    device, _, robot = rig(config={'maximum_speed': 0.3, 'maximum_turn_rate': 0.5})
    robot.connect()
    robot.enable_motors(True)
    run(robot, 0.2, (2.0, -3.0))
    assert device.commanded == pytest.approx((0.3, -math.radians(29)), abs=0.01)


def test_a_clock_that_still_stands_at_zero_gives_stamps(rig):
    _, _, robot = rig(clock=lambda: 0.0)  # simulated time before its first tick
    robot.connect()
    states = run(robot, 1.0, until=lambda _: True)
    assert [state.odometry.stamp for state in states] == [0.0] * len(states)
    assert states


def test_every_kind_of_robot_drives_the_distance_it_reports(rig):
    for subclass in ('p3at', 'amigo'):
        device, line, robot = rig(subclass=subclass, baud=115200, config={'base_baud': 115200})
        robot.connect()
        robot.enable_motors(True)
        run(robot, 2.0, until=lambda _: True)  # where odometry begins
        state = run(robot, 5.0, (0.7, 0.4), until=lambda s: s.odometry.pose.x > 0.15)[-1]
        assert state.linear == pytest.approx(device.body.velocity()[0], abs=0.15)
        robot.close()
        last, truth = robot._odometry.pose, device.odometry()
        assert last == pytest.approx(truth, abs=0.004), subclass
        line.stop()


def test_calibration_is_sent_where_it_is_set(rig):
    settings = {'ticks_mm': 140, 'rev_count': 18000, 'drift_factor': -200}
    for config in ({}, settings):
        device, line, robot = rig(baud=115200, config={'base_baud': 115200, **config})
        robot.connect()
        assert run(robot, 2.0, until=lambda _: True)
        sent = {command: given for _, command, given in device.commands}
        found = [
            sent.get(command)
            for command in (Command.TICKSMM, Command.REVCOUNT, Command.DRIFTFACTOR)
        ]
        assert found == (list(config.values()) or [None] * 3)
        robot.close()
        line.stop()


def test_old_packet_types_stuck_bumpers_and_a_battery_of_24_volts(rig):
    device, _, robot = rig(
        old_types=True, config={'ignored_front_bumpers': 0b101, 'bump_stall': 0}
    )
    # a P3-DX has five segments: the other two bits are not bumpers
    device.faults.front_bumpers, device.faults.rear_bumpers = 0b1100111, 0b1000001
    device.battery = 27.1  # more than fits into the first byte
    robot.connect()
    state = run(robot, 2.0, until=lambda _: True)[-1]
    assert (state.front_bumpers, state.rear_bumpers) == (0b010, 0b1)
    assert robot.statistics()['ignored_front_bumpers'] == '101'
    assert state.battery == pytest.approx(27.1)
    assert (Command.BUMPSTALL, 0) in [(command, given) for _, command, given in device.commands]


def test_a_robot_left_at_another_baud_rate_than_base_baud_is_found_and_named(rig, caplog):
    _, _, robot = rig(baud=38400, config={'base_baud': 9600})
    with caplog.at_level(logging.WARNING):
        robot.connect()
    assert robot.last_baud == 38400
    assert 'found at 38400 Bd, not at base_baud 9600' in caplog.text


def test_the_odometry_frame_continues_in_the_next_driver_while_the_robot_has_power(rig, tmp_path):
    settings = {'odometry_file': str(tmp_path / 'ros' / 'odometry.json'), 'base_baud': 115200}
    device, line, robot = rig(baud=115200, counters=(32700, 5), config=settings)
    robot.connect()
    robot.enable_motors(True)
    run(robot, 2.0, until=lambda _: True)  # where odometry begins
    run(robot, 5.0, (0.7, 0.3), until=lambda s: s.odometry.pose.x > 0.5)
    robot._port.close()  # as after SIGKILL: it rolls on until the next driver comes
    robot._port = None
    following = driver(line.path, **settings)
    following.connect()
    state = run(following, 3.0, until=lambda s: s.linear == 0.0)[-1]
    state = run(following, 2.0, until=lambda _: True)[-1]
    assert state.odometry.pose == pytest.approx(device.odometry(), abs=0.0011)
    assert state.odometry.pose.x > 0.6
    assert following.statistics()['odometry_frame'] == 'continued'
    covariance = state.odometry.covariance
    assert covariance[0, 0] > 0.0
    following.close()
    device.reset(time.monotonic())  # switched off and on
    third = driver(line.path, **settings)
    assert wait(lambda: connects(third), 10.0)
    state = run(third, 2.0, until=lambda _: True)[-1]
    assert state.odometry.pose == (0.0, 0.0, 0.0)
    assert third.statistics()['odometry_frame'] == 'new'
    assert not state.odometry.covariance.any()
    third.close()
    (tmp_path / 'ros' / 'odometry.json').write_text('{"robot": 7')
    last = driver(line.path, **settings)
    last.connect()  # a damaged file costs the frame only
    assert run(last, 2.0, until=lambda _: True)[-1].odometry.pose == (0.0, 0.0, 0.0)
    last.close()


def test_a_network_address_without_port_is_that_of_a_robot():
    server = socket.socket()
    server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        server.bind(('127.0.0.1', 8101))
    except OSError:
        server.close()
        pytest.skip('TCP port 8101 is in use')
    server.close()
    with SerialLine(ArcosRobot(KinematicBody()), tcp_port=8101):
        robot = driver('TCP://127.0.0.1')
        assert robot.connect().subclass == 'p3dx-sh'
        robot.close()
    for bad in ('tcp://', 'tcp://:8101', 'tcp://host:x', 'tcp://host:99999', 'tcp://h/p'):
        with pytest.raises(VehicleError, match=r"expected 'tcp://host' or 'tcp://host:port'"):
            driver(bad).connect()
