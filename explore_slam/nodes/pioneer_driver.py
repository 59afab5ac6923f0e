"""Node `pioneer_driver`: base, laser and camera of one vehicle on relative topics.

Each device runs in a thread of its own. base_type, laser_type and camera_type select the devices,
enable_base, enable_laser and enable_camera switch them off.
Commands on cmd_vel_teleop go before those on cmd_vel (teleop_timeout).
Velocities pass the safety gate in the thread of the base, not in the executor's: even while the
executor is busy, the vehicle stops when commands or laser scans cease.
A managed node: configured, its devices are open; it publishes and drives while it is active.
"""

import logging
import math
import threading
import time
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future
from std_srvs.srv import SetBool

from explore_slam.data import LaserScan, RgbdFrame
from explore_slam.errors import DataError, VehicleError
from explore_slam.messages.measurement import VehicleReader
from explore_slam.messages.scans import SCAN
from explore_slam.messages.sweep_status import sweeps_record
from explore_slam.messages.topics import SensorTopic, VehicleTopic
from explore_slam.messages.vehicle_settings import VehicleConfig
from explore_slam.mounts import LaserMountConfig
from explore_slam.nodes.driver_outputs import DriverOutputs, Latency
from explore_slam.nodes.driver_parameters import DriverNodeConfig
from explore_slam.nodes.endpoints import subscribe
from explore_slam.nodes.managed_node import ManagedNode
from explore_slam.nodes.node_support import (
    ERROR,
    OK,
    REPORT_PERIOD,
    WARN,
    WARNING_PERIOD,
    RosLogHandler,
    ask_for_priority,
    changed_settings,
    declare_settings,
    now_seconds,
    run_node,
    vehicle_name,
    warn_of_unknown_vehicle_parameters,
)
from explore_slam.nodes.shared_parameters import TeleoperationConfig
from explore_slam.nodes.transform_listener import own_mounts
from explore_slam.nodes.velocity_topic import VelocityInput
from explore_slam.settings import values_of
from explore_slam.sweeps import SweepConfig
from explore_slam.vehicle import (
    BaseState,
    Device,
    PathFollowerConfig,
    SafetyConfig,
    SafetyGate,
    SafetyInputs,
    SafeVelocity,
    Supervisor,
    make_base,
    make_camera,
    make_laser,
)
from explore_slam.vehicle.dead_reckoning import DeadReckoning
from explore_slam.vehicle.laser_view import LaserView
from explore_slam.vehicle.teleoperation import Teleoperation

CONTROL_PERIOD = 0.02  # s between velocities sent to the base
_MOTOR_GRACE = 1.0  # s until a base reports that its motors were switched on
_MOTOR_TIMEOUT = 1.5  # s within which enable_motors is answered by what the base reports
_MOTOR_REPEAT = 0.4  # s after which a request to the motors that has no effect is repeated
_STANDING = 1.5  # s after which a base that does not move as commanded is reported
_MOVING = (0.03, 0.05)  # m/s, rad/s: a command that must show
_AT_REST = 0.005  # m/s, rad/s
_LASER_MOUNT_TOLERANCE = 0.02  # m between the mount of the settings and that of the kind of robot
_BASE_STOP_TIMEOUT, _STOP_TIMEOUT = 3.0, 1.0  # s for a device to close; a base brakes first
_OPEN_TIMEOUT = 30.0  # s for all devices to be opened: a laser may try several baud rates
_NO_POINTS = np.empty((0, 2))
# settings of the vehicle, which the agent has too
_SENSORS = (
    'use_laser', 'scans', 'laser_mount', 'clouds', 'cloud_mount', 'cloud_lowest', 'cloud_highest',
    'cameras', 'camera_mount', *values_of(SweepConfig()),
)  # fmt: skip
_CHANGEABLE = {
    *values_of(SafetyConfig()),
    *values_of(TeleoperationConfig()),
    'use_sim_time',
}  # while the node runs


class MotorRequest(NamedTuple):
    """A call of enable_motors that waits for what the base reports.

    since: monotonic s. answer: result is (success, message).
    """

    on: bool
    since: float
    answer: 'Future[tuple[bool, str]]'


