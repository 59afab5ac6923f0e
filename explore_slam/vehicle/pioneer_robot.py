"""Driver of a Pioneer base with ARCOS firmware, on a serial line or `tcp://host:port`.

Source of commands, periods and codes: Pioneer 3 operations manual (MobileRobots),
"Client-Server Communication".
"""

import contextlib
import logging
import math
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from explore_slam.data import OdometryReading
from explore_slam.errors import VehicleError
from explore_slam.geometry import IDENTITY
from explore_slam.settings import Section, setting
from explore_slam.vehicle.arcos_handshake import (
    FAST_LASER_RATE,
    LASER_RATES,
    ask_for_laser,
    diagnose_port,
    is_laser,
    shake_hands,
)
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
    StatusPacket,
    parse_configuration,
    parse_status,
)
from explore_slam.vehicle.devices import BaseState, Clock, Statistics
from explore_slam.vehicle.driver_config import BaseConfig
from explore_slam.vehicle.odometry_covariance import OdometryCovariance
from explore_slam.vehicle.odometry_memory import OdometryMemory
from explore_slam.vehicle.pioneer_models import RobotModel, ScaleFactors, robot_model
from explore_slam.vehicle.pioneer_sonar import sonar_points
from explore_slam.vehicle.serial_port import BaudRateError, SerialPort

_log = logging.getLogger(__name__)
KEEP_DRIFT_FACTOR = -32768  # no correction is as large
BAUD_RATES = (9600, 38400, 19200, 115200, 57600)  # order in which ARIA tries them
_REST_TIMEOUT = 1.0  # s to come to rest before the motors are switched off
_AT_REST = 0.02  # m/s, rad/s
_PULSE_PERIOD = 0.4  # s; the watchdog of the robot fires after 2 s without a packet
_VELOCITY_PERIOD = 0.2  # s; commanded velocities are repeated, since packets may be lost
_CLOSING_BYTES = 60  # bytes of the packets sent by close()
_FRAME_BYTES = 5  # bytes of a packet beside its payload
# words of /diagnostics for CounterOdometry.resumed
_FRAMES = {None: 'first', True: 'continued', False: 'new'}


