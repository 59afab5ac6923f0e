"""Driver of a Pioneer base with ARCOS firmware, on a serial line or `tcp://host:port`.

Source of commands, periods and codes: Pioneer 3 operations manual (MobileRobots),
"Client-Server Communication".
"""

import logging
import math
import time
from dataclasses import dataclass

from explore_slam.data import OdometryReading
from explore_slam.errors import VehicleError
from explore_slam.geometry import IDENTITY
from explore_slam.settings import Section, setting
from explore_slam.vehicle.arcos_handshake import diagnose_port, shake_hands
from explore_slam.vehicle.arcos_packets import (
    BAUD_CODES,
    RATE_CHANGE_DELAY,
    RATE_CHANGE_TIMEOUT,
    Command,
    PacketDecoder,
    encode_command,
)
from explore_slam.vehicle.arcos_status import (
    CounterOdometry,
    RobotConfiguration,
    RobotIdentity,
    ScaleFactors,
    StatusPacket,
    parse_configuration,
    parse_status,
    scale_factors,
)
from explore_slam.vehicle.devices import BaseState, Clock, Statistics
from explore_slam.vehicle.driver_config import BaseConfig
from explore_slam.vehicle.odometry_covariance import OdometryCovariance
from explore_slam.vehicle.pioneer_sonar import sonar_points
from explore_slam.vehicle.serial_port import SerialPort

_log = logging.getLogger(__name__)
BAUD_RATES = (9600, 38400, 19200, 115200, 57600)  # order in which ARIA tries them
_REST_TIMEOUT = 1.0  # s to come to rest before the motors are switched off
_AT_REST = 0.02  # m/s, rad/s
_PULSE_PERIOD = 0.4  # s; the watchdog of the robot fires after 2 s without a packet
_VELOCITY_PERIOD = 0.2  # s; commanded velocities are repeated, since packets may be lost
_CLOSING_BYTES = 60  # bytes of the packets sent by close()
_FRAME_BYTES = 5  # bytes of a packet beside its payload


@dataclass(frozen=True)
class PioneerConfig(Section):
    """Settings of a Pioneer base beside those of any base."""

    base_baud: int = setting(
        0, 'Baud rate of the robot before the handshake; 0 tries all', unit='Bd',
        low=0, high=1_000_000,
    )  # fmt: skip
    host_baud: int = setting(
        0, 'Baud rate to change to after the handshake; 0 keeps the rate', unit='Bd',
        low=0, high=115200,
    )  # fmt: skip
    distance_factor: float = setting(
        0.0, 'Millimetres per count of the odometry; 0 takes that of the subclass',
        unit='mm', low=0.0, high=100.0,
    )  # fmt: skip


