"""Node `pioneer_driver`: base, laser and camera of one vehicle on relative topics.

Each device runs in a thread of its own. base_type, laser_type and camera_type select the devices,
enable_base, enable_laser and enable_camera switch them off.
Velocities pass the safety gate in the thread of the base, not in the executor's: even while the
executor is busy, the vehicle stops when commands or laser scans cease.
A managed node: configured, its devices are open; it publishes and drives while it is active.
"""

import logging
import sys
import threading
import time
from typing import Any

import numpy as np
from geometry_msgs.msg import Twist
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import LaserScan as ScanMessage
from std_srvs.srv import SetBool

from explore_slam.data import LaserScan, RgbdFrame
from explore_slam.errors import DataError, VehicleError
from explore_slam.geometry import to_world
from explore_slam.messages import scan_record
from explore_slam.messages.sensor_mounts import SensorMounts
from explore_slam.messages.topics import TopicKind, VehicleTopic
from explore_slam.messages.vehicle_settings import VehicleConfig
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
from explore_slam.nodes.transform_listener import own_mounts
from explore_slam.settings import values_of
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
    scan_points,
)
from explore_slam.vehicle.dead_reckoning import DeadReckoning

CONTROL_PERIOD = 0.02  # s between velocities sent to the base
_MOTOR_GRACE = 1.0  # s until a base reports that its motors were switched on
_BASE_STOP_TIMEOUT, _STOP_TIMEOUT = 3.0, 1.0  # s for a device to close; a base brakes first
_OPEN_TIMEOUT = 30.0  # s for all devices to be opened: a laser may try several baud rates
_NO_POINTS = np.empty((0, 2))
# settings of the vehicle, which the agent has too
_SENSORS = ('use_laser', 'laser_mount', 'camera_mount')
_CHANGEABLE = {*values_of(SafetyConfig()), 'use_sim_time'}  # while the node runs


