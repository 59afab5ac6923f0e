"""The base: a Pioneer with ARCOS firmware on a serial line or `tcp://host:port`."""

import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from explore_slam.data import OdometryReading
from explore_slam.errors import VehicleError
from explore_slam.geometry import IDENTITY
from explore_slam.vehicle.arcos_handshake import shake_hands, who_is_there
from explore_slam.vehicle.arcos_packets import Command, PacketDecoder, encode_command
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
from explore_slam.vehicle.driver_config import BaseConfig
from explore_slam.vehicle.odometry_noise import OdometryCovariance
from explore_slam.vehicle.serial_port import SerialPort

_log = logging.getLogger(__name__)
BAUD_RATES = (9600, 38400, 19200, 115200, 57600)
BAUD_CODES = {9600: 0, 19200: 1, 38400: 2, 57600: 3, 115200: 4}
_REST_TIMEOUT = 1.0  # s to come to rest before the motors are switched off
_AT_REST = 0.02  # m/s, rad/s
_PULSE_PERIOD = 0.4  # s
_SPEED_PERIOD = 0.2  # s: velocities are sent again, lest the robot's watchdog fires


@dataclass(frozen=True)
class BaseState:
    """What one status packet tells, in SI units; stamp is when its first byte was sent."""

    odometry: OdometryReading
    linear: float  # m/s
    angular: float  # rad/s
    status: StatusPacket
    sonar: dict[int, float]  # transducer -> m
    received: float  # s, stamp clock

    @property
    def bumped(self) -> bool:
        """Some bumper is pressed."""
        return bool(self.status.front_bumpers or self.status.rear_bumpers)

    @property
    def stalled(self) -> bool:
        """Some wheel is stalled."""
        return self.status.left_stall or self.status.right_stall


class PioneerRobot:
    """Talks ARCOS; one thread calls all of it. Motors stay off until enable_motors(True).

    clock gives the stamps (s); silence and periods are measured on the monotonic clock.
    """

    def __init__(self, config: BaseConfig, clock: Callable[[], float] = time.time) -> None:
        self.config = config
        self.identity: RobotIdentity | None = None
        self.configuration: RobotConfiguration | None = None
        self.packets = 0
        self.last_baud = config.base_baud
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
        """Packets with a bad checksum or count so far."""
        return self._decoder.rejected

    # -- session --------------------------------------------------------------------------------

    def connect(self) -> RobotIdentity:
        """Open the port, find the rate, shake hands and open a session with motors off.

        Raises VehicleError that says what is wrong and what to do.
        """
        self.close()
        self._port = SerialPort(self.config.base_port, self.last_baud or BAUD_RATES[0])
        try:
            self.identity = self._find_robot()
            self._factors = scale_factors(self.identity.subclass, self.config.distance_factor)
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
        assert self._port is not None
        rates = [self.config.base_baud] if self.config.base_baud else list(BAUD_RATES)
        if self.last_baud in rates:
            rates.sort(key=lambda rate: rate != self.last_baud)  # where it was found before
        if self._port.is_network:
            rates = rates[:1]
        heard = b''
        for rate in rates:
            self._port.set_baud(rate)
            identity, came = shake_hands(self._port, self._decoder)
            heard += came
            if identity is not None:
                self.last_baud = rate
                return identity
        raise VehicleError(f'{self.config.base_port}: {who_is_there(heard, rates)}')

    def _open_session(self) -> None:
        config, port = self.config, self._port
        assert port is not None
        self._command(Command.OPEN)
        if config.host_baud and config.host_baud != port.baud and not port.is_network:
            self._change_rate(config.host_baud)
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
        """Ask for another rate; go back where nothing comes at it."""
        assert self._port is not None
        old = self._port.baud
        self._command(Command.HOSTBAUD, BAUD_CODES[rate])
        time.sleep(0.01)
        self._port.set_baud(rate)
        self._command(Command.PULSE)
        end = time.monotonic() + 0.9
        while time.monotonic() < end:
            if any(parse_status(p) for p in self._decoder.feed(self._port.read(0.1))):
                return
        _log.warning('%s: no answer at %d Bd, staying at %d', self._port.url, rate, old)
        self._port.set_baud(old)

    def close(self) -> None:
        """Stop, switch the motors off, end the session and release the port; never raises."""
        if self._port is None:
            return
        try:
            self._come_to_rest()
            for command, argument in ((Command.ENABLE, 0), (Command.CLOSE, None)):
                for _ in range(2):  # twice: a byte may get lost
                    self._command(command, argument)
            time.sleep(0.02 + self._port.transmission_time(60))
        except VehicleError:
            pass
        self._port.close()
        self._port = None

    def _come_to_rest(self) -> None:
        """Command rest until the wheels stand: without power they would roll on."""
        end = time.monotonic() + _REST_TIMEOUT
        moving = self._odometry is not None
        while moving and time.monotonic() < end:
            self._velocity = (0, 0)
            self._send_velocity()
            for state in self.poll(0.1):
                moving = abs(state.linear) > _AT_REST or abs(state.angular) > _AT_REST
        self._command(Command.STOP)

    # -- while the session is open ----------------------------------------------------------------

    def poll(self, timeout: float) -> list[BaseState]:
        """Return the states that came within timeout (s); keeps the session alive.

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
                states.append(self._state(status, len(payload) + 5))
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
        assert self._port is not None
        assert self._odometry is not None
        assert self._factors is not None
        self.packets += 1
        received = self._clock()
        # a simulated clock begins at 0
        stamp = max(received - self._port.transmission_time(size), 0.0)
        before = self._odometry.pose
        pose = self._odometry.update(status)
        self._covariance.drive(before.between(pose))
        f = self._factors
        left, right = status.left_velocity, status.right_velocity
        turning = 0.5 * (right - left) * f.velocity * f.difference
        return BaseState(
            odometry=OdometryReading(stamp, pose, self._covariance.value(pose)),
            linear=0.0005 * f.velocity * (left + right),
            angular=turning if status.rotational_velocity is None else status.rotational_velocity,
            status=status,
            sonar={index: 0.001 * f.range * value for index, value in status.sonar.items()},
            received=received,
        )

    def _keep_alive(self) -> None:
        now = time.monotonic()
        if any(self._velocity) and now - self._sent['velocity'] > _SPEED_PERIOD:
            self._send_velocity()
        elif now - max(self._sent.values()) > _PULSE_PERIOD:
            self._command(Command.PULSE)

    def _command(self, command: int, argument: int | None = None) -> None:
        if self._port is None:
            raise VehicleError(f'{self.config.base_port}: not connected')
        self._port.write(encode_command(command, argument))
        self._sent['pulse'] = time.monotonic()

    def set_velocity(self, linear: float, angular: float) -> None:
        """Command a velocity (m/s, rad/s), within the maximum; sent at once where it changed."""
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

    def enable_sonar(self, on: bool) -> None:
        """Switch the sonar on or off."""
        self._command(Command.SONAR, int(on))

    def emergency_stop(self) -> None:
        """Stop as hard as the robot can; it stays stopped until another velocity is sent."""
        self._velocity = (0, 0)
        self._command(Command.ESTOP)
        self._send_velocity()