@dataclass(frozen=True)
class PioneerConfig(Section):
    """Settings of a Pioneer base beside those of any base."""

    base_baud: int = setting(
        0, 'Baud rate of the robot before the handshake, tried first; 0: 9600', unit='Bd',
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
    ticks_mm: int = setting(
        0,
        'TicksMM: encoder ticks per millimetre of travel, while this driver is connected; 0 '
        'leaves that of the robot. New value = old value × (distance reported / driven)',
        low=0,
        high=65535,
    )
    rev_count: int = setting(
        0,
        'RevCount: differential encoder ticks of half a turn; 0 leaves that of the robot. New '
        'value = old value × (angle reported / turned)',
        low=0,
        high=65535,
    )
    drift_factor: int = setting(
        KEEP_DRIFT_FACTOR,
        'DriftFactor: correction of the left wheel in 1/8192, against driving in a curve; '
        '-32768 leaves that of the robot',
        low=KEEP_DRIFT_FACTOR,
        high=32767,
    )
    ignored_front_bumpers: int = setting(
        0,
        'Front bumper segments to ignore, e.g. those that are stuck: sum of 1, 2, 4, ... as '
        'front_bumpers in /diagnostics shows them, from the right; 127: all',
        low=0,
        high=127,
    )
    ignored_rear_bumpers: int = setting(
        0, 'Rear bumper segments to ignore, likewise', low=0, high=127
    )
    bump_stall: int = setting(
        -1,
        "Which bumpers stall the motors in the robot's firmware: 0 none, 1 front, 2 rear, 3 both; "
        '-1 leaves that of the robot. A stuck bumper stops the robot there, too',
        low=-1,
        high=3,
    )
    odometry_file: str = setting(
        '',
        'File that keeps the odometry frame over a restart of the driver, as long as the robot '
        'has power; empty: none (the driver node: keep_odometry)',
    )


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
        self._model: RobotModel | None = None
        memory = self.own.odometry_file
        self._memory = OdometryMemory(Path(memory).expanduser()) if memory else None
        self._front_bumpers = self._rear_bumpers = 0  # as reported, those ignored among them
        self._odometry: CounterOdometry | None = None
        self._covariance = OdometryCovariance(config.noise)
        self.new_frames = 0  # connections at which the odometry frame could not be continued
        self._resumption_told = True
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
            before = self.identity
            self.identity = self._find_robot()
            self._model = robot_model(self.identity.subclass, self.own.distance_factor)
            self._open_session()
        except VehicleError:
            self.close()
            raise
        self._continue_odometry(self._model.factors, before)
        self._heard = time.monotonic()
        return self.identity

    def _continue_odometry(self, factors: ScaleFactors, before: RobotIdentity | None) -> None:
        """Continue the odometry frame of this driver, or of the one before it.

        before: identity of the robot at the last connection.
        """
        if self._odometry is None:
            known = None if self._memory is None else self._memory.load(self._robot_name)
            last = None if known is None else known[0]
            self._odometry = CounterOdometry(factors, IDENTITY, last)
            if known is not None:
                self._covariance.restore(known[1])
        elif before == self.identity:
            self._odometry.resume(factors)
        else:
            self._odometry.restart(factors)
        self._resumption_told = False

    def _report_resumption(self, odometry: CounterOdometry) -> None:
        """Log once after a connection whether the frame continues; a new one is at no motion."""
        if self._resumption_told:
            return
        self._resumption_told = True
        if odometry.resumed:
            x, y, theta = odometry.pose
            _log.info(
                '%s: the odometry frame continues at x %.2f m, y %.2f m, %.0f°',
                self.config.base_port, x, y, math.degrees(theta),
            )  # fmt: skip
        elif odometry.resumed is False:
            _log.warning(
                '%s: the robot was switched off, or moved far, since the last connection: a new '
                'odometry frame begins, and any motion meanwhile is unknown',
                self.config.base_port,
            )
            self.new_frames += 1

    @property
    def _robot_name(self) -> str:
        return '' if self.identity is None else ' '.join(self.identity)

    def _find_robot(self) -> RobotIdentity:
        """Try the baud rates, that of the last connection first; return the robot's identity."""
        assert self._port is not None
        own = self.own
        # after SIGKILL of a driver the robot is left at host_baud
        likely = (self.last_baud, own.base_baud, own.host_baud, *BAUD_RATES)
        rates = [rate for rate in dict.fromkeys(likely) if rate]
        if self._port.is_network:
            rates = rates[:1]
        collected, tried = b'', []
        for rate in rates:
            with contextlib.suppress(BaudRateError):
                self._port.set_baud(rate)
                tried.append(rate)
            if rate not in tried:
                continue
            identity, received = shake_hands(self._port, self._decoder)
            collected += received
            if identity is not None:
                if own.base_baud not in (0, rate) and rate != self.last_baud:
                    _log.warning(
                        '%s: the robot was found at %d Bd, not at base_baud %d Bd',
                        self._port.url, rate, own.base_baud,
                    )  # fmt: skip
                self.last_baud = rate
                return identity
            if rate in LASER_RATES and not is_laser(collected):
                collected += ask_for_laser(self._port)
            if is_laser(collected):
                break
        else:
            collected = self._look_for_fast_laser() or collected
        raise VehicleError(f'{self.config.base_port}: {diagnose_port(collected, tried)}')

    def _look_for_fast_laser(self) -> bytes:
        """Return what a laser at its fastest rate replies at this port; b'' if there is none."""
        assert self._port is not None
        if self._port.is_network:
            return b''
        try:
            self._port.set_baud(FAST_LASER_RATE)
        except BaudRateError:
            return b''
        received = ask_for_laser(self._port)
        return received if is_laser(received) else b''

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
        self._calibrate()
        self._velocity = (0, 0)

    def _calibrate(self) -> None:
        """Send the calibration that is set; the robot keeps it until the end of the session."""
        own = self.own
        if own.ticks_mm:
            self._command(Command.TICKSMM, own.ticks_mm)
        if own.rev_count:
            self._command(Command.REVCOUNT, own.rev_count)
        if own.drift_factor != KEEP_DRIFT_FACTOR:
            self._command(Command.DRIFTFACTOR, own.drift_factor)
        if own.bump_stall >= 0:
            self._command(Command.BUMPSTALL, own.bump_stall)

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
        self._remember(now=True)
        self._port.close()
        self._port = None

    def _remember(self, now: bool = False) -> None:
        state = None if self._odometry is None else self._odometry.state
        if self._memory is not None and state is not None:
            covariance = self._covariance.in_vehicle_frame
            self._memory.save(self._robot_name, state, covariance, now=now)

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
        assert self._model is not None
        self.packets += 1
        received = self._clock()
        # not negative: a simulated clock starts at 0
        stamp = max(received - self._port.transmission_time(size), 0.0)
        before = self._odometry.pose
        pose = self._odometry.update(status)
        if self.packets > 1:
            self._covariance.propagate(before.between(pose))
        elif not self._odometry.resumed:
            self._covariance.restore(np.zeros((3, 3)))
        self._report_resumption(self._odometry)
        self._remember()
        f = self._model.factors
        self._front_bumpers, self._rear_bumpers = (
            bits & ((1 << segments) - 1)
            for bits, segments in zip(
                (status.front_bumpers, status.rear_bumpers), self._model.bumpers, strict=True
            )
        )
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
            charging=status.charging,
            emergency_stop=status.emergency_stop,
            stalled=status.left_stall or status.right_stall,
            front_bumpers=self._front_bumpers & ~self.own.ignored_front_bumpers,
            rear_bumpers=self._rear_bumpers & ~self.own.ignored_rear_bumpers,
            faults=status.faults,
            # boards that measure no state of charge report 0
            charge=status.state_of_charge / 100.0 if status.state_of_charge else None,
            sonar_points=sonar_points(sonar, self._model.sonar) if sonar else None,
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
        odometry = self._odometry
        own = self.own
        found: Statistics = {
            'packets': self.packets,
            'rejected': self.rejected,
            'baud': self.last_baud,
            'subclass': '' if self.identity is None else self.identity.subclass,
            'odometry_frame': _FRAMES[None if odometry is None else odometry.resumed],
            'new_odometry_frames': self.new_frames,
        }
        if own.ignored_front_bumpers or own.ignored_rear_bumpers:
            found['ignored_front_bumpers'] = f'{self._front_bumpers & own.ignored_front_bumpers:b}'
            found['ignored_rear_bumpers'] = f'{self._rear_bumpers & own.ignored_rear_bumpers:b}'
        return found

    @property
    def stock_laser(self) -> tuple[float, float] | None:
        """Where the laser is on a robot of this kind as delivered (x, y in m); None: unknown."""
        return None if self._model is None else self._model.laser
