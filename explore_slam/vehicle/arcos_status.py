"""ARCOS server packets (status, configuration), scale factors, odometry from counters.

Source: Pioneer 3 operations manual (MobileRobots), "Server Information Packets".
"""

import logging
import math
from dataclasses import dataclass
from typing import NamedTuple

from explore_slam.geometry import IDENTITY, Pose2, wrap_angle
from explore_slam.vehicle.pioneer_models import ScaleFactors, robot_model

STOPPED, MOVING = 0x32, 0x33  # types of a status packet (SIP)
_STATUS_TYPES = range(0x30, 0x34)  # 0x30 and 0x31 come from older firmware; odd while moving
CONFIG_PACKET = 0x20
_log = logging.getLogger(__name__)
_LONGEST_STEP = 3.0  # m between two status packets, 4 s at top speed; more is a reset robot
# m and rad from zero within which counters are those of a robot that was switched on just now, and
# perhaps pushed since; counters of a robot that was in use are rarely there
_ORIGIN = 0.1
COUNTER_BITS = 15  # firmware wraps x and y at 15 or at 16 bits: the low 15 are always valid
_BATTERY_UNIT = 0.1  # V
_CHARGING = range(1, 5)  # charge states; 0: not charging, 255: unknown
_TURN_RATE_UNIT = 0.1  # °/s


def scale_factors(subclass: str, distance: float = 0.0) -> ScaleFactors:
    """Return the scale factors of a robot's subclass.

    distance: overrides the distance factor (mm per count) if > 0.
    Raises VehicleError for an unknown subclass without a distance factor.
    """
    return robot_model(subclass, distance).factors


@dataclass(frozen=True)
class StatusPacket:
    """A server information packet (SIP) in the robot's units; absent fields are None.

    sonar: transducer index -> reading (counts).
    """

    moving: bool
    x: int
    y: int
    heading: int
    left_velocity: int
    right_velocity: int
    battery: float  # V
    left_stall: bool
    right_stall: bool
    rear_bumpers: int
    front_bumpers: int
    flags: int
    compass: int
    sonar: dict[int, int]
    charge_state: int | None = None
    rotational_velocity: float | None = None  # rad/s
    faults: int | None = None
    temperature: int | None = None
    state_of_charge: int | None = None

    @property
    def motors_on(self) -> bool:
        """Whether the motors have power (flag bit 0)."""
        return bool(self.flags & 1)

    @property
    def charging(self) -> bool:
        """Whether a charger feeds the battery (bulk, overcharge, float or balance)."""
        return self.charge_state in _CHARGING

    @property
    def emergency_stop(self) -> bool:
        """Whether the emergency stop button is pressed (flag bit 5)."""
        return bool(self.flags & 1 << 5)


def _signed(data: bytes, offset: int) -> int:
    return int.from_bytes(data[offset : offset + 2], 'little', signed=True)


def _unsigned(data: bytes, offset: int) -> int:
    return int.from_bytes(data[offset : offset + 2], 'little')


_FIXED = 20  # bytes up to and including the number of sonar readings
_IO_BYTES = 5  # gripper, analogue port, analogue, digital in, digital out


def parse_status(payload: bytes) -> StatusPacket | None:
    """Parse a status packet; None for any other or an incomplete payload. Never raises."""
    if len(payload) < _FIXED or payload[0] not in _STATUS_TYPES:
        return None
    sonar: dict[int, int] = {}
    end = _FIXED
    for _ in range(payload[19]):
        if end + 3 > len(payload):
            return None
        sonar[payload[end]] = _unsigned(payload, end + 1)
        end += 3
    rest = payload[end + _IO_BYTES :]
    counts = _unsigned(rest, 0) if len(rest) >= 2 else payload[11]
    turn_rate = math.radians(_TURN_RATE_UNIT * _signed(rest, 3)) if len(rest) >= 5 else None
    return StatusPacket(
        moving=bool(payload[0] & 1),
        x=_unsigned(payload, 1),
        y=_unsigned(payload, 3),
        heading=_signed(payload, 5),
        left_velocity=_signed(payload, 7),
        right_velocity=_signed(payload, 9),
        battery=_BATTERY_UNIT * counts,
        left_stall=bool(payload[12] & 1),
        right_stall=bool(payload[13] & 1),
        rear_bumpers=payload[12] >> 1,
        front_bumpers=payload[13] >> 1,
        flags=_unsigned(payload, 16),
        compass=payload[18],
        sonar=sonar,
        charge_state=rest[2] if len(rest) >= 3 else None,
        rotational_velocity=turn_rate,
        faults=_unsigned(rest, 5) if len(rest) >= 7 else None,
        temperature=rest[9] - 256 * (rest[9] > 127) if len(rest) >= 10 else None,
        state_of_charge=rest[10] if len(rest) >= 11 else None,
    )


class RobotIdentity(NamedTuple):
    """Identity that the robot reports at the end of the handshake."""

    name: str
    robot_class: str
    subclass: str


def parse_identity(payload: bytes) -> RobotIdentity:
    """Parse the reply to SYNC2; missing texts are ''."""
    texts = [part.decode('ascii', 'replace').strip() for part in payload[1:].split(b'\0')]
    name, robot_class, subclass = (*texts, '', '', '')[:3]
    return RobotIdentity(name, robot_class, subclass)


