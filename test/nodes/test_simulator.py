"""The simulator's node as a process: topics of a real vehicle, truth, clock, pace, signals."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from ros_domain import own_domain
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, LaserScan

from explore_slam import messages
from explore_slam.geometry import Pose2
from explore_slam.messages.base import OPTICAL, transform_message
from explore_slam.messages.frame_pairing import FramePairing
from explore_slam.nodes.ros_types import MESSAGES

DOMAIN = own_domain(76)
TOPICS = {
    'odom': Odometry,
    'ground_truth': Odometry,
    'scan': LaserScan,
    'camera/rgb/image_raw': Image,
    'camera/depth_registered/image_raw': Image,
    'camera/rgb/camera_info': CameraInfo,
}
SMALL = ('simulated_image_width:=160', 'simulated_image_height:=120')


class Listener:
    """Hears what an agent hears, and commands."""

    def __init__(self, context):
        self.node = rclpy.create_node('listener', context=context)
        self.executor = rclpy.executors.SingleThreadedExecutor(context=context)
        self.executor.add_node(self.node)
        self.heard, self.parts, self.time = {}, {}, 0.0
        for vehicle in ('robot1', 'robot2'):
            for name, kind in TOPICS.items():
                topic = f'{vehicle}/{name}'
                self.heard[topic] = []
                self.node.create_subscription(
                    kind, topic, self.heard[topic].append, qos_profile_sensor_data
                )
        self.node.create_subscription(Clock, '/clock', self.on_clock, qos_profile_sensor_data)
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self.on_parts, 10)
        self.velocity = self.node.create_publisher(Twist, 'robot1/cmd_vel', 1)
        self.poses = {
            name: self.node.create_publisher(PoseWithCovarianceStamped, f'{name}/pose', 10)
            for name in ('robot1', 'robot2')
        }

    def on_clock(self, message):
        self.time = messages.seconds(message.clock)

    def on_parts(self, message):
        for status in message.status:
            self.parts[status.name] = {pair.key: pair.value for pair in status.values}

    def spin(self, seconds, until=lambda: False):
        end = time.monotonic() + seconds
        while time.monotonic() < end and not until():
            self.executor.spin_once(timeout_sec=0.02)
        return until()

    def say_pose(self, vehicle, stamp):
        message = messages.estimate_message(
            MESSAGES, stamp, 'map', Pose2(0, 0, 0), np.eye(3) * 1e-4
        )
        self.poses[vehicle].publish(message)

    def drive(self, linear, angular=0.0):
        self.velocity.publish(messages.twist_message(MESSAGES, linear, angular))


@pytest.fixture
def listener():
    context = rclpy.Context()
    context.init(domain_id=DOMAIN)
    made = Listener(context)
    yield made
    made.node.destroy_node()
    context.try_shutdown()


def launch(*parameters, world='small'):
    environment = {
        **os.environ, 'ROS_DOMAIN_ID': str(DOMAIN), 'ROS_PYTHON_CHECK_FIELDS': '1',
    }  # fmt: skip
    pairs = [part for value in (f'world:={world}', *parameters) for part in ('-p', value)]
    node = [sys.executable, '-m', 'explore_slam.nodes.executables', 'simulator']
    return subprocess.Popen(
        [*node, '--ros-args', *pairs],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


@pytest.fixture
def start():
    processes = []

    def run(*parameters, world='small'):
        processes.append(launch(*parameters, world=world))
        return processes[-1]

    yield run
    for process in processes:
        process.kill()
        process.wait()
        process.stdout.close()


def test_topics_frames_and_stamps_are_those_of_a_real_vehicle(start, listener):
    start(*SMALL, 'seed:=3')
    everything = listener.heard
    assert listener.spin(20.0, lambda: all(len(m) > 1 for m in everything.values()))
    for vehicle in ('robot1', 'robot2'):
        odom = everything[f'{vehicle}/odom'][-1]
        assert (odom.header.frame_id, odom.child_frame_id) == (
            f'{vehicle}/odom', f'{vehicle}/base_link',
        )  # fmt: skip
        truth = everything[f'{vehicle}/ground_truth'][-1]
        assert truth.header.frame_id == 'map'
        assert messages.scan_record(everything[f'{vehicle}/scan'][-1]).ranges.size == 361
        assert everything[f'{vehicle}/scan'][-1].header.frame_id == f'{vehicle}/laser'
        color = everything[f'{vehicle}/camera/rgb/image_raw'][-1]
        by_stamp = {
            name: {m.header.stamp.nanosec + m.header.stamp.sec * 10**9: m for m in heard}
            for name, heard in everything.items()
        }
        stamp = color.header.stamp.nanosec + color.header.stamp.sec * 10**9
        depth = by_stamp[f'{vehicle}/camera/depth_registered/image_raw'][stamp]
        info = by_stamp[f'{vehicle}/camera/rgb/camera_info'][stamp]
        assert {m.header.frame_id for m in (color, depth, info)} == {
            f'{vehicle}/camera_optical_frame'
        }
        pairing = FramePairing()
        pairing.add_camera_info(info)
        pairing.add_color(color)
        frame = pairing.add_depth(depth)
        assert frame.rgb.shape == (120, 160, 3)
        assert frame.rgb.std() > 5.0
        assert frame.depth.dtype == np.uint16
        assert (frame.depth > 0).any()
    start_pose = messages.planar_pose(everything['robot1/ground_truth'][0].pose.pose)
    assert start_pose == pytest.approx((0.8, 2.0, 0.0))


def test_a_vehicle_takes_stamped_commands(start, listener):
    start('simulated_camera_rate:=0.0', 'real_time_factor:=2.0')
    stamped = listener.node.create_publisher(TwistStamped, 'robot2/cmd_vel', 1)
    truths = listener.heard['robot2/ground_truth']
    assert listener.spin(20.0, lambda: truths)
    begin = messages.planar_pose(truths[0].pose.pose).theta

    def turned():
        message = messages.stamped_twist_message(MESSAGES, listener.time, 'base_link', 0.0, 0.5)
        stamped.publish(message)
        return messages.planar_pose(truths[-1].pose.pose).theta > begin + 0.4

    assert listener.spin(10.0, turned)


def test_a_vehicle_drives_as_commanded_and_stops_when_commands_end(start, listener):
    start('simulated_camera_rate:=0.0', 'real_time_factor:=2.0')
    truths = listener.heard['robot1/ground_truth']
    assert listener.spin(20.0, lambda: len(truths) > 2)

    def place():
        return messages.planar_pose(truths[-1].pose.pose).x

    def driven():
        listener.drive(0.3)
        return place() > 1.1

    assert listener.spin(10.0, driven)
    assert listener.heard['robot1/odom'][-1].twist.twist.linear.x == pytest.approx(0.3)
    end = listener.time
    assert listener.spin(10.0, lambda: listener.time > end + 1.5)
    stood = place()
    assert listener.spin(10.0, lambda: listener.time > end + 2.5)
    assert place() == stood
    listener.drive(float('nan'))
    end = listener.time
    assert listener.spin(10.0, lambda: listener.time > end + 0.5)
    assert place() == stood


def test_time_runs_ahead_of_poses_only_so_far_and_not_for_ever_still(start, listener):
    start('simulated_camera_rate:=0.0', 'pose_lead:=1.0', 'pose_wait_timeout:=3.0')
    assert listener.spin(20.0, lambda: listener.time > 0.2)
    for name in ('robot1', 'robot2'):
        listener.say_pose(name, listener.time)
    said = listener.time

    def is_held():
        clock = listener.parts.get('simulator: time', {})
        held = clock.get('held_by') in ('robot1/pose', 'robot2/pose')
        return held and float(clock['time_s']) > said + 0.9

    assert listener.spin(10.0, is_held)
    assert said + 0.9 < listener.time < said + 1.4
    begun, wall = listener.time, time.monotonic()

    def keep_up():
        for name in ('robot1', 'robot2'):
            listener.say_pose(name, listener.time)
        return listener.time > begun + 8.0

    assert listener.spin(6.0, keep_up)  # more than real time
    assert time.monotonic() - wall < 8.0
    stopped = listener.time
    assert listener.spin(10.0, lambda: listener.time > stopped + 1.5)  # agent gone: goes on


def test_collisions_and_rates_are_reported(start, listener):
    start('simulated_camera_rate:=0.0', 'real_time_factor:=5.0')

    def collided():
        listener.drive(-0.7)
        return listener.parts.get('simulator: robot1', {}).get('collisions') == '1'

    assert listener.spin(20.0, collided), listener.parts
    assert listener.parts['simulator: robot2']['collisions'] == '0'
    assert 'real_time_factor' in listener.parts['simulator: time']


def test_the_pace_changes_under_way_and_the_world_does_not(start, listener):
    start('simulated_camera_rate:=0.0', 'real_time_factor:=0.1')
    client = listener.node.create_client(SetParameters, '/simulator/set_parameters')
    assert client.wait_for_service(20.0)
    # the service is there before the world is loaded, and answers after it
    assert listener.spin(20.0, lambda: listener.time > 0.0)

    def answer(name, value):
        parameter = Parameter(name, value=value).to_parameter_msg()
        future = client.call_async(SetParameters.Request(parameters=[parameter]))
        listener.executor.spin_until_future_complete(future, 10.0)
        return future.result().results[0]

    assert answer('real_time_factor', 8.0).successful
    begun, wall = listener.time, time.monotonic()
    assert listener.spin(60.0, lambda: listener.time > begun + 6.0)
    assert time.monotonic() - wall < 50.0  # 60 s at the first pace
    refused = answer('world', 'office')
    assert not refused.successful
    assert 'world: set at start only' in refused.reason
    refused = answer('real_time_factor', -1.0)
    assert not refused.successful


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM], ids=['SIGINT', 'SIGTERM'])
def test_a_signal_ends_the_node_cleanly(start, listener, number):
    process = start(*SMALL)
    assert listener.spin(20.0, lambda: listener.time > 0.5)
    process.send_signal(number)
    process.send_signal(number)
    assert process.wait(timeout=10) == 0
    assert 'Traceback' not in process.stdout.read()


MISTAKES = {
    "there is no world 'castle'": ('castle', ()),
    '/nowhere/world.yaml: no such file': ('/nowhere/world.yaml', ()),
    "not for ['x']: set spawn_poses": ('small', ("vehicles:=['x']",)),
    'spawn_poses has 2 numbers, expected 6': ('small', ('spawn_poses:=[1.0, 2.0]',)),
    'spawn_poses has nan': ('small', ("vehicles:=['a']", 'spawn_poses:=[.nan, .nan, .nan]')),
    'inside a wall': ('small', ("vehicles:=['a']", 'spawn_poses:=[3.2, 0.5, 0.0]')),
    'pose_lead': ('small', ('pose_lead:=-1.0',)),
}


def test_a_mistake_ends_the_node_with_one_message(start):
    processes = {
        words: start('simulated_camera_rate:=0.0', *parameters, world=world)
        for words, (world, parameters) in MISTAKES.items()
    }
    for words, process in processes.items():
        said, _ = process.communicate(timeout=90)
        assert process.returncode == 1, (words, said)
        assert words in said


def test_the_optical_frame_of_tf_looks_ahead():
    message = transform_message(
        MESSAGES, 1.5, 'robot1/base_link', 'robot1/camera', (0.1, 0, 0.4), OPTICAL
    )
    assert (message.header.frame_id, message.child_frame_id) == (
        'robot1/base_link', 'robot1/camera',
    )  # fmt: skip
    assert (message.transform.translation.x, message.transform.translation.z) == (0.1, 0.4)
    turn = message.transform.rotation
    x, y, z, w = turn.x, turn.y, turn.z, turn.w
    ahead = (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))  # optical z
    right = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))  # optical x
    assert ahead == (1.0, 0.0, 0.0)
    assert right == (0.0, -1.0, 0.0)
