"""Tags over topics: found on the vehicle, they move the agent's map into the survey's frame."""

import math
import time

import numpy as np
import pytest
import rclpy
import yaml
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import qos_profile_sensor_data
from ros_domain import own_domain
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

from explore_slam import messages
from explore_slam.data import Intrinsics, OdometryReading
from explore_slam.geometry import Pose2
from explore_slam.live.processes import NodeProcess, NodeProcesses, one_machine_environment
from explore_slam.nodes.ros_types import MESSAGES
from explore_slam.vision import CameraMount, tags_available
from explore_slam.vision.tag_images import TagInView, draw_view

pytestmark = pytest.mark.skipif(not tags_available(), reason='this OpenCV finds no tags')

DOMAIN = own_domain(59)
CAMERA = Intrinsics(320, 240, 260.0, 260.0, 159.5, 119.5)
MOUNT = CameraMount(0.1, 0.0, 0.4)
START = Pose2(10.0, 5.0, 1.0)  # in the frame of the survey
TAG, SIZE = 3, 0.3
TAG_POSE = START.compose(Pose2(3.0, 0.4, math.pi + 0.6))
STEPS, STEP_TIME = 11, 0.4  # s; each is 0.22 m, which in a moment would be a jump of odometry
COLOR, DEPTH = 'camera/rgb/image_raw', 'camera/depth_registered/image_raw'


def image_at(pose, random):
    at = pose.between(TAG_POSE)
    normal, up = np.array([math.cos(at.theta), math.sin(at.theta), 0.0]), np.array([0.0, 0.0, 1.0])
    turn = MOUNT.rotation.T
    rotation = turn @ np.stack([np.cross(up, normal), up, normal], axis=1)
    place = turn @ (np.array([at.x, at.y, 0.5]) - MOUNT.translation)
    return draw_view('tag36h11', [TagInView(TAG, SIZE, rotation, place)], CAMERA, random)


class Vehicle:
    """Publishes odometry and images on its way to a tag, and hears what becomes of them."""

    def __init__(self, context):
        self.node = rclpy.create_node('vehicle', context=context)
        self.executor = SingleThreadedExecutor(context=context)
        self.executor.add_node(self.node)
        self.random, self.tags, self.poses = np.random.default_rng(0), [], []
        kinds = {
            'odom': Odometry,
            COLOR: Image,
            DEPTH: Image,
            'camera/rgb/camera_info': CameraInfo,
        }
        self.out = {
            topic: self.node.create_publisher(kind, f'robot1/{topic}', qos_profile_sensor_data)
            for topic, kind in kinds.items()
        }
        self.node.create_subscription(PointCloud2, 'robot1/tags', self.tags.append, 10)
        self.node.create_subscription(
            PoseWithCovarianceStamped, 'robot1/pose', self.poses.append, 10
        )

    def wait_for(self, condition, seconds=90.0):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if condition():
                return True
            self.executor.spin_once(timeout_sec=0.02)
        return False

    def spin(self, seconds):
        self.wait_for(lambda: False, seconds)

    def step(self, tick):
        """Publish what is measured at a tick; the image again until its tag comes back."""
        odometry = Pose2(0.22 * tick, 0.0, 0.0)
        self.spin(STEP_TIME)
        image, before = image_at(START.compose(odometry), self.random), len(self.tags)
        grey = np.dstack([image] * 3)
        for _ in range(20):
            stamp = self.publish_odometry(odometry)
            frame = 'robot1/camera_rgb_optical_frame'
            depth = np.zeros(image.shape, np.uint16)
            info = messages.camera_info_message(MESSAGES, stamp, frame, CAMERA)
            self.publish('camera/rgb/camera_info', info)
            self.publish(COLOR, messages.image_message(MESSAGES, stamp, frame, 'rgb8', grey))
            self.publish(DEPTH, messages.image_message(MESSAGES, stamp, frame, '16UC1', depth))
            if self.wait_for(lambda: len(self.tags) > before, 1.0):
                return

    def publish_odometry(self, odometry):
        """Publish odometry with the time of now (s), which is returned."""
        stamp = self.node.get_clock().now().nanoseconds * 1e-9
        reading = OdometryReading(stamp, odometry)
        names = 'robot1/odom', 'robot1/base_link'
        self.publish('odom', messages.odometry_message(MESSAGES, reading, *names))
        return stamp

    def publish(self, topic, message):
        self.out[topic].publish(message)


def test_a_tag_found_on_the_vehicle_moves_the_map_of_the_agent(tmp_path):
    file = tmp_path / 'tags.yaml'
    x, y, yaw = TAG_POSE
    file.write_text(f'size: {SIZE}\ntags:\n  - {{id: {TAG}, pose: [{x}, {y}, {yaw}]}}\n')
    values = {
        'vehicles': ['robot1'],
        'start_poses': [math.nan] * 3,
        'vision': 'vehicle',
        'use_laser': False,
        'particles': 50,
        'run_directory': str(tmp_path),
        'tags_file': str(file),
    }
    parameters = tmp_path / 'agent.yaml'
    parameters.write_text(yaml.safe_dump({'/**': {'ros__parameters': values}}))
    extractor = ['--ros-args', '-r', '__ns:=/robot1', '-p', f'tags_file:={file}']
    nodes = [
        NodeProcess('agent', 'agent_node', ['--ros-args', '--params-file', str(parameters)]),
        NodeProcess('features', 'feature_extractor', extractor),
    ]
    environment = {**one_machine_environment(), 'ROS_DOMAIN_ID': str(DOMAIN)}
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    vehicle = Vehicle(context)
    log = tmp_path / 'logs' / 'agent.log'
    with NodeProcesses(nodes, tmp_path / 'logs', environment):
        assert vehicle.wait_for(
            lambda: all(p.get_subscription_count() for p in vehicle.out.values())
        )
        assert vehicle.wait_for(lambda: vehicle.out['odom'].get_subscription_count() > 1)
        for tick in range(STEPS):
            vehicle.step(tick)
        found = [messages.tags_record(message) for message in vehicle.tags]
        assert len(found) >= 8
        assert {tuple(item.ids.tolist()) for item in found} == {(TAG,)}
        told = 'the map is in the frame of the surveyed tags 3'
        assert vehicle.wait_for(lambda: told in log.read_text(), 30.0), log.read_text()
        driven = Pose2(0.22 * (STEPS - 1), 0.0, 0.0)
        end = START.compose(driven)

        def arrived():
            vehicle.publish_odometry(driven)  # best effort: what was sent before may be lost
            if not vehicle.poses:
                return False
            pose = messages.planar_pose(vehicle.poses[-1].pose.pose)
            return math.dist(pose[:2], end[:2]) < 0.15

        assert vehicle.wait_for(arrived, 20.0), [vehicle.poses[-1:], end]
    vehicle.node.destroy_node()
    rclpy.shutdown(context=context)
