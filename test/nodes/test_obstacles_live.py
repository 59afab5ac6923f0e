"""Obstacles on the way from images to followers: by the feature extractor, and by the agent."""

import threading
import time

import pytest
import rclpy
from ros_domain import own_domain
from sensor_msgs.msg import PointCloud2
from vision.depth_scenes import TABLE, cast, frame

from explore_slam.data import HOLE_BIT, OdometryReading
from explore_slam.geometry import Pose2
from explore_slam.messages import obstacles_record
from explore_slam.messages.frame_pairing import FRAME
from explore_slam.messages.frames import FrameNames
from explore_slam.messages.odometry import ODOMETRY
from explore_slam.messages.topics import SENSOR_DATA, TopicKind, topic_name
from explore_slam.nodes.agent_node import AgentNode
from explore_slam.nodes.endpoints import qos_profile
from explore_slam.nodes.feature_extractor import FeatureExtractorNode
from explore_slam.nodes.ros_types import MESSAGES, message_class

DOMAIN = own_domain(81)


def extractor(context):
    return FeatureExtractorNode(namespace='/robot1', context=context)


def agent(context):
    arguments = ['--ros-args', '-p', "vehicles:=['robot1']", '-p', 'start_poses:=[0.0, 0.0, 0.0]']
    return AgentNode(context=context, cli_args=arguments)


@pytest.mark.parametrize('make', [extractor, agent])
def test_a_table_in_images_arrives_as_obstacles(make):
    context = rclpy.Context()
    context.init(domain_id=DOMAIN)
    node, other = make(context), rclpy.create_node('vehicle', context=context)
    executor = rclpy.executors.MultiThreadedExecutor(context=context)
    for one in (node, other):
        executor.add_node(one)
    spinner = threading.Thread(target=executor.spin, daemon=True)
    found = []
    other.create_subscription(
        PointCloud2,
        topic_name('robot1', TopicKind.OBSTACLES),
        found.append,
        qos_profile(SENSOR_DATA),
    )
    outputs = {}
    spinner.start()
    try:
        end = time.monotonic() + 60.0
        while not found and time.monotonic() < end:
            now = other.get_clock().now().nanoseconds * 1e-9
            reading = OdometryReading(now, Pose2(0.0, 0.0, 0.0))
            seen = frame(cast(tables=[TABLE], limit=3.5), now - 0.05)
            for kind, record in ((ODOMETRY, reading), (FRAME, seen)):
                for topic, message in kind.write(MESSAGES, FrameNames('robot1'), record):
                    if topic not in outputs:
                        outputs[topic] = other.create_publisher(
                            message_class(topic.message_type), topic_name('robot1', topic), 10
                        )
                    outputs[topic].publish(message)
            time.sleep(0.1)
    finally:
        executor.shutdown()
        spinner.join(timeout=5.0)
        if hasattr(node, 'stop'):
            node.stop()
        node.destroy_node()
        other.destroy_node()
        context.try_shutdown()
    assert found, 'no obstacles within 60 s'
    view = obstacles_record(found[0])
    assert found[0].header.frame_id == 'robot1/base_link'
    x, y = view.points[view.occupied >> 6 & 1 == 1].T
    assert x.min() == pytest.approx(TABLE[0], abs=0.1)
    assert x.max() == pytest.approx(TABLE[1], abs=0.1)
    assert y.max() == pytest.approx(TABLE[3], abs=0.1)
    assert not (view.occupied >> HOLE_BIT).any()