class DriverSession:
    """The devices of a configured driver. Inactive, they are open, and the vehicle is stopped."""

    def __init__(self, node: Node, config: DriverNodeConfig) -> None:
        self._node = node
        self.config = config
        self._vehicle = vehicle_name(node)
        driver = config.driver
        self.outputs = DriverOutputs(node, config.frames(self._vehicle), driver, config.publish_tf)
        self._laser_pose = driver.laser_mount.pose
        self._mounts: SensorMounts | None = None  # of the laser of another driver
        limits = driver.base.maximum_speed, driver.base.maximum_turn_rate
        self._gate = SafetyGate(driver.safety, *limits)
        self._inputs = SafetyInputs()
        self._reckoning = DeadReckoning()
        self._seen: tuple[float, Any] = (0.0, _NO_POINTS)  # stamp and points of the newest scan
        self._safe = SafeVelocity(0.0, 0.0, 'base not connected')
        self._lock = threading.Lock()
        self._active = False
        self._motors_wanted: bool | None = None  # None before the first connection
        self._motors_asked = 0.0
        self._watched_scan = -np.inf
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
        for supervisor in self.supervisors.values():
            supervisor.start(patient)
        if patient:
            return
        until = time.monotonic() + _OPEN_TIMEOUT
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
            subscribe(self._node, VehicleTopic.VELOCITY_COMMAND, self._on_velocity)
            self._node.create_service(SetBool, 'enable_motors', self._on_enable_motors)
        if self.laser is None and self.config.watch_scan_topic:
            name, laser = self._vehicle, self.config.driver.laser_mount
            base = self.config.frames(name).base if self.base is not None else ''
            sensors = VehicleConfig(robot_base_frame=base)
            self._mounts = own_mounts(self._node, name, laser, sensors)
            subscribe(self._node, TopicKind.SCAN, self._on_watched_scan)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._node.create_timer(REPORT_PERIOD, self._report, clock=steady)
        with self._lock:
            self._active = True

    def deactivate(self) -> None:
        """Bring the vehicle to rest; the devices stay open."""
        with self._lock:
            self._active = False
            self._gate.command(0.0, 0.0, time.monotonic())

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

    def _on_velocity(self, message: Twist) -> None:
        with self._lock:
            self._gate.command(message.linear.x, message.angular.z, time.monotonic())

    def _on_enable_motors(self, request: Any, response: Any) -> Any:
        with self._lock:
            self._motors_wanted = bool(request.data)
            self._motors_asked = 0.0  # the thread of the base passes it on
        health = self.supervisors['base'].health
        response.success = health.connected
        word = 'on' if request.data else 'off'
        response.message = f'motors are switched {word}' if health.connected else health.message
        return response

    def _on_watched_scan(self, message: ScanMessage) -> None:
        try:
            scan = scan_record(message)
            if self._mounts is not None:
                scan = self._mounts.place_scan(scan, message.header.frame_id)
            self._keep_points(scan)
            self._watched_scan = time.monotonic()
        except DataError as error:
            self._node.get_logger().warning(f'scan: {error}', throttle_duration_sec=WARNING_PERIOD)

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

    def _on_state(self, state: BaseState) -> None:
        with self._lock:
            inputs = self._inputs
            inputs.bumpers_front = bool(state.front_bumpers)
            inputs.bumpers_rear = bool(state.rear_bumpers)
            inputs.stalled = state.stalled
            inputs.emergency_stop = state.emergency_stop
            inputs.sonar_points = _NO_POINTS if state.sonar_points is None else state.sonar_points
            self._reckoning.add_odometry(state.odometry)
        if self._active:
            self.outputs.publish_state(state, self.config.driver.base.use_sonar)
        self._latency['base'].add(now_seconds(self._node) - state.received)
        self._watch_motors(state.motors_on)

    def _watch_motors(self, on: bool) -> None:
        """Switch the motors as requested; accept that they are switched off at the robot later."""
        assert self.base is not None
        now = time.monotonic()
        if self._motors_asked == 0.0:
            self._motors_asked = now
            self.base.enable_motors(bool(self._motors_wanted))
        elif self._motors_wanted and not on and now - self._motors_asked > _MOTOR_GRACE:
            self._motors_wanted = False
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
                inputs.laser_last_received = self._watched_scan
            inputs.laser_points = self._points_now()
            self._safe = self._gate.update(inputs, now)
        self.base.set_velocity(self._safe.linear, self._safe.angular)

    def _points_now(self) -> Any:
        """Return the newest scan's points in the present vehicle frame: it is 0.2 s old."""
        stamp, points = self._seen
        moved = self._reckoning.odometry_at(now_seconds(self._node)).between(
            self._reckoning.odometry_at(stamp)
        )
        return to_world(moved, points)

    # -- threads of laser and camera -------------------------------------------------------------

    def _on_scan(self, scan: LaserScan) -> None:
        if self._active:
            self.outputs.publish_scan(scan)
        assert self.laser is not None
        self._latency['laser'].add(time.monotonic() - self.laser.last_received)
        self._keep_points(scan)

    def _keep_points(self, scan: LaserScan) -> None:
        points = scan_points(scan, scan.mount or self._laser_pose)
        with self._lock:
            self._seen = (scan.stamp, points)

    def _on_frame(self, frame: RgbdFrame) -> None:
        if self._active:
            self.outputs.publish_frame(frame)
        self._latency['camera'].add(now_seconds(self._node) - frame.stamp)

    # -- health ----------------------------------------------------------------------------------

    def _report(self) -> None:
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
            level = OK if health.connected else ERROR
            parts[name] = (level, health.message, {**values, **self._statistics(name)})
        if self.base is not None:
            reason = self._safe.reason
            values = {'linear_m_s': self._safe.linear, 'angular_rad_s': self._safe.angular}
            values['motors_wanted'] = bool(self._motors_wanted)
            parts['safety'] = (WARN if reason else OK, reason or 'as commanded', values)
        self.outputs.publish_diagnostics(parts)

    def _statistics(self, name: str) -> dict[str, Any]:
        devices: dict[str, Device[Any] | None] = {
            'base': self.base, 'laser': self.laser, 'camera': self.camera,
        }  # fmt: skip
        device = devices[name]
        own = device.statistics() if device is not None else {}
        return {**own, **self.outputs.base_values} if name == 'base' else own


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
        self.config = config.with_vehicle(sensors)
        warn_of_unknown_vehicle_parameters(self, vehicle, values_of(PathFollowerConfig()))
        self._session: DriverSession | None = None
        self.add_on_set_parameters_callback(self._on_parameters)
        self.start(self.config.lifecycle.autostart)

    def configure(self) -> None:
        """Open the devices; fails if one cannot be opened.

        A node that starts by itself runs with the devices that it finds and retries the others.
        """
        session = DriverSession(self, self.config)
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


if __name__ == '__main__':
    sys.exit(main())