class PioneerRobot:
    """A Pioneer base (protocol Base). Motors stay off until enable_motors(True).

    clock gives the stamps (s); silence and periods are measured with the monotonic clock.
    """

    def __init__(
        self,
        config: BaseConfig,
        own: PioneerConfig | None = None,
        clock: Clock = time.time,
    ) -> None:
        self.config = config
        self.own = own or PioneerConfig()
        self.identity: RobotIdentity | None = None
        self.configuration: RobotConfiguration | None = None
        self.packets = 0
        self.last_baud = self.own.base_baud
        self._clock = clock
        self._port: SerialPort | None = None
        self._decoder = PacketDecoder()
        self._factors: ScaleFactors | None = None
        self._odometry: CounterOdometry | None = None
        self._covariance = OdometryCovariance(config.noise)
        self._velocity = (0, 0)  # mm/s, °/s
        self._sent = {'pulse': 0.0, 'velocity': 0.0}
        self._heard = 0.0

    @property
    def rejected(self) -> int:
        """Number of packets with a wrong checksum or count."""
        return self._decoder.rejected

    # -- session --------------------------------------------------------------------------------

    def connect(self) -> RobotIdentity:
        """Open the port, find the baud rate, open a session with motors off.

        Raises VehicleError that says what is wrong and what to do.
        """
        self.close()
        self._port = SerialPort(self.config.base_port, self.last_baud or BAUD_RATES[0])
        try:
            self.identity = self._find_robot()
            self._factors = scale_factors(self.identity.subclass, self.own.distance_factor)
            self._open_session()
        except VehicleError:
            self.close()
            raise
        if self._odometry is None:
            self._odometry = CounterOdometry(self._factors, IDENTITY)
        else:
            self._odometry.restart(self._factors)
        self._heard = time.monotonic()
        return self.identity

    def _find_robot(self) -> RobotIdentity:
        """Try the baud rates, that of the last connection first; return the robot's identity."""
        assert self._port is not None
        rates = [self.own.base_baud] if self.own.base_baud else list(BAUD_RATES)
        if self.last_baud in rates:
            rates.sort(key=lambda rate: rate != self.last_baud)
        if self._port.is_network:
            rates = rates[:1]
        collected = b''
        for rate in rates:
            self._port.set_baud(rate)
            identity, received = shake_hands(self._port, self._decoder)
            collected += received
            if identity is not None:
                self.last_baud = rate
                return identity
        raise VehicleError(f'{self.config.base_port}: {diagnose_port(collected, rates)}')

    def _open_session(self) -> None:
        """Open a session with motors off, and set limits and accelerations."""
        config, port, host_baud = self.config, self._port, self.own.host_baud
        assert port is not None
        self._command(Command.OPEN)
        if host_baud and host_baud != port.baud and not port.is_network:
            self._change_rate(host_baud)
        self._command(Command.PULSE)
        self._command(Command.ENABLE, 0)
        self._command(Command.CONFIG, 1)
        self._command(Command.BATTERYINFO, 1)
        self._command(Command.SETV, round(1000 * config.maximum_speed))
        self._command(Command.SETA, round(1000 * config.base_acceleration))
        self._command(Command.SETA, -round(1000 * config.base_deceleration))
        self._command(Command.SETRV, round(math.degrees(config.maximum_turn_rate)))
        turn = round(math.degrees(config.base_turn_acceleration))
        self._command(Command.SETRA, turn)
        self._command(Command.SETRA, -turn)
        self._command(Command.SONAR, int(config.use_sonar))
        self._velocity = (0, 0)

    def _change_rate(self, rate: int) -> None:
        """Change the baud rate; go back if nothing is received at the new one."""
        assert self._port is not None
        old = self._port.baud
        self._command(Command.HOSTBAUD, BAUD_CODES[rate])
        time.sleep(RATE_CHANGE_DELAY)
        self._port.set_baud(rate)
        self._command(Command.PULSE)
        end = time.monotonic() + RATE_CHANGE_TIMEOUT
        while time.monotonic() < end:
            if any(parse_status(p) for p in self._decoder.feed(self._port.read(0.1))):
                return
        _log.warning('%s: no packet at %d Bd, staying at %d Bd', self._port.url, rate, old)
        self._port.set_baud(old)

    def close(self) -> None:
        """Stop, switch the motors off, end the session and release the port; never raises."""
        if self._port is None:
            return
        try:
            self._come_to_rest()
            for command, argument in ((Command.ENABLE, 0), (Command.CLOSE, None)):
                for _ in range(2):  # a packet may be lost
                    self._command(command, argument)
            time.sleep(0.02 + self._port.transmission_time(_CLOSING_BYTES))
        except VehicleError:
            pass
        self._port.close()
        self._port = None

    def _come_to_rest(self) -> None:
        """Command zero velocity until the vehicle has stopped: without power it would roll on."""
        end = time.monotonic() + _REST_TIMEOUT
        moving = self._odometry is not None
        while moving and time.monotonic() < end:
            self._velocity = (0, 0)
            self._send_velocity()
            for state in self.poll(0.1):
                moving = abs(state.linear) > _AT_REST or abs(state.angular) > _AT_REST
        self._command(Command.STOP)

    # -- open session -----------------------------------------------------------------------------

    def poll(self, timeout: float) -> list[BaseState]:
        """Return the states received within timeout (s); keeps the session alive.

        Raises VehicleError when the line is lost or no status came for base_timeout.
        """
        if self._port is None:
            raise VehicleError(f'{self.config.base_port}: not connected')
        self._keep_alive()
        data = self._port.read(timeout)
        states = []
        for payload in self._decoder.feed(data):
            status = parse_status(payload)
            if status is not None:
                states.append(self._state(status, len(payload) + _FRAME_BYTES))
            elif configuration := parse_configuration(payload):
                self.configuration = configuration
        now = time.monotonic()
        if states:
            self._heard = now
        elif now - self._heard > self.config.base_timeout:
            raise VehicleError(
                f'{self.config.base_port}: no status packet for {now - self._heard:.1f} s; '
                'is the robot switched on and its cable plugged in?'
            )
        return states

    def _state(self, status: StatusPacket, size: int) -> BaseState:
        """Convert a status packet of this size (bytes); it is stamped when its first byte left."""
        assert self._port is not None
        assert self._odometry is not None
        assert self._factors is not None
        self.packets += 1
        received = self._clock()
        # not negative: a simulated clock starts at 0
        stamp = max(received - self._port.transmission_time(size), 0.0)
        before = self._odometry.pose
        pose = self._odometry.update(status)
        self._covariance.propagate(before.between(pose))
        f = self._factors
        left, right = status.left_velocity, status.right_velocity
        sonar = {index: 0.001 * f.range * value for index, value in status.sonar.items()}
        turning = 0.5 * (right - left) * f.velocity * f.difference
        return BaseState(
            odometry=OdometryReading(stamp, pose, self._covariance.value(pose)),
            linear=0.0005 * f.velocity * (left + right),  # mean of both wheels, mm/s to m/s
            angular=turning if status.rotational_velocity is None else status.rotational_velocity,
            received=received,
            motors_on=status.motors_on,
            battery=status.battery,
            charging=bool(status.charge_state),
            emergency_stop=status.emergency_stop,
            stalled=status.left_stall or status.right_stall,
            front_bumpers=status.front_bumpers,
            rear_bumpers=status.rear_bumpers,
            faults=status.faults,
            sonar_points=sonar_points(sonar) if sonar else None,
        )

    def _keep_alive(self) -> None:
        """Repeat the velocity, or send a pulse, before the robot's watchdog fires."""
        now = time.monotonic()
        if any(self._velocity) and now - self._sent['velocity'] > _VELOCITY_PERIOD:
            self._send_velocity()
        elif now - max(self._sent.values()) > _PULSE_PERIOD:
            self._command(Command.PULSE)

    def _command(self, command: int, argument: int | None = None) -> None:
        if self._port is None:
            raise VehicleError(f'{self.config.base_port}: not connected')
        self._port.write(encode_command(command, argument))
        self._sent['pulse'] = time.monotonic()

    def set_velocity(self, linear: float, angular: float) -> None:
        """Command a velocity (m/s, rad/s), clamped to the maximum; a new one is sent at once."""
        c = self.config
        linear = min(max(linear, -c.maximum_speed), c.maximum_speed)
        angular = min(max(angular, -c.maximum_turn_rate), c.maximum_turn_rate)
        wanted = (round(1000 * linear), round(math.degrees(angular)))
        if wanted != self._velocity:
            self._velocity = wanted
            self._send_velocity()

    def _send_velocity(self) -> None:
        self._command(Command.VEL, self._velocity[0])
        self._command(Command.RVEL, self._velocity[1])
        self._sent['velocity'] = time.monotonic()

    def enable_motors(self, on: bool) -> None:
        """Switch the motors on or off."""
        self._command(Command.ENABLE, int(on))

    def statistics(self) -> Statistics:
        """Return counters for diagnostics."""
        return {'packets': self.packets, 'rejected': self.rejected, 'baud': self.last_baud}
