"""The follower's node with real topics: plan, pose, odom, scan in; cmd_vel and status out."""

import math
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Path
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from ros_domain import own_domain

from explore_slam import messages
from explore_slam.data import LaserScan, ObstacleView, OdometryReading
from explore_slam.geometry import Pose2
from explore_slam.messages.follower_status import follower_report
from explore_slam.nodes.ros_types import MESSAGES, message_class

DOMAIN = own_domain(71)
LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


class Harness:
    """A vehicle that drives as commanded, on topics of a namespace, in this process."""

    def __init__(self, context, command_type=Twist):
        self.node = rclpy.create_node('harness', namespace='/robot7', context=context)
        self.executor = rclpy.executors.SingleThreadedExecutor(context=context)
        self.executor.add_node(self.node)
        self.pose, self.velocity, self.states, self.parts = Pose2(0, 0, 0), (0.0, 0.0), [], []
        self.commands = []
        take = self.on_velocity if command_type is Twist else self.on_stamped
        self.node.create_subscription(command_type, 'cmd_vel', take, 10)
        self.node.create_subscription(DiagnosticStatus, 'follower_status', self.on_state, 10)
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self.parts.append, 10)
        self.plan = self.node.create_publisher(Path, 'plan', LATCHED)
        kinds = {
            'pose': 'geometry_msgs/PoseWithCovarianceStamped',
            'odom': 'nav_msgs/Odometry',
            'scan': 'sensor_msgs/LaserScan',
            'obstacles': 'sensor_msgs/PointCloud2',
        }
        self.out = {
            name: self.node.create_publisher(message_class(kind), name, 10)
            for name, kind in kinds.items()
        }
        self.wall = None

    def on_velocity(self, message):
        self.velocity = (message.linear.x, message.angular.z)
        self.commands.append((time.monotonic(), *self.velocity))

    def on_stamped(self, message):
        assert abs(messages.seconds(message.header.stamp) - self.now()) < 5.0
        assert message.header.frame_id == 'robot7/base_link'
        self.on_velocity(message.twist)

    def state(self):
        return self.states[-1] if self.states else ''

    def on_state(self, message):
        report = follower_report(message)
        text = f'{report.state.value}: {report.reason}' if report.reason else report.state.value
        assert 0.0 < report.since <= self.now()
        if not self.states or self.states[-1] != text:
            self.states.append(text)

    def now(self):
        return self.node.get_clock().now().nanoseconds * 1e-9

    def spin(self, seconds, until=lambda: False, send=('pose', 'odom', 'scan')):
        end = time.monotonic() + seconds
        last = time.monotonic()
        while time.monotonic() < end and not until():
            self.executor.spin_once(timeout_sec=0.02)
            present = time.monotonic()
            if present - last < 0.05:
                continue
            v, w = self.velocity
            self.pose = self.pose.compose(Pose2(v * (present - last), 0.0, w * (present - last)))
            last = present
            self.publish(send)
        return until()

    def publish(self, send):
        now = self.now()
        if 'odom' in send:
            reading = OdometryReading(now, self.pose)
            self.out['odom'].publish(
                messages.odometry_message(MESSAGES, reading, 'odom', 'base_link')
            )
        if 'pose' in send:
            self.out['pose'].publish(
                messages.estimate_message(MESSAGES, now, 'map', self.pose, np.eye(3) * 1e-4)
            )
        if 'scan' in send:
            ranges = np.full(181, 5.0, np.float32)
            if self.wall is not None:
                ranges[80:101] = max(self.wall - self.pose.x - 0.1, 0.05)
            scan = LaserScan(now, -math.pi / 2, math.pi / 180, ranges, 0.01, 8.0)
            self.out['scan'].publish(messages.scan_message(MESSAGES, scan, 'laser'))

    def send_plan(self, points):
        self.plan.publish(
            messages.path_message(MESSAGES, self.now(), 'map', np.asarray(points, float))
        )


@pytest.fixture
def harness(request):
    context = rclpy.Context()
    context.init(domain_id=DOMAIN)
    made = Harness(context, getattr(request, 'param', Twist))
    yield made
    made.node.destroy_node()
    context.try_shutdown()


def follower_process(domain, *arguments):
    """Start the node on a domain."""
    environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain), 'ROS_PYTHON_CHECK_FIELDS': '1'}
    return subprocess.Popen(
        [
            sys.executable, '-m', 'explore_slam.nodes.executables', 'path_follower', '--ros-args',
            '-r', '__ns:=/robot7', '-p', 'follow_speed:=1', '-p', 'follow_acceleration:=1.0',
            '-p', 'teleop_timeout:=1.0',
            *arguments,
        ],
        env=environment,
        stderr=subprocess.PIPE,
        text=True,
    )  # fmt: skip