class DriverSession:
    """The devices of a configured driver. Inactive, they are open, and the vehicle is stopped."""

    def __init__(self, node: Node, config: DriverNodeConfig, sensors: VehicleConfig) -> None:
        self._node = node
        self._sensors = sensors
        self._vehicle = vehicle_name(node)
        config = config.with_odometry_file(self._vehicle)
        self.config = config
        driver = config.driver
        self.outputs = DriverOutputs(node, config.frames(self._vehicle), driver, config.publish_tf)
        self._laser_pose = driver.laser_mount.pose
        self._lasers: VehicleReader | None = None  # of the lasers of other drivers
        limits = driver.base.maximum_speed, driver.base.maximum_turn_rate
        self._gate = SafetyGate(driver.safety, *limits)
        self._inputs = SafetyInputs()
        self._reckoning = DeadReckoning()
        self._view = LaserView(self._vehicle, self._reckoning)
        self._safe = SafeVelocity(0.0, 0.0, 'base not connected')
        self._lock = threading.Lock()
        self._active = False
        self._commands: list[VelocityInput] = []
        self._motors_wanted: bool | None = None  # None before the first connection
        self._motors_asked = 0.0
        self._motor_request: MotorRequest | None = None
        # a call that waits for the base must not hold up commands, reports and later calls
        self._motor_calls = ReentrantCallbackGroup()
        self._teleoperation = Teleoperation()
        self._standing_since: float | None = None
        self._state: BaseState | None = None  # the newest one
        self._latency = {'base': Latency(), 'laser': Latency(), 'camera': Latency()}
        self.base = make_base(driver, self._clock_seconds)
        self.laser = make_laser(driver, self._clock_seconds)
        self.camera = make_camera(driver, self._clock_seconds)
        self.supervisors = self._make_supervisors()

    # -- life cycle ------------------------------------------------------------------------------

    def open(self, patient: bool) -> None:
        """Open all devices at the same time.

        patient: do not wait; a device that is absent is tried again and again. Otherwise
        VehicleError names those that cannot be opened, and all are closed.
        """
        if self.base is not None:  # an inactive driver refuses, instead of leaving a call waiting
            self._node.create_service(
                SetBool, 'enable_motors', self._on_enable_motors, callback_group=self._motor_calls
            )
        for supervisor in self.supervisors.values():
            supervisor.start(patient)
        if patient:
            return
        until = time.monotonic() + _OPEN_TIMEOUT
        if self.laser is not None:
            until += self.config.driver.laser.laser_startup_timeout
        missing = [
            f'{name}: {supervisor.health.message}'
            for name, supervisor in self.supervisors.items()
            if not supervisor.await_attempt(max(until - time.monotonic(), 0.0))
        ]
        if missing:
            self.close()
            raise VehicleError('; '.join(missing))

    def activate(self) -> None:
        """Publish, and take velocities."""
        self.outputs.publish_mounts(self.config.driver)
        if self.base is not None:
            self._commands = [
                VelocityInput(self._node, {'': self._on_velocity}),
                VelocityInput(
                    self._node, {'': self._on_teleoperation}, VehicleTopic.TELEOP_COMMAND
                ),
            ]
        if self.laser is None and self.config.watch_scan_topic:
            name, laser = self._vehicle, self.config.driver.laser_mount
            base = self.config.frames(name).base if self.base is not None else ''
            sensors = replace(self._sensors, robot_base_frame=base)
            mounts = own_mounts(self._node, name, laser, sensors)
            self._lasers = VehicleReader((SCAN,), mounts)
            for topic in sensors.laser_topics:
                callback = partial(self._on_watched_scan, topic)
                subscribe(self._node, topic.kind, callback, name=topic.name)
            subscribe(self._node, VehicleTopic.SWEEPS, self._on_sweeps)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._node.create_timer(REPORT_PERIOD, self._report, clock=steady)
        with self._lock:
            self._active = True

    def deactivate(self) -> None:
        """Bring the vehicle to rest; the devices stay open."""
        for commands in self._commands:
            commands.close()
        self._commands = []
        with self._lock:
            self._active = False
            self._gate.command(0.0, 0.0, time.monotonic())
        self._answer_motor_request(False, 'the driver is deactivated')

    def close(self) -> None:
        """Bring the vehicle to rest, switch its motors off, release all devices."""
        with self._lock:
            self._gate.command(0.0, 0.0, time.monotonic())
        for name, supervisor in self.supervisors.items():
            supervisor.stop(timeout=_BASE_STOP_TIMEOUT if name == 'base' else _STOP_TIMEOUT)

    def configure(self, config: DriverNodeConfig) -> None:
        """Replace the settings that may change while the devices are open."""
        self.config = config
        with self._lock:
            self._gate.config = config.driver.safety

    def _clock_seconds(self) -> float:
        return now_seconds(self._node)

    def _make_supervisors(self) -> dict[str, Supervisor]:
        retry = self.config.driver.retry_after
        made = {}
        if self.base is not None:
            made['base'] = Supervisor(
                'base', self.base, self._on_state, on_connected=self._on_base_connected,
                on_poll=self._control, retry_after=retry, poll_timeout=CONTROL_PERIOD,
            )  # fmt: skip
        if self.laser is not None:
            made['laser'] = Supervisor('laser', self.laser, self._on_scan, retry_after=retry)
        if self.camera is not None:
            made['camera'] = Supervisor('camera', self.camera, self._on_frame, retry_after=retry)
        return made

    # -- callbacks -------------------------------------------------------------------------------

    def _on_velocity(self, linear: float, angular: float) -> None:
        now = time.monotonic()
        with self._lock:
            if not self._teleoperation.is_active(now, self._teleop_timeout):
                self._gate.command(linear, angular, now)

    def _on_teleoperation(self, linear: float, angular: float) -> None:
        now = time.monotonic()
        with self._lock:
            self._teleoperation.command(now)
            self._gate.command(linear, angular, now)

    @property
    def _teleop_timeout(self) -> float:
        return self.config.teleoperation.teleop_timeout

    async def _on_enable_motors(self, request: Any, response: Any) -> Any:
        """Answer with what the base reports afterwards, or why it does not."""
        self._answer_motor_request(False, 'replaced by a later call')
        if not self._active:
            response.success = False
            response.message = 'the driver is inactive'
            return response
        wanted = bool(request.data)
        health = self.supervisors['base'].health
        if not health.connected:
            with self._lock:
                self._motors_wanted = False if self._motors_wanted else self._motors_wanted
            response.success = False
            response.message = f'base not connected: {health.message}'
            return response
        answer: Future[tuple[bool, str]] = Future()
        with self._lock:
            self._motors_wanted = wanted
            self._motors_asked = 0.0  # the thread of the base passes it on
            self._motor_request = MotorRequest(wanted, time.monotonic(), answer)
        response.success, response.message = await answer
        return response

    def _answer_motor_request(self, success: bool, message: str) -> None:
        """Answer the call of enable_motors that waits, if any.

        What was refused stays refused: a repetition that the base has not obeyed yet would switch
        the motors on after the answer, so they are switched off.
        """
        with self._lock:
            request, self._motor_request = self._motor_request, None
            if request is not None and not success:
                self._motors_wanted = False
                self._motors_asked = 0.0  # the thread of the base passes it on
        if request is not None:
            request.answer.set_result((success, message))
            if self._node.executor is not None:
                self._node.executor.wake()

    def _check_motor_request(self, state: BaseState | None, now: float) -> None:
        """Answer enable_motors as soon as the base reports what was asked, or not in time."""
        request = self._motor_request
        if request is None:
            return
        if state is not None and self._motors_asked > 0.0 and _obeys(state, request):
            word = 'on' if request.on else 'off'
            self._answer_motor_request(True, f'the base reports motors {word}')
            return
        if now - request.since < _MOTOR_TIMEOUT:
            return
        health = self.supervisors['base'].health
        if not health.connected:
            text = f'base not connected: {health.message}'
        else:
            text = f'the base still reports motors {"off" if request.on else "on"}'
            text += _explain_motors(state)
        self._answer_motor_request(False, text)

    def _on_watched_scan(self, topic: SensorTopic, message: Any) -> None:
        assert self._lasers is not None
        try:
            found = self._lasers.read(topic.kind, message, topic.sensor)
            if found is not None:
                self._keep_points(found[1])
        except DataError as error:
            self._node.get_logger().warning(
                f'{topic.name}: {error}', throttle_duration_sec=WARNING_PERIOD
            )

    def _on_sweeps(self, message: DiagnosticStatus) -> None:
        """Take what the agent has found of the sweeps of the lasers."""
        try:
            found = sweeps_record(message)
        except DataError as error:
            self._node.get_logger().warning(
                f'sweeps: {error}', throttle_duration_sec=WARNING_PERIOD
            )
            return
        with self._lock:
            self._view.set_sweeps(found)

    # -- thread of the base ----------------------------------------------------------------------

    def _on_base_connected(self) -> None:
        first = self._motors_wanted is None
        base = self.config.driver.base
        with self._lock:
            if first:
                self._motors_wanted = base.motors_at_start
            elif self._motors_wanted and not base.motors_after_reconnect:
                self._motors_wanted = False
                self._node.get_logger().warning(
                    'base: motors stay off after the reconnection; call enable_motors'
                )
            self._motors_asked = 0.0
        self._check_laser_mount()

    def _check_laser_mount(self) -> None:
        """Warn if the mount was left at its default, and robots of this kind have another one."""
        stock = getattr(self.base, 'stock_laser', None)
        mount = self.config.driver.laser_mount
        if self.laser is None or stock is None or mount != LaserMountConfig():
            return
        if math.dist(stock, mount.pose[:2]) > _LASER_MOUNT_TOLERANCE:
            self._node.get_logger().warning(
                f'laser_x is {mount.laser_x:.3f} m (default), but robots of this kind are '
                f'delivered with the laser at x {stock[0]:.3f} m, y {stock[1]:.3f} m: measure it, '
                'and set laser_x and laser_y'
            )

    def _on_state(self, state: BaseState) -> None:
        with self._lock:
            inputs = self._inputs
            inputs.bumpers_front = bool(state.front_bumpers)
            inputs.bumpers_rear = bool(state.rear_bumpers)
            inputs.stalled = state.stalled
            inputs.emergency_stop = state.emergency_stop
            inputs.motors_on = state.motors_on
            inputs.sonar_points = _NO_POINTS if state.sonar_points is None else state.sonar_points
            self._reckoning.add_odometry(state.odometry)
        if self._active:
            self.outputs.publish_state(state, self.config.driver.base.use_sonar)
        self._latency['base'].add(now_seconds(self._node) - state.received)
        self._state = state
        self._watch_motion(state)
        self._watch_motors(state.motors_on)
        self._check_motor_request(state, time.monotonic())

    def _watch_motion(self, state: BaseState) -> None:
        """Note since when the base stands although it should move."""
        safe = self._safe
        expected = abs(safe.linear) > _MOVING[0] or abs(safe.angular) > _MOVING[1]
        moves = abs(state.linear) > _AT_REST or abs(state.angular) > _AT_REST
        if not expected or moves:
            self._standing_since = None
        elif self._standing_since is None:
            self._standing_since = time.monotonic()

    def _watch_motors(self, on: bool) -> None:
        """Switch the motors as requested; accept that they are switched off at the robot later."""
        assert self.base is not None
        now, switched_off = time.monotonic(), False
        with self._lock:
            since, request = now - self._motors_asked, self._motor_request
            first = self._motors_asked == 0.0
            repeat = request is not None and on != request.on and since > _MOTOR_REPEAT
            if first or repeat:
                self._motors_asked = now
            elif request is None and self._motors_wanted and not on and since > _MOTOR_GRACE:
                self._motors_wanted, switched_off = False, True
            wanted = bool(self._motors_wanted)
        if first or repeat:
            self.base.enable_motors(wanted)
        if switched_off:
            self._node.get_logger().warning(
                'base: motors were switched off at the robot; call enable_motors to continue'
            )

    def _control(self) -> None:
        """Send the velocity that the safety gate allows."""
        assert self.base is not None
        now = time.monotonic()
        with self._lock:
            inputs = self._inputs
            inputs.connected = self.supervisors['base'].health.connected
            if self.laser is not None:
                inputs.laser_last_received = self.laser.last_received
            elif self.config.watch_scan_topic:
                inputs.laser_last_received = self._view.last_received
            # the newest scan is 0.2 s old
            inputs.laser_points = self._view.points(now_seconds(self._node))
            self._safe = self._gate.update(inputs, now)
        self.base.set_velocity(self._safe.linear, self._safe.angular)

    # -- threads of laser and camera -------------------------------------------------------------

    def _on_scan(self, scan: LaserScan) -> None:
        if self._active:
            self.outputs.publish_scan(scan)
        assert self.laser is not None
        self._latency['laser'].add(time.monotonic() - self.laser.last_received)
        self._keep_points(scan)

    def _keep_points(self, scan: LaserScan) -> None:
        with self._lock:
            self._view.add(scan, scan.mount or self._laser_pose, time.monotonic())

    def _on_frame(self, frame: RgbdFrame) -> None:
        if self._active:
            self.outputs.publish_frame(frame)
        self._latency['camera'].add(now_seconds(self._node) - frame.stamp)

    # -- health ----------------------------------------------------------------------------------

    def _report(self) -> None:
        self._check_motor_request(None, time.monotonic())
        parts: dict[str, Any] = {}
        for name, supervisor in self.supervisors.items():
            health = supervisor.health
            values = {
                'connected': health.connected,
                'records': health.records,
                'losses': health.losses,
                'attempts': health.attempts,
                **self._latency[name].summary(),
            }
            level = OK if health.connected else WARN if health.waiting else ERROR
            parts[name] = (level, health.message, {**values, **self._statistics(name)})
        if self.base is not None:
            reason = self._standstill_reason()
            by_hand = self._teleoperation.is_active(time.monotonic(), self._teleop_timeout)
            topic = VehicleTopic.TELEOP_COMMAND if by_hand else VehicleTopic.VELOCITY_COMMAND
            driven = {
                'linear_m_s': self._safe.linear,
                'angular_rad_s': self._safe.angular,
                'motors_wanted': bool(self._motors_wanted),
                'commanded_by': topic.value,
            }
            parts['safety'] = (WARN if reason else OK, reason or 'as commanded', driven)
        self.outputs.publish_diagnostics(parts)

    def _standstill_reason(self) -> str:
        """Return all that keeps the vehicle from moving as commanded, '' if nothing does."""
        health = self.supervisors['base'].health
        if not health.connected:
            return f'base not connected: {health.message}'
        if not self._active:
            return 'the driver is inactive'
        reason = self._safe.all_reasons
        laser = self.supervisors.get('laser')
        if laser is not None and not laser.health.connected:
            reason = '; '.join(filter(None, (reason, f'laser: {laser.health.message}')))
        since = self._standing_since
        if not reason and since is not None and time.monotonic() - since > _STANDING:
            return (
                f'the base stands although {self._safe.linear:.2f} m/s, '
                f'{self._safe.angular:.2f} rad/s are commanded: '
                f'its own stall or bumper protection, a brake?{_explain_motors(self._state)}'
            )
        return reason

    def _statistics(self, name: str) -> dict[str, Any]:
        devices: dict[str, Device[Any] | None] = {
            'base': self.base, 'laser': self.laser, 'camera': self.camera,
        }  # fmt: skip
        device = devices[name]
        own = device.statistics() if device is not None else {}
        return {**own, **self.outputs.base_values} if name == 'base' else own


