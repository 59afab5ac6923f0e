"""The driver's node as a process of its own, between emulated hardware and real topics."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from nav_msgs.msg import Odometry
from ros_domain import own_domain
from sensor_msgs.msg import BatteryState, LaserScan, PointCloud2
from std_srvs.srv import SetBool

from explore_slam.messages import odometry_record, scan_record, twist_message
from explore_slam.nodes.ros_types import MESSAGES
from explore_slam.simulation.emulators.kinematic_body import KinematicBody
from explore_slam.simulation.emulators.vehicle_emulator import VehicleEmulator
from explore_slam.vehicle.arcos_packets import Command

DOMAIN = own_domain(72)
PACKET = 0.1  # s between status packets


class Rig:
    """Emulated vehicle, driver process, and a node that listens and commands at 20 Hz."""

    def __init__(self, folder, context, domain):
        self.folder, self.domain = folder, domain
        self.body = KinematicBody()
        self.emulator = VehicleEmulator(folder, 'robot7', self.body, self.body.scan).start()
        self.node = rclpy.create_node('rig', namespace='/robot7', context=context)
        self.executor = rclpy.executors.SingleThreadedExecutor(context=context)
        self.executor.add_node(self.node)
        self.got = {name: [] for name in ('odom', 'scan', 'battery', 'sonar')}
        self.parts, self.command, self.driver = {}, None, None
        for name, kind in (
            ('odom', Odometry), ('scan', LaserScan), ('battery', BatteryState),
            ('sonar', PointCloud2),
        ):  # fmt: skip
            self.node.create_subscription(kind, name, self.got[name].append, 10)
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self.on_diagnostics, 10)
        self.velocity = self.node.create_publisher(Twist, 'cmd_vel', 1)
        self.motors = self.node.create_client(SetBool, 'enable_motors')
        self.sent = 0.0

    def start(self, stderr=None, **parameters):
        given = {
            'base_port': str(self.folder / 'robot7_base'),
            'laser_port': str(self.folder / 'robot7_laser'),
            'enable_camera': False,
            **parameters,
        }
        arguments = ['-r', '__ns:=/robot7']
        for name, value in given.items():
            text = str(value).lower() if isinstance(value, bool) else str(value)
            arguments += ['-p', f'{name}:={text}']
        node = [sys.executable, '-m', 'explore_slam.nodes.executables', 'pioneer_driver']
        self.driver = subprocess.Popen(
            [*node, '--ros-args', *arguments],
            env={
                **os.environ, 'ROS_DOMAIN_ID': str(self.domain), 'ROS_PYTHON_CHECK_FIELDS': '1',
                'ROS_HOME': str(self.folder),
            },
            stderr=stderr,
            text=True,
        )  # fmt: skip
        return self

    def end(self):
        """End driver and emulator."""
        if self.driver is not None and self.driver.poll() is None:
            self.driver.terminate()
            try:
                self.driver.wait(8.0)
            except subprocess.TimeoutExpired:
                self.driver.kill()
        self.emulator.stop()
        self.node.destroy_node()

    def on_diagnostics(self, message):
        for status in message.status:
            self.parts[status.name.rpartition(': ')[2]] = (status.level, status.message)

    def spin(self, seconds, until=lambda: False):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.01)
            now = time.monotonic()
            if self.command is not None and now - self.sent >= 0.05:
                self.sent = now
                self.velocity.publish(twist_message(MESSAGES, *self.command))
            if until():
                return True
        return until()

    def enable(self, on=True):
        assert self.motors.wait_for_service(10.0)
        future = self.motors.call_async(SetBool.Request(data=on))
        assert self.spin(5.0, future.done)
        return future.result()

    def motor_commands(self):
        """Return the arguments of all ENABLE commands that have reached the robot."""
        commands = list(self.emulator.robot.commands)
        return [value for _, command, value in commands if command == Command.ENABLE]

    def drive(self, linear=0.4, angular=0.0):
        self.command = (linear, angular)
        assert self.spin(20.0, lambda: len(self.got['odom']) > 1 and self.got['scan'])
        assert self.enable().success
        assert self.spin(5.0, lambda: self.body.velocity()[0] > 0.95 * linear)

    def time_to_stop_command(self, limit=2.0):
        """Return how long (s) from now until the robot is told to stand."""
        began = time.monotonic()
        assert self.spin(limit, lambda: self.emulator.robot.commanded == (0.0, 0.0))
        return time.monotonic() - began

    def message(self, part):
        return self.parts.get(part, (None, ''))[1]


@pytest.fixture
def rig(tmp_path):
    context = rclpy.Context()
    context.init(domain_id=DOMAIN)
    made = Rig(tmp_path, context, DOMAIN)
    yield made
    made.end()
    context.try_shutdown()


def test_gives_what_the_agent_needs_and_only_drives_when_motors_are_enabled(rig):
    rig.emulator.robot.sonar = {0: 1.0, 3: 2.0}
    rig.body.obstacles = [(5.0, 0.0, 0.5)]
    rig.start()
    rig.command = (0.4, 0.2)
    assert rig.spin(20.0, lambda: len(rig.got['odom']) > 5 and len(rig.got['scan']) > 3)
    assert rig.body.velocity() == (0.0, 0.0)
    assert not rig.emulator.robot.motors_on
    assert rig.enable().success
    assert rig.spin(5.0, lambda: rig.body.velocity()[0] > 0.38)
    assert rig.spin(5.0, lambda: rig.body.odometry().theta > 0.2)
    rig.command = (0.0, 0.0)
    assert rig.spin(3.0, lambda: rig.body.velocity() == (0.0, 0.0))
    counts = {name: len(rig.got[name]) for name in ('odom', 'scan')}
    # the next but one was measured at rest
    assert rig.spin(3.0, lambda: all(len(rig.got[n]) > 1 + c for n, c in counts.items()))
    odometry = rig.got['odom'][-1]
    assert (odometry.header.frame_id, odometry.child_frame_id) == (
        'robot7/odom',
        'robot7/base_link',
    )
    assert odometry_record(odometry).pose == pytest.approx(tuple(rig.body.odometry()), abs=0.002)
    assert odometry_record(odometry).covariance is not None
    moving = max(message.twist.twist.linear.x for message in rig.got['odom'])
    assert moving == pytest.approx(0.4, abs=0.01)
    scan = scan_record(rig.got['scan'][-1])
    assert rig.got['scan'][-1].header.frame_id == 'robot7/laser'
    truth = rig.body.scan().ranges
    known = np.isfinite(truth)
    assert known.any()
    np.testing.assert_allclose(scan.ranges[known], truth[known], atol=0.01)
    assert rig.got['battery'][-1].voltage == pytest.approx(12.6)
    assert rig.got['sonar'][-1].width == 2
    assert rig.spin(3.0, lambda: rig.message('base') and rig.message('laser'))
    assert 'no camera' not in rig.parts


def test_stops_when_commands_fall_silent(rig):
    rig.start().drive()
    rig.command = None
    assert rig.time_to_stop_command() <= 0.3 + PACKET + 0.1
    assert rig.spin(2.0, lambda: 'no command' in rig.message('safety'))
    assert rig.emulator.robot.motors_on  # a silent host is no reason to roll free


def test_stops_when_the_laser_falls_silent(rig):
    rig.start().drive()
    rig.emulator.laser_line.faults.silent = True
    assert rig.time_to_stop_command() <= 0.3 + PACKET + 0.1
    assert rig.spin(2.0, lambda: 'laser' in rig.message('safety'))
    rig.emulator.laser_line.faults.silent = False
    assert rig.spin(15.0, lambda: rig.body.velocity()[0] > 0.3)


@pytest.mark.parametrize('signals', [[signal.SIGTERM], [signal.SIGINT, signal.SIGINT]])
def test_the_end_of_the_process_brings_the_vehicle_to_rest(rig, signals):
    rig.start().drive()
    for number in signals:
        rig.driver.send_signal(number)
        time.sleep(0.02)
    assert rig.time_to_stop_command() <= 0.3 + PACKET
    assert rig.spin(5.0, lambda: rig.driver.poll() is not None)
    assert rig.driver.returncode == 0
    assert rig.body.velocity() == (0.0, 0.0)
    assert not rig.emulator.robot.motors_on
    assert not rig.emulator.robot.session_open


def test_stops_before_an_obstacle_and_for_bumpers_whatever_is_commanded(rig):
    rig.body.obstacles = [(2.0, 0.0, 0.2)]
    rig.start().drive(0.5)
    assert rig.spin(10.0, lambda: rig.body.velocity() == (0.0, 0.0))
    assert 0.13 <= 2.0 - 0.2 - 0.25 - rig.body.odometry().x < 0.4
    rig.body.obstacles = []
    assert rig.spin(5.0, lambda: rig.body.velocity()[0] > 0.3)
    rig.emulator.robot.faults.front_bumpers = 1
    assert rig.time_to_stop_command() <= 0.3 + PACKET
    rig.command = (-0.2, 0.0)
    assert rig.spin(3.0, lambda: rig.body.velocity()[0] < -0.1)  # away is allowed


@pytest.mark.parametrize('again', [False, True])
def test_a_pulled_cable_is_found_again_within_three_seconds(rig, again):
    rig.start(motors_after_reconnect=again).drive(0.3)
    rig.emulator.base_line.unplug()
    rig.emulator.laser_line.unplug()
    lost = [rig.message(part) for part in ('base', 'laser')]
    assert rig.spin(5.0, lambda: not {rig.message('base'), rig.message('laser')} & set(lost))
    count, scans = len(rig.got['odom']), len(rig.got['scan'])
    rig.emulator.base_line.plug()
    rig.emulator.laser_line.plug()
    assert rig.spin(3.0, lambda: len(rig.got['odom']) > count and len(rig.got['scan']) > scans)
    count = len(rig.got['odom'])  # the driver asks for the motors with the first state
    assert rig.spin(3.0, lambda: len(rig.got['odom']) > count + 5)
    assert rig.emulator.robot.motors_on == again
    if not again:
        assert rig.enable().success
    assert rig.spin(5.0, lambda: rig.body.velocity()[0] > 0.25)


def test_one_part_that_is_missing_leaves_the_others_alone(rig):
    rig.start(base_port='/dev/no_such_robot', enable_camera=True, camera_index=15)
    assert rig.spin(20.0, lambda: len(rig.got['scan']) > 2 and 'base' in rig.parts)
    assert 'no such port' in rig.message('base')
    assert rig.spin(5.0, lambda: 'Kinect' in rig.message('camera'))
    assert rig.spin(5.0, lambda: 'LMS200' in rig.message('laser'))
    assert not rig.enable().success


def test_exchanged_ports_are_named(rig):
    rig.start(
        base_port=str(rig.folder / 'robot7_laser'), laser_port=str(rig.folder / 'robot7_base'),
        base_baud=9600,
    )  # fmt: skip
    assert rig.spin(25.0, lambda: 'SYNC' in rig.message('base') or 'SICK' in rig.message('base'))
    assert rig.spin(15.0, lambda: 'LMS-200' in rig.message('laser'))


def test_honest_answers_and_teleoperation_before_the_follower(rig):
    rig.start(teleop_timeout=1.0)
    rig.command = (0.3, 0.0)
    robot = rig.emulator.robot
    assert rig.spin(20.0, lambda: rig.got['odom'] and 'motors off' in rig.message('safety'))
    robot.faults.emergency_stop = True
    assert rig.spin(5.0, lambda: 'emergency stop pressed; motors' in rig.message('safety'))
    refused = rig.enable()
    assert not refused.success
    assert 'still reports motors off: emergency stop pressed' in refused.message
    # a repetition of the request may still be on its way
    assert rig.spin(3.0, lambda: rig.motor_commands()[-1] == 0)
    robot.faults.emergency_stop = False
    count = len(rig.got['odom'])
    assert rig.spin(3.0, lambda: len(rig.got['odom']) > count + 2)
    assert not robot.motors_on  # a refused request does not wait for the button
    allowed = rig.enable()
    assert (allowed.success, allowed.message) == (True, 'the base reports motors on')
    assert rig.spin(5.0, lambda: rig.body.velocity()[0] > 0.25)
    by_hand = rig.node.create_publisher(Twist, 'cmd_vel_teleop', 1)
    assert rig.spin(5.0, lambda: by_hand.get_subscription_count() > 0)
    end = time.monotonic() + 5.0
    while rig.body.velocity()[0] >= 0.0 and time.monotonic() < end:
        by_hand.publish(twist_message(MESSAGES, -0.2, 0.0))
        rig.spin(0.05)
    assert rig.body.velocity()[0] < 0.0
    assert rig.spin(4.0, lambda: rig.body.velocity()[0] > 0.25)  # the follower again
    assert rig.enable(on=False).message == 'the base reports motors off'
    rig.emulator.base_line.faults.silent = True  # while the call waits
    assert not rig.enable().success
    rig.emulator.base_line.unplug()
    assert rig.spin(5.0, lambda: rig.message('safety').startswith('base not connected: '))
    assert not rig.enable().success


def test_a_request_that_a_deactivation_refuses_is_not_obeyed_later(rig):
    rig.start()
    assert rig.spin(20.0, lambda: rig.got['odom'])
    rig.emulator.robot.faults.emergency_stop = True
    change = rig.node.create_client(ChangeState, 'pioneer_driver/change_state')
    assert rig.motors.wait_for_service(10.0)
    assert change.wait_for_service(10.0)
    asked = rig.motors.call_async(SetBool.Request(data=True))
    assert rig.spin(5.0, lambda: 1 in rig.motor_commands())
    transition = Transition(id=Transition.TRANSITION_DEACTIVATE)
    changed = change.call_async(ChangeState.Request(transition=transition))
    assert rig.spin(5.0, lambda: changed.done() and asked.done())
    assert changed.result().success
    assert (asked.result().success, asked.result().message) == (False, 'the driver is deactivated')
    assert rig.spin(3.0, lambda: rig.motor_commands()[-1] == 0)
    again = rig.enable()
    assert (again.success, again.message) == (False, 'the driver is inactive')
