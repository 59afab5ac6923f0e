import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from explore_slam.errors import VehicleError
from explore_slam.geometry import Pose2
from explore_slam.simulation.emulators.arcos_robot import ArcosRobot
from explore_slam.simulation.emulators.kinematic_body import KinematicBody
from explore_slam.vehicle.arcos_status import (
    CounterOdometry,
    StatusPacket,
    counter_difference,
    parse_configuration,
    parse_identity,
    parse_status,
    scale_factors,
)
from explore_slam.vehicle.pioneer_models import MODELS, robot_model


def status(x=0, y=0, heading=0, payload_sonar=b'\x00', rest=b''):
    return (
        b'\x32' + x.to_bytes(2, 'little') + y.to_bytes(2, 'little')
        + heading.to_bytes(2, 'little', signed=True)
        + (-50).to_bytes(2, 'little', signed=True) + (70).to_bytes(2, 'little', signed=True)
        + b'\x7b\x05\x08' + bytes(2) + b'\x21\x00' + b'\x2d' + payload_sonar + rest
    )  # fmt: skip


def test_a_status_packet_is_read_to_the_last_field():
    sonar = b'\x02' + b'\x03' + (1234).to_bytes(2, 'little') + b'\x0f' + (88).to_bytes(2, 'little')
    rest = (
        bytes(5)
        + (126).to_bytes(2, 'little')
        + b'\x01'
        + (-300).to_bytes(2, 'little', signed=True)
        + (5).to_bytes(2, 'little')
        + bytes(2)
        + b'\xf6'
        + b'\x50'
    )
    packet = parse_status(status(5, 65535, -1024, sonar, rest))
    assert isinstance(packet, StatusPacket)
    assert (packet.moving, packet.x, packet.y, packet.heading) == (False, 5, 65535, -1024)
    assert (packet.left_velocity, packet.right_velocity) == (-50, 70)
    assert packet.left_stall
    assert not packet.right_stall
    assert (packet.rear_bumpers, packet.front_bumpers) == (0b10, 0b100)
    assert packet.motors_on
    assert packet.emergency_stop
    assert packet.sonar == {3: 1234, 15: 88}
    assert packet.battery == pytest.approx(12.6)
    assert packet.charge_state == 1
    assert packet.rotational_velocity == pytest.approx(math.radians(-30))
    assert (packet.faults, packet.temperature, packet.state_of_charge) == (5, -10, 80)


@pytest.mark.parametrize('length', range(25))
def test_trailing_fields_are_optional(length):
    whole = status() + bytes(25)
    packet = parse_status(whole[: 20 + length])
    assert packet is not None
    assert (packet.rotational_velocity is None) == (length < 10)


@given(st.binary(max_size=250))
def test_anything_may_be_parsed(data):
    for head in (b'\x32', b'\x33', b'\x20', b'\x02', b''):
        parse_status(head + data)
        parse_configuration(head + data)
        if head + data:
            parse_identity(head + data)


@pytest.mark.parametrize(('byte', 'degrees'), [(0, 0), (1, 1), (127, 127), (128, -128), (255, -1)])
def test_temperatures_are_signed_bytes(byte, degrees):
    rest = bytes(5) + bytes(9) + bytes([byte])
    assert parse_status(status(rest=rest)).temperature == degrees


@pytest.mark.parametrize('length', [0, 1, 2, 3, 4, 5, 7, 9, 10, 11])
def test_each_trailing_field_needs_its_bytes(length):
    packet = parse_status(status(rest=bytes(5) + bytes(length)))
    present = {
        'charge_state': 3, 'rotational_velocity': 5, 'faults': 7, 'temperature': 10,
        'state_of_charge': 11,
    }  # fmt: skip
    for name, needed in present.items():
        assert (getattr(packet, name) is not None) == (length >= needed), name
    assert packet.battery == pytest.approx(12.3 if length < 2 else 0.0)


def test_a_packet_may_end_with_its_last_sonar_reading():
    packet = parse_status(status(payload_sonar=b'\x01' + b'\x07' + (500).to_bytes(2, 'little')))
    assert packet.sonar == {7: 500}


def test_incomplete_packets_are_none():
    assert parse_status(status()[:19]) is None
    two = b'\x02' + b'\x03\x01\x02' + b'\x04\x01'  # two readings announced, the second cut
    assert parse_status(status(payload_sonar=two)) is None
    assert parse_status(b'\x34' + status()[1:]) is None
    whole = ArcosRobot(KinematicBody()).configuration_payload()
    assert parse_configuration(whole[:20]) is None
    assert parse_configuration(b'\x21' + whole[1:]) is None


def test_identity():
    assert parse_identity(b'\x02MyBot\0Pioneer\0p3dx-sh\0') == ('MyBot', 'Pioneer', 'p3dx-sh')
    assert parse_identity(b'\x02MyBot') == ('MyBot', '', '')


