"""Node `path_follower` of one vehicle: plan, pose, odom and scan in, cmd_vel out.

Publishes `follower_status` (diagnostic_msgs/DiagnosticStatus: its message is waiting, driving,
arrived, blocked or teleoperated; its values are the reason and since when) at every change and
twice a second, and /diagnostics. Commands on cmd_vel_teleop go before its own: it passes them on
to cmd_vel, and follows its plan again teleop_timeout after the last one. A managed node: inactive,
it has stopped the vehicle, which others may command.
"""

import math
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry, Path
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Empty

from explore_slam.data import FollowerReport, FollowerState
from explore_slam.errors import DataError
from explore_slam.messages import (
    odometry_record,
    plan_record,
    planar_pose,
    seconds,
)
from explore_slam.messages.follower_status import follower_status_message
from explore_slam.messages.measurement import VehicleReader
from explore_slam.messages.obstacles import obstacles_record
from explore_slam.messages.scans import SCAN
from explore_slam.messages.sweep_status import sweeps_record
from explore_slam.messages.topics import (
    SENSOR_DATA,
    GlobalTopic,
    SensorTopic,
    Topic,
    TopicKind,
    VehicleTopic,
)
from explore_slam.messages.vehicle_settings import VehicleConfig, odometry_topic
from explore_slam.nodes.driver_parameters import DriverNodeConfig
from explore_slam.nodes.endpoints import LatchedOrNotSubscription, publisher, subscribe
from explore_slam.nodes.managed_node import ManagedNode
from explore_slam.nodes.node_support import (
    OK,
    SILENCE,
    WARN,
    WARNING_PERIOD,
    ask_for_priority,
    changed_settings,
    declare_settings,
    diagnostics_message,
    explain_silence,
    now_seconds,
    run_node,
    vehicle_name,
    warn_of_unknown_vehicle_parameters,
)
from explore_slam.nodes.ros_types import MESSAGES
from explore_slam.nodes.shared_parameters import LifecycleConfig, TeleoperationConfig
from explore_slam.nodes.transform_listener import own_mounts
from explore_slam.nodes.velocity_topic import VelocityInput, VelocityOutput
from explore_slam.settings import values_of
from explore_slam.sweeps import SweepConfig
from explore_slam.vehicle import PathFollower, PathFollowerConfig, VelocityCommand
from explore_slam.vehicle.teleoperation import Teleoperation

_REPORT_PERIOD = 0.5  # s
_ACKNOWLEDGE_TIMEOUT = 0.2  # s for the last command to arrive
_QUIET_AFTER = 1.0  # s of zero commands, then none: another node may drive the vehicle
# settings of the vehicle, which the agent has too
_AT_START = dict.fromkeys(
    [
        *('odometry', 'use_laser', 'scans', 'laser_mount', 'odom_frame', 'robot_base_frame'),
        *('clouds', 'cloud_mount', 'cloud_lowest', 'cloud_highest'),
        *values_of(SweepConfig()),
    ],
    'set at start only',
)
_TELEOP_SILENCE = 0.6  # s without a command by hand after which the vehicle is told to stand
_FINE = (FollowerState.DRIVING, FollowerState.ARRIVED, FollowerState.TELEOPERATED)
_TELEOP = FollowerReport(FollowerState.TELEOPERATED, 'driven by cmd_vel_teleop')
_INPUTS = (VehicleTopic.PLAN, VehicleTopic.POSE, TopicKind.SCAN, TopicKind.OBSTACLES)


class PathFollowerOutputs:
    """Publishers of the node, which it has while it is configured."""

    def __init__(self, node: Node, vehicle: str, sensors: VehicleConfig) -> None:
        self._node = node
        self._vehicle = vehicle
        frame = sensors.robot_base_frame or f'{vehicle}/base_link'
        self.commands = VelocityOutput(node, sensors.cmd_vel_type, frame)
        self._status = publisher(node, VehicleTopic.FOLLOWER_STATUS)
        self._diagnostics = publisher(node, GlobalTopic.DIAGNOSTICS)

    def velocity(self, linear: float, angular: float) -> None:
        """Command a velocity (m/s, rad/s)."""
        self.commands.send(linear, angular)

    def status(self, report: FollowerReport) -> None:
        """Publish the state of the follower."""
        self._status.publish(follower_status_message(MESSAGES, self._vehicle, report))

    def diagnostics(self, level: bytes, text: str, values: Mapping[str, Any]) -> None:
        """Publish the health of the node."""
        parts = {'path follower': (level, text, values)}
        self._diagnostics.publish(diagnostics_message(self._node, parts, self._vehicle))

    def stop(self, reason: str) -> None:
        """Command zero velocity and wait until it has arrived: the last message is easily lost."""
        self.velocity(0.0, 0.0)
        self.status(FollowerReport(FollowerState.WAITING, reason, now_seconds(self._node)))
        for output in (self.commands, self._status):
            output.wait_for_all_acked(Duration(seconds=_ACKNOWLEDGE_TIMEOUT))


