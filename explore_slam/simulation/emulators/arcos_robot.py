"""The robot side of ARCOS: an emulated Pioneer controller that moves any simulated body.

It accepts what ARIA and other clients send (WMS2 junk, SYNC0-2, OPEN, CONFIG, HOSTBAUD, ...).
Source: Pioneer 3 operations manual (MobileRobots), "Client-Server Communication".
"""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.vehicle.arcos_packets import (
    BAUD_CODES,
    RATE_CHANGE_DELAY,
    RATE_CHANGE_TIMEOUT,
    Command,
    PacketDecoder,
    decode_command,
    encode_packet,
)
from explore_slam.vehicle.arcos_status import CONFIG_PACKET, MOVING, STOPPED
from explore_slam.vehicle.pioneer_models import MODELS, known_model

STATUS_PERIOD = 0.1  # s between status packets
WATCHDOG = 2.0  # s without a packet of the host until the robot stops
_REBOOT = 1.0  # s that a reset takes
# limits in the configuration of a P3-DX: °/s, mm/s, °/s², mm/s², PWM
_TOPS = (500, 2200, 300, 2000, 500)
_SETV_DEFAULT, _SETRV_DEFAULT = 2200, 300  # mm/s, °/s until SETV and SETRV set other limits
_VEL2_UNIT = 0.02  # m/s
_MOVING = 0.001  # m/s, rad/s
_DRIFT_UNIT = 8192
_CALIBRATIONS = {
    Command.TICKSMM: 'ticks_mm',
    Command.REVCOUNT: 'rev_count',
    Command.DRIFTFACTOR: 'drift_factor',
}
_BAUD_OF_CODE = {code: baud for baud, code in BAUD_CODES.items()}


class Calibration(NamedTuple):
    """Odometry calibration (FLASH parameters of the robot).

    ticks_mm: encoder ticks per mm. rev_count: differential ticks of half a turn.
    drift_factor: correction of the left wheel, 1/8192.
    """

    ticks_mm: int = 128
    rev_count: int = 16570
    drift_factor: int = 0


_STOCK = Calibration()


def _configuration(calibration: Calibration) -> bytes:
    """Return the fields after the name in a CONFIG packet of a P3-DX as delivered."""
    drift = calibration.drift_factor & 0xFFFF
    layout: tuple[tuple[int, tuple[int, ...]], ...] = (
        # status period (ms), rates of host and aux, gripper and front sonar, rear sonar
        (1, (round(1000 * STATUS_PERIOD), 0, 0)), (2, (0, 1)), (1, (0,)),
        # low battery (0.1 V), counts per turn, watchdog (ms), motor packets
        (2, (110, calibration.rev_count, round(1000 * WATCHDOG))), (1, (0,)),
        # stall value and count, joystick speeds, maximum turn and speed
        (2, (200, 200, 750, 100, 150, 1000)),
        # turn acceleration, deceleration (°/s²), gains; the same of translation (mm/s²)
        (2, (100, 100, 40, 20, 0, 300, 300, 40, 20, 0)),
        # front and rear bumpers, charger, sonar cycle (2 ms), reset of the rate, gyro
        (1, (0, 0, 0, 20, 0, 0)),
        # drift, rates of aux 2 and 3, ticks per mm, shutdown voltage (0.1 V)
        (2, (drift,)), (1, (0, 0)), (2, (calibration.ticks_mm, 100)),
    )  # fmt: skip
    numbers = b''.join(
        value.to_bytes(size, 'little') for size, values in layout for value in values
    )
    return numbers + b'3.0\0' + bytes(4)  # firmware, gyro factors


class Body(Protocol):
    """What the controller moves: a simulated vehicle, or anything with these methods."""

    def set_velocity(self, linear: float, angular: float) -> None:
        """Command a velocity (m/s, rad/s)."""

    def odometry(self) -> Pose2:
        """Return the wheel odometry (m, rad), in any fixed frame."""

    def velocity(self) -> tuple[float, float]:
        """Return the present velocity (m/s, rad/s)."""


