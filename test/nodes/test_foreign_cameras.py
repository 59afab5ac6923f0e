"""Robots of other people with RGB-D cameras and no laser: encodings, topics, frames and mounts.

Two 1280 x 720 cameras: one turned to the left, with depth in 16UC1, the other with compressed
colour and depth in 32FC1. Odometry has no covariance, measures distances too long, and knows
neither `odom` nor `base_link`. The images are rendered.
"""

import math
from contextlib import closing

import numpy as np
import pytest
import rclpy
import yaml
from compressed_images import jpeg
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from ros_domain import own_domain
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from explore_slam import messages
from explore_slam.data import OdometryReading, RgbdFrame
from explore_slam.geometry import Pose2
from explore_slam.live.processes import NodeProcess, NodeProcesses, one_machine_environment
from explore_slam.messages.base import camera_transform_message, header, time_message
from explore_slam.messages.images import camera_info_message, image_message
from explore_slam.nodes.ros_types import MESSAGES, message_class
from explore_slam.settings import with_values
from explore_slam.simulation import SimulationConfig, Simulator, load_world, world_path

DOMAIN = own_domain(62)
try:
    TF_MESSAGE = message_class('tf2_msgs/msg/TFMessage')
except ImportError:
    TF_MESSAGE = None
WIDTH, HEIGHT = 1280, 720
YAW = 0.6  # rad; of both cameras in the base frame, 34 degrees to the left
TOO_LONG = 1.04  # distances that odometry measures
DURATION = 9.0  # s of simulated time
SETTINGS = {
    'simulated_image_width': WIDTH,
    'simulated_image_height': HEIGHT,
    'simulated_camera_rate': 2.0,
    'camera_x': 0.2,
    'camera_z': 0.35,
    'camera_yaw': YAW,
}
COLOR, DEPTH, INFO = 'color/image_raw', 'aligned_depth_to_color/image_raw', 'color/camera_info'
# the topics of the agent, and those of realsense2_camera
REMAPPED = {
    'camera/rgb/image_raw': COLOR,
    'camera/rgb/image_raw/compressed': f'{COLOR}/compressed',
    'camera/depth_registered/image_raw': DEPTH,
    'camera/rgb/camera_info': INFO,
}
FRAMES = {
    'robot1': ('robot1/odometry', 'robot1/base_footprint', 'robot1/camera_color_optical_frame'),
    'robot2': ('tb2/odom', 'tb2/base_footprint', 'tb2/camera_color_optical_frame'),
}