class ActiveFollower:
    """Adapter between topics and PathFollower, from the activation of the node on."""

    def __init__(
        self,
        node: Node,
        vehicle: str,
        config: PathFollowerConfig,
        sensors: VehicleConfig,
        teleoperation: TeleoperationConfig,
        outputs: PathFollowerOutputs,
    ) -> None:
        self._node = node
        self._vehicle = vehicle
        self._outputs = outputs
        self.teleoperation = teleoperation
        self._teleop = Teleoperation()
        self.follower = PathFollower(config, vehicle, bool(sensors.laser_topics))
        self._mounts = own_mounts(node, vehicle, config.laser_mount, sensors)
        self._lasers = VehicleReader((SCAN,), self._mounts)
        self._command: VelocityCommand | None = None
        self._reported = -1.0
        self._since = 0.0  # s; since when the state holds
        self._driven = -1.0
        self._malformed = 0
        self._odometry = odometry_topic(sensors)
        inputs = (*_INPUTS, VehicleTopic.SWEEPS, self._odometry)
        self._counts: dict[Topic, int] = dict.fromkeys(inputs, 0)
        self._heartbeat: float | None = None  # monotonic s
        subscribe(node, VehicleTopic.AGENT_ALIVE, self._on_heartbeat)
        self._by_hand = VelocityInput(
            node, {'': self._on_teleoperation}, VehicleTopic.TELEOP_COMMAND
        )
        # the agent's plans are latched, those of other planners and tools need not be; a plan that
        # arrives twice changes nothing
        LatchedOrNotSubscription(node, VehicleTopic.PLAN, self._on_plan)
        subscribe(node, VehicleTopic.POSE, self._on_pose)
        # only the newest readings matter here: no burst is kept
        subscribe(node, self._odometry, self._on_odometry, qos=SENSOR_DATA)
        self._silent_lasers = sensors.laser_topics
        for topic in sensors.laser_topics:
            subscribe(node, topic.kind, partial(self._on_scan, topic), name=topic.name)
        subscribe(node, VehicleTopic.SWEEPS, self._on_sweeps)
        subscribe(node, TopicKind.OBSTACLES, self._on_obstacles)
        self._silence_timer = node.create_timer(
            SILENCE, self._explain_silence, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        self._timer = node.create_timer(1.0 / config.control_frequency, self._on_timer)

    @property
    def period(self) -> float:
        """Time between commands (s)."""
        return float(self._timer.timer_period_ns) * 1e-9

    def close(self) -> None:
        """Take no more commands by hand; the other subscriptions are the node's."""
        self._by_hand.close()

    def configure(self, config: PathFollowerConfig) -> None:
        """Replace the settings."""
        self.follower.configure(config)
        self._timer.timer_period_ns = round(1e9 / config.control_frequency)

    def _on_teleoperation(self, linear: float, angular: float) -> None:
        self._teleop.command(time.monotonic())
        finite = math.isfinite(linear) and math.isfinite(angular)
        self._outputs.velocity(*((linear, angular) if finite else (0.0, 0.0)))

    def _on_plan(self, message: Path) -> None:
        self._take(
            VehicleTopic.PLAN,
            lambda now: self.follower.set_plan(plan_record(message, self._vehicle), now),
        )

    def _on_pose(self, message: PoseWithCovarianceStamped) -> None:
        stamp = seconds(message.header.stamp)
        self._take(
            VehicleTopic.POSE,
            lambda now: self.follower.set_pose(stamp, planar_pose(message.pose.pose), now),
        )

    def _on_heartbeat(self, _: Empty) -> None:
        self._heartbeat = time.monotonic()

    def _on_odometry(self, message: Odometry) -> None:
        self._mounts.add_odometry(message)
        self._take(
            self._odometry,
            lambda now: self.follower.set_odometry(odometry_record(message), now),
        )

    def _on_scan(self, topic: SensorTopic, message: Any) -> None:
        def take(now: float) -> None:
            found = self._lasers.read(topic.kind, message, topic.sensor)
            if found is not None:
                self.follower.set_scan(found[1], now)
                self._silent_lasers = [item for item in self._silent_lasers if item != topic]

        self._take(TopicKind.SCAN, take)

    def _on_obstacles(self, message: PointCloud2) -> None:
        self._take(
            TopicKind.OBSTACLES,
            lambda _: self.follower.set_obstacles(obstacles_record(message)),
        )

    def _on_sweeps(self, message: DiagnosticStatus) -> None:
        self._take(VehicleTopic.SWEEPS, lambda _: self.follower.set_sweeps(sweeps_record(message)))

    def _explain_silence(self) -> None:
        """Log once which inputs are missing, and the possible causes."""
        self._silence_timer.cancel()
        expected = (VehicleTopic.POSE, self._odometry)  # the agent need not have a plan yet
        missing = [topic.value for topic in expected if self._counts[topic] == 0]
        missing += [topic.name for topic in self._silent_lasers]
        for name in missing:
            self._node.get_logger().warning(explain_silence(self._node, name, SILENCE))

    def _take(self, topic: Topic, hand_over: Callable[[float], None]) -> None:
        """Pass a message to the follower; a malformed one is logged and omitted."""
        try:
            hand_over(now_seconds(self._node))
            self._counts[topic] += 1
        except DataError as error:
            self._malformed += 1
            self._node.get_logger().warning(
                f'{topic.value}: {error}', throttle_duration_sec=WARNING_PERIOD
            )

    def _on_timer(self) -> None:
        now = now_seconds(self._node)
        if now == 0.0:  # simulated time has not begun
            return
        age = 0.0 if self._heartbeat is None else time.monotonic() - self._heartbeat
        command = self.follower.command(now, age)
        by_hand = self._teleop.is_active(time.monotonic(), self.teleoperation.teleop_timeout)
        if by_hand:  # the follower knows no commands but its own: it begins anew
            self.follower.halt()
            if not self._teleop.is_active(time.monotonic(), _TELEOP_SILENCE):
                self._outputs.velocity(0.0, 0.0)
            command = VelocityCommand(0.0, 0.0, _TELEOP.state, _TELEOP.reason)
        changed = self._command is None or command.state is not self._command.state
        self._command = command
        if changed:
            self._since = now
        if command.state is FollowerState.DRIVING or now < self._driven:
            self._driven = now
        if now - self._driven < _QUIET_AFTER and not by_hand:
            self._outputs.velocity(command.linear, command.angular)
        if changed or not 0.0 <= now - self._reported < _REPORT_PERIOD:
            self._reported = now
            self._report(command)

    def _report(self, command: VelocityCommand) -> None:
        state = command.state.value
        text = f'{state}: {command.reason}' if command.reason else state
        self._outputs.status(FollowerReport(command.state, command.reason, self._since))
        progress, plan = self.follower.progress, self.follower.plan
        values = {
            'state': state,
            'reason': command.reason,
            'remaining_m': progress.remaining,
            'cross_track_m': progress.cross_track,
            'free_m': progress.free,
            'goal': '' if plan is None else f'{plan.goal.x:.2f} {plan.goal.y:.2f}',
            'linear_m_s': command.linear,
            'angular_rad_s': command.angular,
            'cmd_vel_type': ' and '.join(self._outputs.commands.types),
            'malformed_messages': self._malformed,
            **{f'{topic.value}_messages': count for topic, count in self._counts.items()},
        }
        fine = command.state in _FINE
        self._outputs.diagnostics(OK if fine else WARN, text, values)


class PathFollowerNode(ManagedNode):
    """The path follower of one vehicle; while it is inactive it commands nothing."""

    def __init__(self, **options: Any) -> None:
        super().__init__('path_follower', **options)
        self._vehicle = vehicle_name(self)
        self.config = declare_settings(self, PathFollowerConfig(), vehicle=self._vehicle)
        self._sensors = declare_settings(
            self, VehicleConfig(), _AT_START, self._vehicle, {*_AT_START, 'cmd_vel_type'}
        )
        self._teleoperation = declare_settings(self, TeleoperationConfig())
        self._lifecycle = declare_settings(self, LifecycleConfig())
        warn_of_unknown_vehicle_parameters(self, self._vehicle, values_of(DriverNodeConfig()))
        self._outputs: PathFollowerOutputs | None = None
        self.active: ActiveFollower | None = None
        self.add_on_set_parameters_callback(self._on_parameters)
        self.start(self._lifecycle.autostart)

    def _on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        fixed = [item.name for item in parameters if item.name in _AT_START]
        if fixed:
            reason = f'{", ".join(fixed)}: set at start only'
            return SetParametersResult(successful=False, reason=reason)
        self.config, result = changed_settings(self.config, parameters)
        if result.successful:
            self._teleoperation, result = changed_settings(self._teleoperation, parameters)
        if result.successful:
            self._sensors, result = changed_settings(self._sensors, parameters)
        if not result.successful:
            return result
        if self._outputs is not None:
            self._outputs.commands.configure(self._sensors.cmd_vel_type)
        if self.active is not None:
            self.active.teleoperation = self._teleoperation
            self.active.configure(self.config)
        return result

    def configure(self) -> None:
        """Create the publishers."""
        self._outputs = PathFollowerOutputs(self, self._vehicle, self._sensors)

    def activate(self) -> None:
        """Begin to follow plans; nothing of an earlier activation is known any more."""
        assert self._outputs is not None
        self.active = ActiveFollower(
            self, self._vehicle, self.config, self._sensors, self._teleoperation, self._outputs
        )

    def deactivate(self) -> None:
        """Stop the vehicle."""
        assert self._outputs is not None
        if self.active is not None:
            self.active.close()
        self.active = None
        self._outputs.stop('path follower is inactive')

    def clean_up(self) -> None:
        """Release the publishers."""
        assert self._outputs is not None
        self._outputs.commands.close()
        self._outputs = None


def main(arguments: list[str] | None = None) -> int:
    """Run the node; the entry point of the executable."""
    ask_for_priority()
    return run_node(PathFollowerNode, arguments)
