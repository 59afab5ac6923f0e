"""Vehicles with poor odometry, or none, over topics: the agent's node and a path follower."""

import importlib.util
import math
import time

import numpy as np
import pytest
import rclpy
import yaml
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import qos_profile_sensor_data
from ros_domain import own_domain
from sensor_msgs.msg import Imu, LaserScan

from explore_slam import messages
from explore_slam.data import ImuReading, OdometryReading
from explore_slam.data import LaserScan as Scan
from explore_slam.geometry import Pose2, yaw_from_quaternion
from explore_slam.live.processes import NodeProcess, NodeProcesses, one_machine_environment
from explore_slam.messages.imu import imu_message
from explore_slam.nodes.ros_types import MESSAGES
from explore_slam.simulation.worlds.walls import distances_along, distances_from
from explore_slam.studies.sensor_rig import FLOOR, START

DOMAIN = own_domain(80)
BEAMS, PERIOD = 360, 0.1  # number, s between scans
STEP = 2.0 * math.pi / BEAMS
BIAS = 0.03  # rad/s


class Vehicle:
    """A vehicle that drives as commanded; its wheels turn 1.4 times too far, if it has any."""

    def __init__(self, wheels):
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.node = rclpy.create_node('vehicle', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.pose, self.wheels, self.command = START, Pose2(0.0, 0.0, 0.0), (0.0, 0.0)
        self.has_wheels, self.driven = wheels, 0.0
        self.random = np.random.default_rng(0)
        self.heard, self.transforms = {}, {}
        self.true = []  # stamp (s), pose, and what the wheels have measured until then
        listen, publish = self.node.create_subscription, self.node.create_publisher
        listen(Twist, 'robot1/cmd_vel', self.on_command, 10)
        listen(PoseWithCovarianceStamped, 'robot1/pose', lambda m: self.heard.update(pose=m), 10)
        listen(Odometry, 'robot1/scan_odom', lambda m: self.heard.update(odom=m), 10)
        self.scans = publish(LaserScan, 'robot1/scan', qos_profile_sensor_data)
        if wheels:
            self.odom = publish(Odometry, 'robot1/odom', 10)
            self.imu = publish(Imu, 'robot1/imu', qos_profile_sensor_data)

    def on_command(self, message):
        self.command = (message.linear.x, message.angular.z)

    def listen_to_tf(self):
        from tf2_msgs.msg import TFMessage

        def take(message):
            for item in message.transforms:
                self.transforms[item.header.frame_id, item.child_frame_id] = item

        self.node.create_subscription(TFMessage, '/tf', take, 100)

    def spin(self, seconds):
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            rclpy.spin_once(self.node, executor=self.executor, timeout_sec=left)

    def scan(self, stamp):
        angles = -math.pi + STEP * np.arange(BEAMS)
        origins = np.tile([self.pose[:2]], (BEAMS, 1))
        ranges = distances_along(FLOOR, origins, self.pose.theta + angles)
        ranges = (ranges + 0.01 * self.random.standard_normal(BEAMS)).astype(np.float32)
        self.scans.publish(
            messages.scan_message(
                MESSAGES, Scan(stamp, -math.pi, STEP, ranges, 0.1, 20.0), 'laser'
            )
        )

    def drive(self, duration):
        """Drive as commanded; all that is measured is published at its time."""
        parts = 10
        begin, stamp = time.monotonic(), time.time()
        for number in range(round(duration / PERIOD)):
            for part in range(parts):
                share = PERIOD / parts
                stamp = time.time()
                speed, turn_rate = self.command
                step = Pose2(speed * share, 0.0, turn_rate * share)
                self.pose = self.pose.compose(step)
                self.driven += abs(step.x)
                self.wheels = self.wheels.compose(Pose2(step.x, 0.0, 1.4 * step.theta))
                self.true.append((stamp, self.pose, self.wheels))
                if self.has_wheels:
                    rate = turn_rate + BIAS + 0.003 * self.random.standard_normal()
                    self.imu.publish(
                        imu_message(MESSAGES, ImuReading(stamp, (0.0, 0.0, rate)), 'imu')
                    )
                    reading = OdometryReading(stamp, self.wheels)
                    self.odom.publish(
                        messages.odometry_message(MESSAGES, reading, 'odom', 'base_link')
                    )
                if part == 0:
                    self.scan(stamp)
                due = begin + number * PERIOD + (part + 1) * share
                self.spin(max(due - time.monotonic(), 0.001))

    def error(self):
        """Distance (m) of the newest pose from the truth at its stamp."""
        stamp = messages.seconds(self.heard['pose'].header.stamp)
        pose = messages.planar_pose(self.heard['pose'].pose.pose)
        return math.dist(pose[:2], self.at(stamp)[0][:2])

    def at(self, stamp):
        """Pose, and what the wheels have measured, at a stamp (s)."""
        known = min(self.true, key=lambda row: abs(row[0] - stamp))
        return known[1:]

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


def start(folder, odometry):
    values = {
        'vehicles': ['robot1'],
        'start_poses': list(START),
        'vision': 'none',
        'particles': 50,
        'pose_period': 0.05,
        'robot1': {'odometry': odometry, 'laser_mount': [0.0, 0.0, 0.0], 'sweep_time': 0.0},
    }
    file = folder / 'agent.yaml'
    file.write_text(yaml.safe_dump({'/**': {'ros__parameters': values}}))
    environment = {**one_machine_environment(), 'ROS_DOMAIN_ID': str(DOMAIN)}
    arguments = ['--ros-args', '--params-file', str(file)]
    nodes = [
        NodeProcess('agent', 'agent_node', arguments),
        NodeProcess('follower', 'path_follower', [*arguments, '-r', '__ns:=/robot1']),
    ]
    return NodeProcesses(nodes, folder / 'logs', environment)


@pytest.fixture(params=['scan', 'wheels+gyro'])
def driven(request, tmp_path):
    """A vehicle that has explored for some seconds, and the log of the agent."""
    vehicle = Vehicle(request.param != 'scan')
    if importlib.util.find_spec('tf2_msgs') is not None:
        vehicle.listen_to_tf()
    with start(tmp_path, request.param) as processes:
        deadline = time.monotonic() + 90.0
        while vehicle.scans.get_subscription_count() < 2:
            assert time.monotonic() < deadline, (tmp_path / 'logs' / 'agent.log').read_text()
            vehicle.spin(0.1)
        vehicle.drive(25.0)
        processes.check()
        yield vehicle, request.param, (tmp_path / 'logs' / 'agent.log').read_text()
    vehicle.close()


def test_it_explores_and_knows_where_it_is(driven):
    vehicle, odometry, log = driven
    assert vehicle.driven > 1.0, log
    assert distances_from(FLOOR, np.array([vehicle.pose[:2]])).min() > 0.2
    assert vehicle.error() < 0.05
    assert 'no odometry' not in log
    assert 'robot1/odom' not in log  # its silence is no fault
    tf = vehicle.transforms
    if odometry == 'scan':
        message = vehicle.heard['odom']
        names = (message.header.frame_id, message.child_frame_id)
        assert names == ('robot1/odom', 'robot1/base_link')
        if tf:
            assert ('robot1/odom', 'robot1/base_link') in tf
            assert ('map', 'robot1/odom') in tf
    else:
        assert 'odom' not in vehicle.heard
        if tf:
            # map -> odom completes the tree of the base, whose wheels turn too far
            stamp = messages.seconds(tf['map', 'odom'].header.stamp)
            item = tf['map', 'odom'].transform
            angle = yaw_from_quaternion(0.0, 0.0, item.rotation.z, item.rotation.w)
            offset = Pose2(item.translation.x, item.translation.y, angle)
            pose, wheels = vehicle.at(stamp)
            assert math.dist(offset.compose(wheels)[:2], pose[:2]) < 0.05