def _obeys(state: BaseState, request: MotorRequest) -> bool:
    """Return whether a base reports what enable_motors has asked for."""
    return state.motors_on == request.on and not (request.on and state.emergency_stop)


def _explain_motors(state: BaseState | None) -> str:
    """Return what the base reports that may keep its motors off, as the end of a sentence."""
    if state is None:
        return ''
    causes = []
    if state.emergency_stop:
        causes.append('emergency stop pressed: release it, then call enable_motors again')
    if state.charging:
        causes.append('a charger is connected')
    if state.faults:
        causes.append(f'fault flags {state.faults:#06x}')
    return f': {", ".join(causes)}' if causes else ''


class PioneerDriverNode(ManagedNode):
    """The driver of one vehicle as a managed node."""

    def __init__(self, **options: Any) -> None:
        super().__init__('pioneer_driver', **options)
        self._log_handler = RosLogHandler(self)
        logging.getLogger('explore_slam').addHandler(self._log_handler)
        logging.getLogger('explore_slam').setLevel(logging.INFO)
        vehicle = vehicle_name(self)
        config = declare_settings(self, DriverNodeConfig(), vehicle=vehicle)
        sensors = declare_settings(self, VehicleConfig(), vehicle=vehicle, names=_SENSORS)
        self._sensors = sensors
        self.config = config.with_vehicle(sensors)
        warn_of_unknown_vehicle_parameters(self, vehicle, values_of(PathFollowerConfig()))
        self._session: DriverSession | None = None
        self.add_on_set_parameters_callback(self._on_parameters)
        self.start(self.config.lifecycle.autostart)

    def configure(self) -> None:
        """Open the devices; fails if one cannot be opened.

        A node that starts by itself runs with the devices that it finds and retries the others.
        """
        session = DriverSession(self, self.config, self._sensors)
        session.open(patient=self.starting)
        self._session = session

    def activate(self) -> None:
        """Publish, and take velocities."""
        assert self._session is not None
        self._session.activate()

    def deactivate(self) -> None:
        """Bring the vehicle to rest; the devices stay open."""
        assert self._session is not None
        self._session.deactivate()

    def clean_up(self) -> None:
        """Switch the motors off, close the devices."""
        assert self._session is not None
        self._session.close()
        self._session = None

    def stop(self) -> None:
        """Bring the vehicle to rest and close the devices, in whatever state the node is."""
        super().stop()
        logging.getLogger('explore_slam').removeHandler(self._log_handler)

    def _on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        fixed = [item.name for item in parameters if item.name not in _CHANGEABLE]
        if fixed and self._session is not None:
            reason = f'{", ".join(fixed)}: set at start, or while the node is unconfigured'
            return SetParametersResult(successful=False, reason=reason)
        self.config, result = changed_settings(self.config, parameters)
        if self._session is not None:
            self._session.configure(self.config)
        return result


def main(arguments: list[str] | None = None) -> int:
    """Run the node; the entry point of the executable."""
    ask_for_priority()
    return run_node(PioneerDriverNode, arguments)
