"""The emulated robot as a client other than this project's sees it: bytes in, bytes out."""

import math

import pytest

from explore_slam.simulation.emulators.arcos_robot import (
    STATUS_PERIOD,
    WATCHDOG,
    ArcosRobot,
    Calibration,
)
from explore_slam.simulation.emulators.kinematic_body import KinematicBody
from explore_slam.vehicle.arcos_packets import (
    Command,
    PacketDecoder,
    encode_command,
    encode_packet,
)
from explore_slam.vehicle.arcos_status import parse_status
from explore_slam.vehicle.pioneer_models import MODELS


class Client:
    """A client on a clock of its own."""

    def __init__(self, **options):
        self.now = 0.0
        self.robot = ArcosRobot(KinematicBody(clock=lambda: self.now), **options)
        self.decoder = PacketDecoder()

    def send(self, command, argument=None):
        self.robot.receive(encode_command(command, argument), self.now)
        return self.run(0.0)

    def run(self, seconds):
        payloads = []
        for _ in range(round(seconds / 0.01) + 1):
            payloads += self.decoder.feed(self.robot.transmit(self.now))
            self.now += 0.01
        return payloads

    def open(self):
        self.robot.receive(b'WMS2\r', self.now)  # what ARIA sends to radio modems
        for step in (0, 1, 2):
            self.send(step)
        self.send(Command.OPEN)
        return self


def test_the_whole_conversation_of_a_well_known_client():
    client = Client(name='Amy')
    client.robot.receive(b'WMS2\r', 0.0)
    assert client.send(0) == [b'\x00']
    assert client.send(1) == [b'\x01']
    assert client.send(2) == [b'\x02Amy\0Pioneer\0p3dx-sh\0']
    assert client.run(0.5) == []  # no status before OPEN
    client.send(Command.OPEN)
    [configuration] = [p for p in client.send(Command.CONFIG, 1) if p[0] == 0x20]
    assert b'p3dx-sh\0' in configuration
    for command, argument in (
        (Command.PULSE, None), (Command.BATTERYINFO, 1), (Command.SETV, 3000),
        (Command.SETA, 300), (Command.SETA, -300), (Command.SETRV, 150),
        (Command.SETRA, 100), (Command.SETRA, -100), (Command.ENABLE, 1),
    ):  # fmt: skip
        client.send(command, argument)
    for _ in range(4):
        client.send(Command.VEL, 400)
        client.send(Command.RVEL, 20)
        packets = [parse_status(p) for p in client.run(0.5)]
    assert len(packets) == 5
    assert packets[-1].moving
    assert packets[-1].motors_on
    assert packets[-1].left_velocity + packets[-1].right_velocity == pytest.approx(800, abs=2)
    assert packets[-1].rotational_velocity == pytest.approx(math.radians(20), abs=0.01)
    client.send(Command.ENABLE, 0)
    client.send(Command.CLOSE)
    assert client.run(1.0) == []
    assert not client.robot.session_open


def test_a_handshake_out_of_step_is_answered_with_255():
    client = Client()
    assert client.send(1) == [b'\xff']
    client.send(0)
    assert client.send(2) == [b'\xff']
    assert client.send(0) == [b'\x00']


def test_status_packets_every_100_ms():
    client = Client().open()
    assert len(client.run(10.0)) == pytest.approx(10.0 / STATUS_PERIOD, abs=1)


def test_without_motors_nothing_moves():
    client = Client().open()
    client.send(Command.VEL, 500)
    client.run(1.0)
    assert client.robot.body.velocity() == (0.0, 0.0)


def test_the_watchdog_stops_a_robot_whose_host_is_silent():
    client = Client().open()
    client.send(Command.ENABLE, 1)
    client.send(Command.VEL, 500)
    client.run(WATCHDOG - 0.1)
    assert client.robot.body.velocity()[0] == pytest.approx(0.5)
    client.run(1.0)
    assert client.robot.body.velocity()[0] == 0.0