class RobotConfiguration(NamedTuple):
    """First fields of a CONFIG packet: limits in mm/s, °/s, mm/s² and °/s²."""

    robot_class: str
    subclass: str
    serial_number: str
    rotational_top: int
    translational_top: int
    rotational_acceleration_top: int
    translational_acceleration_top: int
    name: str
    status_period_ms: int
    watchdog_ms: int | None


def parse_configuration(payload: bytes) -> RobotConfiguration | None:
    """Parse a CONFIG packet; None for any other or an incomplete payload. Never raises."""
    if not payload or payload[0] != CONFIG_PACKET:
        return None
    parts = payload[1:].split(b'\0', 3)
    if len(parts) < 4 or len(parts[3]) < 12:
        return None
    texts = [part.decode('ascii', 'replace') for part in parts[:3]]
    numbers = parts[3]
    name, _, rest = numbers[11:].partition(b'\0')
    tops = [_unsigned(numbers, offset) for offset in (1, 3, 5, 7)]
    return RobotConfiguration(
        robot_class=texts[0],
        subclass=texts[1],
        serial_number=texts[2],
        rotational_top=tops[0],
        translational_top=tops[1],
        rotational_acceleration_top=tops[2],
        translational_acceleration_top=tops[3],
        name=name.decode('ascii', 'replace'),
        status_period_ms=rest[0] if rest else 0,
        watchdog_ms=_unsigned(rest, 12) if len(rest) >= 14 else None,
    )


class CounterState(NamedTuple):
    """Where the counters stood (x, y, heading in counts) at a pose in the odometry frame."""

    pose: Pose2
    x: int
    y: int
    heading: int


class CounterOdometry:
    """Pose in the odometry frame from the robot's counters.

    It is continuous through wrap-around of the counters and restarts of the robot.
    resumed: whether the counters at the last connection continued those known before; None if
    none were known.
    """

    def __init__(
        self, factors: ScaleFactors, start: Pose2 = IDENTITY, last: CounterState | None = None
    ) -> None:
        """Begin at the pose start.

        last: counters of an earlier driver, whose frame continues if the robot has kept counting.
        """
        self._factors = factors
        self._anchor = start  # pose in the odometry frame at which the unwrapped counters are 0
        self._counts: tuple[int, int] | None = None
        self._total = [0, 0]
        self._heading = 0
        self._last = last  # to be resumed with the next status packet
        self.resumed: bool | None = None
        self.pose = start

    @property
    def state(self) -> CounterState | None:
        """Pose and counters of the last status packet, None before the first one."""
        if self._counts is None:
            return None
        return CounterState(self.pose, *self._counts, self._heading)

    def restart(self, factors: ScaleFactors) -> None:
        """Continue from the present pose with counters of any value (another or a reset robot)."""
        self._factors = factors
        self._counts = self._last = None

    def resume(self, factors: ScaleFactors) -> None:
        """Continue after a reconnection: count what was driven meanwhile, unless it was reset."""
        self._last = self.state or self._last
        self._factors = factors
        self._counts = None

    def update(self, status: StatusPacket) -> Pose2:
        """Update with a status packet; return the pose (m, rad)."""
        scale = 0.001 * self._factors.distance
        heading = wrap_angle(self._factors.angle * status.heading)
        if self._counts is None and self._last is not None:
            self._resume(self._last, status)
        counts = (status.x, status.y)
        last = self._counts or counts
        steps = [counter_difference(*pair) for pair in zip(counts, last, strict=True)]
        jumped = max(map(abs, steps)) * scale > _LONGEST_STEP
        if self._counts is None or jumped:
            if jumped:
                _log.warning(
                    'odometry: counters jumped by %s, continuing from the last pose', steps
                )
            self._total = [0, 0]
            self._anchor = self.pose.compose(Pose2(0.0, 0.0, heading).inverse())
        else:
            self._total = [total + step for total, step in zip(self._total, steps, strict=True)]
        self._counts = counts
        self._heading = status.heading
        driven = Pose2(scale * self._total[0], scale * self._total[1], heading)
        self.pose = self._anchor.compose(driven)
        return self.pose

    def _resume(self, last: CounterState, status: StatusPacket) -> None:
        """Take over the pose at which the counters stood, if the robot has kept counting."""
        self._last = None
        scale = 0.001 * self._factors.distance

        def distance_from(x: int, y: int) -> float:
            steps = counter_difference(status.x, x), counter_difference(status.y, y)
            return scale * math.hypot(*steps)

        def at_origin(x: int, y: int, heading: int) -> bool:
            apart = scale * math.hypot(counter_difference(x, 0), counter_difference(y, 0))
            turn = abs(wrap_angle(self._factors.angle * heading))
            return apart < _ORIGIN and turn < _ORIGIN

        reset = at_origin(status.x, status.y, status.heading) and not at_origin(*last[1:])
        self.resumed = not reset and distance_from(last.x, last.y) <= _LONGEST_STEP
        if not self.resumed:
            return
        heading = wrap_angle(self._factors.angle * last.heading)
        self._counts = (last.x, last.y)
        self._total = [0, 0]
        self._anchor = last.pose.compose(Pose2(0.0, 0.0, heading).inverse())


def counter_difference(value: int, last: int, bits: int = COUNTER_BITS) -> int:
    """Return value - last modulo 2^bits, as a signed number of smallest magnitude."""
    half = 1 << (bits - 1)
    return ((value - last + half) & ((1 << bits) - 1)) - half