def test_configuration_of_the_emulator():
    robot = ArcosRobot(KinematicBody(), name='Bob')
    configuration = parse_configuration(robot.configuration_payload())
    assert configuration is not None
    assert (configuration.subclass, configuration.name) == ('p3dx-sh', 'Bob')
    assert (configuration.robot_class, configuration.serial_number) == ('Pioneer', 'SIM_0001')
    assert (configuration.rotational_top, configuration.translational_top) == (500, 2200)
    assert configuration.rotational_acceleration_top == 300
    assert configuration.translational_acceleration_top == 2000
    assert (configuration.status_period_ms, configuration.watchdog_ms) == (100, 2000)


def test_scale_factors_of_known_unknown_and_given():
    assert scale_factors('p3dx').distance == 0.485
    assert scale_factors('p3dx-sh').distance == 1.0
    assert scale_factors('P3DX-SH').angle == pytest.approx(2 * math.pi / 4096)
    assert scale_factors('p3at', 0.47).distance == 0.47
    assert scale_factors('robo7', 0.47).distance == 0.47
    with pytest.raises(VehicleError, match=r"unknown subclass 'robo7'.*set distance_factor"):
        scale_factors('robo7')


@pytest.mark.parametrize(
    ('written', 'known'),
    [
        ('P3-DX', 'p3dx'),
        ('p3-at-SH', 'p3at-sh'),
        ('AmigoBot-sh', 'amigo-sh'),
        ('AmigoBot', 'amigo'),
        ('PeopleBot_sh', 'peoplebot-sh'),
        (' p2at8+ ', 'p2at8+'),
    ],
)
def test_a_known_subclass_may_be_written_in_other_ways(written, known, caplog):
    assert robot_model(written) is MODELS[known]
    assert not caplog.text


@pytest.mark.parametrize(
    ('unknown', 'taken', 'distance'),
    [('AmigoBot-sh-x', 'amigo-sh', 1.0), ('p3at-x', 'p3at', 0.465), ('pion-sh', 'p3dx', 1.0)],
)
def test_an_unknown_subclass_is_taken_as_the_kind_that_it_begins_with(
    unknown, taken, distance, caplog
):
    found = robot_model(unknown)
    assert found.factors == MODELS[taken].factors._replace(distance=distance)
    assert (found.sonar, found.laser) == (MODELS[taken].sonar, MODELS[taken].laser)
    assert f'taken as {taken} with {distance:.3f} mm' in caplog.text


@pytest.mark.parametrize('unknown', ['p2at8x', 'peoplebot', 'p3atiw', ''])
def test_an_unknown_board_needs_a_distance_factor_and_keeps_the_rest_of_its_kind(unknown):
    with pytest.raises(VehicleError, match=f"unknown subclass '{unknown}'.*set distance_factor"):
        robot_model(unknown)
    kind = {'p2at8x': 'p2at8', 'p3atiw': 'p3at'}.get(unknown, 'p3dx')
    factors = MODELS[kind].factors._replace(distance=0.9)
    assert robot_model(unknown, 0.9).factors == factors


@given(st.integers(0, 65535), st.integers(-16383, 16383))
def test_counter_difference_through_wrap_around(start, step):
    for bits in (15, 16):
        mask = (1 << bits) - 1
        assert counter_difference((start + step) & mask, start & mask) == step


@pytest.mark.parametrize('wrap_bits', [15, 16])
@pytest.mark.parametrize('subclass', ['p3dx', 'p3dx-sh'])
def test_two_kilometres_through_wrap_arounds_to_a_millimetre(subclass, wrap_bits):
    time = 0.0
    body = KinematicBody(clock=lambda: time, acceleration=100.0, turn_acceleration=100.0)
    robot = ArcosRobot(body, subclass=subclass, counters=(32760, 10), wrap_bits=wrap_bits)
    odometry = CounterOdometry(scale_factors(subclass))
    distance, steps = 0.0, 0
    odometry.update(parse_status(robot.status_payload()))
    while distance < 2000.0:
        body.set_velocity(1.4, 0.01 * math.sin(time / 60.0))
        time += 0.7  # about 1 m between packets: some were lost
        distance += 1.4 * 0.7
        steps += 1
        pose = odometry.update(parse_status(robot.status_payload()))
    truth = robot.odometry()
    assert math.hypot(truth.x, truth.y) > 1000.0  # tens of wrap-arounds
    assert math.hypot(pose.x - truth.x, pose.y - truth.y) < 0.001
    assert abs(math.remainder(pose.theta - truth.theta, math.tau)) < 0.001


def test_a_robot_that_was_reset_does_not_move_the_pose():
    factors = scale_factors('p3dx-sh')
    odometry = CounterOdometry(factors)
    odometry.update(parse_status(status(1000, 0, 0)))
    before = odometry.update(parse_status(status(2000, 0, 1024)))
    assert before == pytest.approx(Pose2(1.0, 0.0, math.pi / 2))
    odometry.restart(factors)
    assert odometry.update(parse_status(status(7, 9, 0))) == pytest.approx(before)
    after = odometry.update(parse_status(status(507, 9, 0)))  # half a metre ahead, as it stands
    assert after == pytest.approx(Pose2(1.0, 0.5, math.pi / 2))
    jumped = odometry.update(parse_status(status(15000, 9, 0)))  # a reset in the session
    assert jumped == pytest.approx(after)