@dataclass
class RobotFaults:
    """Faults of the robot; may be changed at any time."""

    left_stall: bool = False
    right_stall: bool = False
    front_bumpers: int = 0
    rear_bumpers: int = 0
    emergency_stop: bool = False
    faults: int = 0


@dataclass
class _Session:
    """State of the handshake and of the session."""

    open: bool = False
    synchronized: int = 0
    last_packet: float = -math.inf
    next_status: float = 0.0
    motors: bool = False
    sonar: bool = True
    velocity: tuple[float, float] = (0.0, 0.0)
    calibration: Calibration = _STOCK
    limits: dict[int, int] = field(default_factory=dict)


class ArcosRobot:
    """An emulated Pioneer (protocol SerialDevice).

    subclass: of pioneer_models.MODELS, whose units it reports; another one has those of a p3dx
    with distance_factor (mm per count).
    counters: x and y at power-on (counts). wrap_bits: 15 or 16, as firmware differs.
    flash: calibration stored in the robot. wheels: the one that would be right for its wheels;
    where they differ, it reports wrong distances and headings until the host sends another one.
    old_types: status packets have the types 0x30 and 0x31.
    The attribute sonar (transducer index -> range in m) may be changed at any time.
    """

    def __init__(
        self,
        body: Body,
        *,
        subclass: str = 'p3dx-sh',
        name: str = 'Simulated',
        counters: tuple[int, int] = (0, 0),
        wrap_bits: int = 15,
        baud: int = 9600,
        distance_factor: float = 0.0,
        flash: Calibration | None = None,
        wheels: Calibration | None = None,
        old_types: bool = False,
    ) -> None:
        self.body = body
        self.identity = (name, 'Pioneer', subclass)
        self.faults = RobotFaults()
        self.sonar: Mapping[int, float] = {}
        self.battery = 12.6  # V
        self.commands: deque[tuple[float, int, int | bytes | None]] = deque(maxlen=1000)
        self.sent = 0  # status packets
        self._factors = (known_model(subclass) or MODELS['p3dx']).factors
        if distance_factor > 0.0:
            self._factors = self._factors._replace(distance=distance_factor)
        self.flash = flash or _STOCK
        self._wheels = wheels or _STOCK
        self._types = (STOPPED - 2, MOVING - 2) if old_types else (STOPPED, MOVING)
        self._counted = IDENTITY  # what the counters show
        self._measured = body.odometry()  # up to where they have counted
        self._counters = counters
        self._mask = (1 << wrap_bits) - 1
        self._origin = body.odometry()
        self._power_baud = self.baud = baud
        self._rate_change: tuple[float, int] | None = None
        self._probation = math.inf
        self._decoder = PacketDecoder()
        self._session = _Session(calibration=self.flash)
        self._outbox = bytearray()
        self._booted = -math.inf

    # -- state ------------------------------------------------------------------------------------

    @property
    def motors_on(self) -> bool:
        """Whether the motors have power."""
        return self._session.motors

    @property
    def session_open(self) -> bool:
        """Whether a client has opened a session."""
        return self._session.open

    @property
    def commanded(self) -> tuple[float, float]:
        """The velocity commanded by the host (m/s, rad/s)."""
        return self._session.velocity

    def odometry(self) -> Pose2:
        """Return the robot's pose since power-on or SETO, without wrap-around and rounding."""
        return self._origin.between(self.body.odometry())

    def reset(self, now: float) -> None:
        """Restart as after a loss of power: session, counters and motors are reset."""
        self._end_session()
        self._set_origin()
        self.baud = self._power_baud
        self._booted = now + _REBOOT
        self._outbox.clear()

    # -- the device -------------------------------------------------------------------------------

    def receive(self, data: bytes, now: float) -> None:
        """Receive bytes of the host."""
        if now < self._booted:
            return
        for payload in self._decoder.feed(data):
            self._session.last_packet = now
            self._probation = math.inf
            self._handle(*decode_command(payload), payload, now)

    def transmit(self, now: float) -> bytes:
        """Return the bytes that the robot sends now; run its watchdogs."""
        if now < self._booted:
            return b''
        session = self._session
        if self._rate_change is not None and now >= self._rate_change[0]:
            self.baud, self._rate_change = self._rate_change[1], None
            self._probation = now + RATE_CHANGE_TIMEOUT
        if now > self._probation:
            self.baud, self._probation = self._power_baud, math.inf
        if session.open and now - session.last_packet > WATCHDOG and any(session.velocity):
            session.velocity = (0.0, 0.0)
        self._drive()
        if session.open and now >= session.next_status:
            behind = now - session.next_status > STATUS_PERIOD
            session.next_status = (now if behind else session.next_status) + STATUS_PERIOD
            self._outbox += encode_packet(self.status_payload())
            self.sent += 1
        data = bytes(self._outbox)
        self._outbox.clear()
        return data

    def _drive(self) -> None:
        """Pass the velocity to the body, zero while a fault or a lack of power stops it."""
        f = self.faults
        halted = f.emergency_stop or f.left_stall or f.right_stall or not self._session.motors
        if f.emergency_stop:
            self._session.motors = False
        self.body.set_velocity(*((0.0, 0.0) if halted else self._session.velocity))

    def _set_origin(self) -> None:
        """Set position and heading to zero."""
        self._origin = self._measured = self.body.odometry()
        self._counted = IDENTITY

    def _count(self) -> Pose2:
        """Return the pose that the counters show: what the wheels did, as it is calibrated."""
        now = self.body.odometry()
        step = self._measured.between(now)
        self._measured = now
        used, right = self._session.calibration, self._wheels
        if used == right:
            self._counted = self._counted.compose(step)
            return self._counted
        half_base = 0.001 / self._factors.difference  # m
        along = math.copysign(math.hypot(step.x, step.y), step.x)
        left = along - half_base * step.theta
        drift = left * (used.drift_factor - right.drift_factor) / _DRIFT_UNIT
        length = (along + 0.5 * drift) * right.ticks_mm / used.ticks_mm
        turn = (step.theta - 0.5 * drift / half_base) * right.rev_count / used.rev_count
        reach = Pose2(length * math.cos(0.5 * turn), length * math.sin(0.5 * turn), turn)
        self._counted = self._counted.compose(reach)
        return self._counted

    def _end_session(self) -> None:
        self._session = _Session(calibration=self.flash)
        self.body.set_velocity(0.0, 0.0)

    def _handle(
        self, command: int, argument: int | bytes | None, payload: bytes, now: float
    ) -> None:
        self.commands.append((now, command, argument))
        session = self._session
        if not session.open:
            self._synchronize(command, payload, now)
        elif command == Command.CLOSE:
            self._end_session()
            self.baud = self._power_baud
        elif command in (Command.STOP, Command.ESTOP):
            session.velocity = (0.0, 0.0)
        elif command == Command.SETO:
            self._set_origin()
        elif isinstance(argument, int):
            self._obey(command, argument)

    def _synchronize(self, command: int, payload: bytes, now: float) -> None:
        session = self._session
        if command == session.synchronized and command < 2:
            session.synchronized += 1
            self._outbox += encode_packet(payload)
        elif command == 2 and session.synchronized == 2:
            names = b'\0'.join(text.encode() for text in self.identity) + b'\0'
            self._outbox += encode_packet(bytes([2]) + names)
            session.synchronized = 3
        elif command == Command.OPEN and session.synchronized == 3:
            session.open = True
            session.next_status = now + STATUS_PERIOD
        elif command == 0:  # a client that starts over
            session.synchronized = 1
            self._outbox += encode_packet(payload)
        else:
            session.synchronized = 0
            self._outbox += encode_packet(bytes([255]))

    def _obey(self, command: int, argument: int) -> None:
        """Execute a command with an integer argument; unknown ones are ignored."""
        session = self._session
        linear, angular = session.velocity
        if command == Command.ENABLE:
            session.motors = bool(argument) and not self.faults.emergency_stop
            if not argument:
                session.velocity = (0.0, 0.0)
        elif command == Command.VEL:
            limit = session.limits.get(Command.SETV, _SETV_DEFAULT)
            session.velocity = (0.001 * max(-limit, min(limit, argument)), angular)
        elif command == Command.RVEL:
            limit = session.limits.get(Command.SETRV, _SETRV_DEFAULT)
            session.velocity = (linear, math.radians(max(-limit, min(limit, argument))))
        elif command == Command.VEL2:
            self._obey_wheels(argument)
        elif command in (Command.SETV, Command.SETRV):
            session.limits[command] = argument
        elif command == Command.CONFIG:
            self._outbox += encode_packet(self.configuration_payload())
        elif command in _CALIBRATIONS:
            self._calibrate(_CALIBRATIONS[Command(command)], argument)
        elif command == Command.SONAR:
            session.sonar = bool(argument)
        elif command == Command.HOSTBAUD and argument in _BAUD_OF_CODE:
            self._rate_change = (
                session.last_packet + RATE_CHANGE_DELAY, _BAUD_OF_CODE[argument]
            )  # fmt: skip

    def _calibrate(self, name: str, value: int) -> None:
        """Change the calibration until the end of the session."""
        if value > 0 or name == 'drift_factor':
            self._count()  # so far with the old one
            calibration = self._session.calibration._replace(**{name: value})
            self._session.calibration = calibration

    def _obey_wheels(self, argument: int) -> None:
        """Execute VEL2: signed bytes with the speeds of left and right wheel."""
        left, right = (
            (value - 256 if value > 127 else value) * _VEL2_UNIT
            for value in ((argument >> 8) & 0xFF, argument & 0xFF)
        )
        turn = 0.5 * (right - left) * 1000.0 * self._factors.difference
        self._session.velocity = (0.5 * (left + right), turn)

    # -- packets ----------------------------------------------------------------------------------

    def status_payload(self) -> bytes:
        """Return a status packet of the present state."""
        f, factors = self.faults, self._factors
        pose = self._count()
        scale = 1000.0 / factors.distance
        x, y = (
            (round(value * scale) + start) & self._mask
            for value, start in zip(pose[:2], self._counters, strict=True)
        )
        linear, angular = self.body.velocity()
        difference = angular / factors.difference
        left, right = (
            round((1000 * linear + side * difference) / factors.velocity) for side in (-1, 1)
        )
        moving = abs(linear) > _MOVING or abs(angular) > _MOVING
        flags = int(self._session.motors) | int(f.emergency_stop) << 5
        sonar = self.sonar if self._session.sonar else {}
        flags |= 0b11110 if sonar else 0
        readings = b''.join(
            bytes([index]) + round(1000.0 * distance / factors.range).to_bytes(2, 'little')
            for index, distance in sorted(sonar.items())
        )
        return b''.join(
            (
                bytes([self._types[moving]]),
                x.to_bytes(2, 'little'),
                y.to_bytes(2, 'little'),
                _int16(round(pose.theta / factors.angle)),
                _int16(left),
                _int16(right),
                bytes([min(round(10 * self.battery), 255)]),
                bytes([f.rear_bumpers << 1 | f.left_stall]),
                bytes([f.front_bumpers << 1 | f.right_stall]),
                _int16(0),
                flags.to_bytes(2, 'little'),
                bytes([round(math.degrees(pose.theta) % 360.0 / 2.0) % 180]),
                bytes([len(sonar)]),
                readings,
                bytes(5),
                round(10 * self.battery).to_bytes(2, 'little'),
                bytes(1),
                _int16(round(10 * math.degrees(angular))),
                f.faults.to_bytes(2, 'little'),
                _int16(0),
                bytes([0x80, 0]),
            )
        )

    def configuration_payload(self) -> bytes:
        """Return a CONFIG packet with the values of a P3-DX as delivered."""
        _, robot_class, subclass = self.identity
        texts = b'\0'.join((robot_class.encode(), subclass.encode(), b'SIM_0001')) + b'\0'
        tops = b''.join(value.to_bytes(2, 'little') for value in _TOPS)
        name = self.identity[0].encode() + b'\0'
        rest = _configuration(self._session.calibration)
        return bytes([CONFIG_PACKET]) + texts + bytes(1) + tops + name + rest


def _int16(value: int) -> bytes:
    return max(-32768, min(32767, value)).to_bytes(2, 'little', signed=True)