@pytest.fixture
def follower():
    process = follower_process(DOMAIN)
    yield process
    if process.poll() is None:
        process.kill()
    process.communicate()


@pytest.mark.parametrize('harness', [TwistStamped], indirect=True)
def test_drives_a_base_that_takes_stamped_commands_only(harness, follower):
    harness.send_plan([[0, 0], [0.4, 0.0]])
    assert harness.spin(20, lambda: harness.state().startswith('arrived'))
    assert harness.pose.x == pytest.approx(0.4, abs=0.2)
    follower.send_signal(signal.SIGTERM)
    assert harness.spin(5, lambda: harness.velocity == (0.0, 0.0))
    errors = follower.communicate(timeout=10)[1]
    assert errors.count('cmd_vel is sent as TwistStamped') == 1
    assert 'which none of its subscribers takes' not in errors


def test_drives_a_plan_stops_before_a_wall_for_teleoperation_and_at_sigterm(harness, follower):
    assert harness.spin(20, lambda: 'waiting: no plan yet' in harness.states)
    assert harness.commands == []  # idle: another may drive
    harness.send_plan([[0, 0], [1.0, 0.3]])
    assert harness.spin(20, lambda: harness.state().startswith('arrived'))
    assert math.hypot(harness.pose.x - 1.0, harness.pose.y - 0.3) < 0.2
    harness.wall = 2.5
    harness.send_plan([[harness.pose.x, harness.pose.y], [4.0, harness.pose.y]])
    assert harness.spin(20, lambda: harness.state().startswith('blocked: obstacle'))
    assert harness.velocity == (0.0, 0.0)
    assert harness.pose.x < 2.5 - 0.25 - 0.15
    text = [status for message in harness.parts for status in message.status]
    assert any(status.name == 'robot7/path_follower: path follower' for status in text)
    harness.wall = None
    assert harness.spin(10, lambda: harness.velocity[0] > 0.3)
    by_hand = harness.node.create_publisher(Twist, 'cmd_vel_teleop', 1)
    assert harness.spin(5, lambda: by_hand.get_subscription_count() > 0)
    for _ in range(8):
        by_hand.publish(messages.twist_message(MESSAGES, -0.25, 0.0))
        harness.spin(0.05)
    assert harness.spin(2, lambda: harness.velocity == (-0.25, 0.0))
    assert harness.spin(2, lambda: harness.state().startswith('teleoperated'))
    # nothing more by hand: the vehicle stands, then the plan is followed again
    assert harness.spin(2, lambda: harness.velocity == (0.0, 0.0))
    assert harness.spin(5, lambda: harness.velocity[0] > 0.3 and harness.state() == 'driving')
    follower.send_signal(signal.SIGTERM)
    follower.send_signal(signal.SIGINT)
    ok = harness.spin(5, lambda: follower.poll() is not None and harness.velocity == (0.0, 0.0))
    assert ok, (follower.poll(), harness.velocity, harness.commands[-3:], time.monotonic())
    assert follower.returncode == 0


@pytest.mark.usefixtures('follower')
def test_stops_before_a_table_top_that_only_a_camera_sees(harness):
    harness.send_plan([[0, 0], [6.0, 0]])
    assert harness.spin(30, lambda: harness.pose.x > 0.5)
    edge = harness.pose.x + 1.5
    cells = np.array([(x, y) for x in range(30, 38) for y in range(-8, 8)], np.int16)
    top, none = np.full(len(cells), 1 << 6, np.uint16), np.zeros(len(cells), np.uint16)
    view = ObstacleView(harness.now(), cells, top, none)
    harness.out['obstacles'].publish(messages.obstacles_message(MESSAGES, view, 'base_link'))
    stopped = (0.0, 0.0)
    assert harness.spin(20, lambda: 'obstacle' in harness.state() and harness.velocity == stopped)
    assert harness.pose.x < edge - 0.25


@pytest.mark.usefixtures('follower')
def test_stops_when_the_laser_falls_silent(harness):
    harness.send_plan([[0, 0], [30.0, 0]])
    assert harness.spin(30, lambda: harness.velocity[0] > 0.3)
    assert harness.spin(5, lambda: harness.velocity == (0.0, 0.0), send=('pose', 'odom'))
    assert harness.spin(5, lambda: 'laser silent' in harness.state(), send=('pose', 'odom'))