class Team:
    """Publishes what the simulated robots measure as the drivers of others do."""

    def __init__(self, simulator):
        self.simulator = simulator
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.node = rclpy.create_node('foreign_cameras', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.out, self.poses, self.odometry = {}, {}, {}
        self.clock = self.node.create_publisher(Clock, '/clock', 10)
        latched = QoSProfile(depth=1, durability=rclpy.qos.QoSDurabilityPolicy.TRANSIENT_LOCAL)
        static = self.node.create_publisher(TF_MESSAGE, '/tf_static', latched)
        for name in simulator.vehicles:
            for topic, kind in (
                ('odom', Odometry), (COLOR, Image), (f'{COLOR}/compressed', CompressedImage),
                (DEPTH, Image), (INFO, CameraInfo),
            ):  # fmt: skip
                if topic == f'{COLOR}/compressed' and name == 'robot1':
                    continue
                if topic == COLOR and name == 'robot2':
                    continue
                self.out[name, topic] = self.node.create_publisher(
                    kind, f'{name}/{topic}', qos_profile_sensor_data
                )
            self.node.create_subscription(
                PoseWithCovarianceStamped,
                f'{name}/pose',
                lambda message, name=name: self.poses.update({name: message}),
                10,
            )
        mount = simulator.config.camera_mount
        static.publish(
            TF_MESSAGE(
                transforms=[
                    camera_transform_message(MESSAGES, 0.0, base, optical, mount)
                    for _, base, optical in FRAMES.values()
                ]
            )
        )
        self._static = static

    def wait_for(self, condition, seconds=60.0):
        for _ in range(int(seconds / 0.02)):
            if condition():
                return
            self.executor.spin_once(timeout_sec=0.02)
        raise AssertionError(f'nothing after {seconds} s')

    def settle(self):
        """Wait until the agent has poses of all vehicles up to their last odometry."""
        for _ in range(300):
            missing = [
                name
                for name, message in self.odometry.items()
                if name not in self.poses or self.poses[name].header.stamp != message.header.stamp
            ]
            if not missing:
                return
            for name in missing:  # best effort: it may have been lost
                self.out[name, 'odom'].publish(self.odometry[name])
            for _ in range(10):
                self.executor.spin_once(timeout_sec=0.02)
        raise AssertionError('the agent has not caught up')

    def step(self):
        for event in self.simulator.step():
            if isinstance(event.record, OdometryReading):
                self.publish_odometry(event.vehicle, event.record)
            elif isinstance(event.record, RgbdFrame):
                self.publish_frame(event.vehicle, event.record)
        self.clock.publish(Clock(clock=time_message(MESSAGES, self.simulator.time)))

    def publish_odometry(self, name, reading):
        odom, base, _ = FRAMES[name]
        x, y, theta = reading.pose
        measured = OdometryReading(reading.stamp, Pose2(TOO_LONG * x, TOO_LONG * y, theta))
        self.odometry[name] = messages.odometry_message(MESSAGES, measured, odom, base)
        self.out[name, 'odom'].publish(self.odometry[name])

    def publish_frame(self, name, frame):
        optical = FRAMES[name][2]
        depth = np.asarray(frame.depth)
        metres = depth * np.float32(0.001) if depth.dtype == np.uint16 else depth
        if name == 'robot1':
            color = image_message(MESSAGES, frame.stamp, optical, 'bgr8', frame.rgb[:, :, ::-1])
            self.out[name, COLOR].publish(color)
            millimetres = np.nan_to_num(1000.0 * metres).round().astype(np.uint16)
            found = image_message(MESSAGES, frame.stamp, optical, '16UC1', millimetres)
        else:
            color = CompressedImage(format='rgb8; jpeg compressed bgr8')
            color.header = header(MESSAGES, frame.stamp, optical)
            color.data = MESSAGES.sequence(np.frombuffer(jpeg(frame.rgb), np.uint8))
            self.out[name, f'{COLOR}/compressed'].publish(color)
            metres = np.where(metres > 0.0, metres, np.nan).astype(np.float32)
            found = image_message(MESSAGES, frame.stamp, optical, '32FC1', metres)
        self.out[name, DEPTH].publish(found)
        self.out[name, INFO].publish(
            camera_info_message(MESSAGES, frame.stamp, optical, frame.intrinsics)
        )

    def close(self):
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.mark.skipif(
    TF_MESSAGE is None, reason='tf2_msgs is not installed: python tools/build_messages.py tf2_msgs'
)
def test_cameras_of_other_people_keep_the_poses_right_to_5_cm(tmp_path):
    world = load_world(world_path('office'))
    names = ['robot1', 'robot2']
    starts = {name: world.starts[name] for name in names}
    file = tmp_path / 'agent.yaml'
    values = {
        'vehicles': names,
        'start_poses': [float(v) for pose in starts.values() for v in pose],
        'use_laser': False,
        'use_sim_time': True,
        'explore': False,
        'particles': 50,
        'pose_period': 0.05,
    }
    file.write_text(yaml.safe_dump({'/**': {'ros__parameters': values}}))
    arguments = ['--ros-args', '--params-file', str(file)]
    for name in names:
        for own, theirs in REMAPPED.items():
            arguments += ['-r', f'/{name}/{own}:=/{name}/{theirs}']
    environment = {**one_machine_environment(), 'ROS_DOMAIN_ID': str(DOMAIN)}
    node = NodeProcess('agent', 'agent_node', arguments)
    config = with_values(SimulationConfig(), SETTINGS)
    with (
        Simulator(world, starts, config, seed=4) as simulator,
        NodeProcesses([node], tmp_path / 'logs', environment) as processes,
        closing(Team(simulator)) as team,
    ):
        team.wait_for(lambda: all(out.get_subscription_count() for out in team.out.values()), 90.0)
        team.step()
        while simulator.time < DURATION:
            turning = -0.3 * math.sin(1.5 * simulator.time)
            for name in names:
                simulator.set_velocity(name, 0.3, turning)
            for _ in range(25):  # half a second, with one frame of each vehicle
                team.step()
            team.settle()  # the agent takes its time for a frame
        processes.check()
        log = (tmp_path / 'logs' / 'agent.log').read_text()
        for name in names:
            pose = messages.planar_pose(team.poses[name].pose.pose)
            truth = simulator.true_pose(name)
            believed = starts[name].compose(messages.planar_pose(team.odometry[name].pose.pose))
            assert math.dist(believed[:2], truth[:2]) > 0.06
            assert math.dist(pose[:2], truth[:2]) < 0.05, (name, pose, truth, log)
    assert 'x 0.200 m, y 0.000 m, z 0.350 m, from /tf_static' in log
    for words in ('nothing on', 'default mount', 'ahead of', 'behind the clock'):
        assert words not in log, log
