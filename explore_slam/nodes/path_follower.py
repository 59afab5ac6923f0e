"""Node `path_follower`: plan, pose, odom and scan in, cmd_vel out; relative topics, one vehicle.

Reports on `follower_status` (std_msgs/String: 'driving', 'arrived', 'waiting: why',
'blocked: why') at every change and twice a second, and on /diagnostics.
"""

import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Odometry, Path
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Empty, String

from explore_slam.errors import DataError
from explore_slam.messages import (
    odometry_record,
    plan_record,
    planar_pose,
    scan_record,
    seconds,
    twist_message,
)
from explore_slam.nodes import heartbeat
from explore_slam.nodes.messages import MESSAGES
from explore_slam.nodes.vehicle_support import (
    LATCHED,
    OK,
    WARN,
    ask_for_priority,
    changed_settings,
    declare_settings,
    diagnostics_message,
    explain_silence,
    now_seconds,
    run_node,
    vehicle_name,
)
from explore_slam.vehicle import FollowerState, PathFollower, PathFollowerConfig, VelocityCommand

_SILENCE = 5.0  # s without a first message
_REPORT_PERIOD = 0.5  # s
_FAREWELL = 0.2  # s for the last command to arrive
_QUIET_AFTER = 1.0  # s of zero commands, then silence: another may drive the vehicle


class PathFollowerNode(Node):
    """Adapter between topics and PathFollower."""

    def __init__(self, **options: Any) -> None:
        super().__init__('path_follower', **options)
        self.follower = PathFollower(declare_settings(self, PathFollowerConfig()))
        self.vehicle = vehicle_name(self)
        self._command: VelocityCommand | None = None
        self._reported = -1.0
        self._driven = -1.0
        self._malformed = 0
        self._counts = dict.fromkeys(('plan', 'pose', 'odom', 'scan'), 0)
        self._heartbeat: float | None = None  # monotonic s
        self.create_subscription(Empty, heartbeat.TOPIC, self._on_heartbeat, heartbeat.QOS)
        self.create_subscription(Path, 'plan', self._on_plan, LATCHED)
        self.create_subscription(PoseWithCovarianceStamped, 'pose', self._on_pose, 10)
        self.create_subscription(Odometry, 'odom', self._on_odometry, qos_profile_sensor_data)
        self.create_subscription(LaserScan, 'scan', self._on_scan, qos_profile_sensor_data)
        self._velocity = self.create_publisher(Twist, 'cmd_vel', 1)
        self._status = self.create_publisher(String, 'follower_status', 10)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._silence_timer = self.create_timer(
            _SILENCE, self._explain_silence, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        self.add_on_set_parameters_callback(self._on_parameters)
        self._timer = self.create_timer(
            1.0 / self.follower.config.control_frequency, self._on_timer
        )

    def _on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        config, result = changed_settings(self.follower.config, parameters)
        if result.successful:
            self.follower.configure(config)
            self._timer.timer_period_ns = round(1e9 / config.control_frequency)
        return result

    def _on_plan(self, message: Path) -> None:
        self._take(
            'plan', lambda now: self.follower.set_plan(plan_record(message, self.vehicle), now)
        )

    def _on_pose(self, message: PoseWithCovarianceStamped) -> None:
        stamp = seconds(message.header.stamp)
        self._take(
            'pose', lambda now: self.follower.set_pose(stamp, planar_pose(message.pose.pose), now)
        )

    def _on_heartbeat(self, _: Empty) -> None:
        self._heartbeat = time.monotonic()

    def _on_odometry(self, message: Odometry) -> None:
        self._take('odom', lambda now: self.follower.set_odometry(odometry_record(message), now))

    def _on_scan(self, message: LaserScan) -> None:
        self._take('scan', lambda now: self.follower.set_scan(scan_record(message), now))

    def _explain_silence(self) -> None:
        """Say once, after some seconds, what has not come at all and why that may be."""
        self._silence_timer.cancel()
        for name, count in self._counts.items():
            if count == 0 and name != 'plan':  # an agent need not have a plan yet
                self.get_logger().warning(explain_silence(self, name, _SILENCE))

    def _take(self, name: str, hand_over: Any) -> None:
        """Hand a message to the follower; a malformed one is logged and counts as not come."""
        try:
            hand_over(now_seconds(self))
            self._counts[name] += 1
        except DataError as error:
            self._malformed += 1
            self.get_logger().warning(f'{name}: {error}', throttle_duration_sec=5.0)

    def _on_timer(self) -> None:
        now = now_seconds(self)
        if now == 0.0:  # simulated time has not begun
            return
        age = 0.0 if self._heartbeat is None else time.monotonic() - self._heartbeat
        command = self.follower.command(now, age)
        changed = self._command is None or command.state is not self._command.state
        self._command = command
        if command.state is FollowerState.DRIVING or now < self._driven:
            self._driven = now
        if now - self._driven < _QUIET_AFTER:
            self._velocity.publish(twist_message(MESSAGES, command.linear, command.angular))
        if changed or not 0.0 <= now - self._reported < _REPORT_PERIOD:
            self._reported = now
            self._report(command)

    def _report(self, command: VelocityCommand) -> None:
        state = command.state.value
        text = f'{state}: {command.reason}' if command.reason else state
        self._status.publish(String(data=text))
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
            'malformed_messages': self._malformed,
            **{f'{name}_messages': count for name, count in self._counts.items()},
        }
        fine = command.state in (FollowerState.DRIVING, FollowerState.ARRIVED)
        parts = {'path follower': (OK if fine else WARN, text, values)}
        self._diagnostics.publish(diagnostics_message(self, parts, self.vehicle))

    def stop(self) -> None:
        """Command rest, and wait until it has arrived: what is sent last is easily lost."""
        self._velocity.publish(twist_message(MESSAGES, 0.0, 0.0))
        self._status.publish(String(data='waiting: path follower has ended'))
        for publisher in (self._velocity, self._status):
            publisher.wait_for_all_acked(Duration(seconds=_FAREWELL))


def main(arguments: list[str] | None = None) -> int:
    """Run the node; the entry point of the executable."""
    ask_for_priority()
    return run_node(PathFollowerNode, arguments)


if __name__ == '__main__':
    sys.exit(main())