@pytest.mark.parametrize('wrap_bits', [15, 16])
def test_counters_wrap(wrap_bits):
    client = Client(counters=((1 << wrap_bits) - 5, 0), wrap_bits=wrap_bits).open()
    client.send(Command.ENABLE, 1)
    client.send(Command.VEL, 100)
    values = [parse_status(p).x for p in client.run(1.5)]
    assert values[0] > values[-1]
    assert values[-1] < 200


def test_faults_and_the_red_button():
    client = Client().open()
    client.send(Command.ENABLE, 1)
    client.send(Command.VEL, 300)
    client.run(1.0)
    client.robot.faults.right_stall = True
    client.robot.faults.rear_bumpers = 0b11
    packet = parse_status(client.run(0.9)[-1])
    assert packet.right_stall
    assert packet.rear_bumpers == 0b11
    assert client.robot.body.velocity() == (0.0, 0.0)
    client.robot.faults = type(client.robot.faults)(emergency_stop=True)
    packet = parse_status(client.run(0.3)[-1])
    assert packet.emergency_stop
    assert not packet.motors_on


def test_vel2_estop_seto_and_a_reset():
    client = Client().open()
    client.send(Command.ENABLE, 1)
    client.send(Command.VEL2, 10 << 8 | 20)  # 200 and 400 mm/s
    client.run(1.0)
    assert client.robot.commanded[0] == pytest.approx(0.3)
    assert client.robot.commanded[1] == pytest.approx(0.56)
    client.send(Command.ESTOP)
    assert client.robot.commanded == (0.0, 0.0)
    client.run(1.0)
    client.send(Command.SETO)
    assert client.robot.odometry() == (0.0, 0.0, 0.0)
    client.robot.reset(client.now)
    assert client.run(2.0) == []
    assert client.send(0) == [b'\x00']


def test_garbage_between_packets_is_survived():
    client = Client().open()
    client.robot.receive(b'\xfa\xfb\xff' + bytes(range(256)), client.now)
    client.robot.receive(encode_packet(b'\xee\x3b\x01\x00'), client.now)  # unknown command
    client.robot.receive(bytes(250), client.now)
    client.send(Command.ENABLE, 1)
    assert client.robot.motors_on


@pytest.mark.parametrize(
    ('wheels', 'mend'),
    [
        (Calibration(ticks_mm=140), (Command.TICKSMM, 140)),
        (Calibration(rev_count=18000), (Command.REVCOUNT, 18000)),
        (Calibration(drift_factor=200), (Command.DRIFTFACTOR, 200)),
    ],
)
def test_a_wrong_calibration_shows_until_the_host_sends_the_right_one(wheels, mend):
    errors = []
    for commands in ([], [mend]):
        client = Client(wheels=wheels).open()
        for command in (*commands, (Command.ENABLE, 1), (Command.VEL, 500), (Command.RVEL, 20)):
            client.send(*command)
        last = [parse_status(p) for p in client.run(3.0)][-1]
        truth = client.robot.odometry()
        heading = math.tau / 4096 * last.heading
        apart = math.dist((0.001 * last.x, 0.001 * last.y), truth[:2])
        errors.append(apart + abs(math.remainder(heading - truth.theta, math.tau)))
    assert errors[0] > 0.04
    assert errors[1] < 0.01  # a packet old


def test_every_known_kind_of_robot_reports_in_its_own_units():
    for subclass, model in MODELS.items():
        client = Client(subclass=subclass).open()
        client.send(Command.ENABLE, 1)
        client.send(Command.VEL, 300)
        last = [parse_status(p) for p in client.run(2.0)][-1]
        moved = 0.001 * model.factors.distance * last.x
        assert moved == pytest.approx(client.robot.odometry().x, abs=0.035), subclass
        assert model.factors.velocity * last.left_velocity == pytest.approx(300, abs=1)
        assert (model.factors.distance == 1.0) == ('-sh' in subclass or subclass == 'researchpb')
        assert 0.18 <= model.factors.wheel_base <= 0.63
        assert model.laser is None or 0.0 < model.laser[0] < 0.3
