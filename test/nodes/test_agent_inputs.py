"""What the agent's subscriptions make of messages and clocks, by real nodes and messages."""

import numpy as np
import pytest
import rclpy
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from ros_domain import own_domain

from explore_slam.data import LaserScan
from explore_slam.messages.scans import scan_message
from explore_slam.messages.sensor_mounts import SensorMounts
from explore_slam.messages.topics import SensorTopic, TopicKind
from explore_slam.messages.transforms import TransformTree
from explore_slam.messages.vehicle_settings import VehicleConfig
from explore_slam.nodes import agent_inputs
from explore_slam.nodes.agent_inputs import LIMITS, VehicleInputs
from explore_slam.nodes.inbox import Inbox
from explore_slam.nodes.ros_types import MESSAGES
from explore_slam.nodes.transform_listener import TransformListener

ODOM = SensorTopic(TopicKind.ODOMETRY, 'odom')


class Sink:
    """Collects records, as the agent takes them."""

    def __init__(self):
        self.records = []

    def add(self, _vehicle, record):
        self.records.append(record)


@pytest.fixture
def make_inputs():
    """Make the inputs of robot1 in a node with real or simulated time."""
    context = rclpy.Context()
    context.init(domain_id=own_domain(79))
    nodes = []

    def make(simulated, config=None):
        node = Node(
            'agent',
            context=context,
            parameter_overrides=[Parameter('use_sim_time', value=simulated)],
        )
        nodes.append(node)
        return VehicleInputs(
            node,
            SensorMounts('robot1', TransformTree(), config),
            ['robot1'],
            Inbox(LIMITS),
            sink=Sink(),
            planner=None,
            transforms=TransformListener(node, ['robot1']),
            map_frame='map',
        )

    yield make
    for node in nodes:
        node.destroy_node()
    context.try_shutdown()


def odometry(stamp):
    message = Odometry()
    message.header.stamp.sec = int(stamp)
    message.pose.pose.orientation.w = 1.0
    return message


def test_a_simulated_clock_that_does_not_run_is_the_problem_not_the_stamps(
    make_inputs, monkeypatch
):
    inputs = make_inputs(simulated=True)
    for k in range(10):
        inputs.take_measurement(ODOM, odometry(1_700_000_000 + k))
    assert inputs.clock_problems() == {}  # it may begin in a moment
    monkeypatch.setattr(agent_inputs, 'SILENCE', 0.0)
    (topic, (text, *_)), *others = inputs.clock_problems().items()
    assert (topic, others) == ('/clock', [])
    assert text.startswith('use_sim_time is true, but no time has come')
    assert 'offset' not in text


def test_stamps_are_compared_with_a_clock_that_runs(make_inputs):
    inputs = make_inputs(simulated=False)
    for k in range(10):
        inputs.take_measurement(ODOM, odometry(1_000 + k))
    problems = {topic: one.text for topic, one in inputs.clock_problems().items()}
    assert problems.keys() == {'robot1/odom'}
    assert 'behind the clock of this node' in problems['robot1/odom']
    assert problems['robot1/odom'].endswith('set robot1.odom_time_offset')
    inputs.take_measurement(ODOM, odometry(0))
    assert {topic: one.text for topic, one in inputs.clock_problems().items()} == {
        'robot1/odom': '1 messages have the stamp zero; the time of receipt is used'
    }


def test_odometry_has_the_number_that_its_publisher_has_given_it(make_inputs):
    inputs = make_inputs(simulated=False)
    node = inputs._node
    driver = Node('driver', context=node.context)
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    records = []
    for start in (1_000, 2_000):  # the driver and its successor
        publisher = driver.create_publisher(Odometry, 'robot1/odom', QoSProfile(depth=10))
        while not publisher.get_subscription_count():
            executor.spin_once(timeout_sec=0.02)
        for k in range(5):
            publisher.publish(odometry(start + k))
            count = len(records) + 1
            while len(records) < count:
                executor.spin_once(timeout_sec=0.02)
                while (item := inputs._inbox.get(timeout=0.0)) is not None:
                    item.take(item.payload)
                records = list(inputs._sink.records)
        driver.destroy_publisher(publisher)
    driver.destroy_node()
    assert [record.number for record in records] == [1, 2, 3, 4, 5] * 2


def test_every_laser_and_camera_of_the_settings_is_subscribed_to(make_inputs):
    config = VehicleConfig(
        scans=('front/scan', 'rear/scan'), clouds=('points',), cameras=('left', 'right')
    )
    inputs = make_inputs(simulated=False, config=config)
    node = inputs._node
    types = {name: kinds for name, kinds in node.get_topic_names_and_types() if 'robot1' in name}
    for name in ('front/scan', 'rear/scan'):
        assert types[f'/robot1/{name}'] == ['sensor_msgs/msg/LaserScan']
    assert types['/robot1/points'] == ['sensor_msgs/msg/PointCloud2']
    assert types['/robot1/right/rgb/camera_info'] == ['sensor_msgs/msg/CameraInfo']
    assert '/robot1/scan' not in types
    assert '/robot1/camera/rgb/image_raw' not in types
    silent = [text.split(' after')[0] for text in inputs.silence()]
    assert 'nothing on /robot1/rear/scan' in silent
    record = LaserScan(1.0, -1.0, 0.5, np.ones(5, np.float32), 0.1, 8.0)
    for name in ('rear/scan', 'front/scan', 'rear/scan'):
        topic = SensorTopic(TopicKind.SCAN, name, name)
        inputs.take_measurement(topic, scan_message(MESSAGES, record, name.split('/')[0]))
    while (item := inputs._inbox.get(timeout=0.0)) is not None:
        item.take(item.payload)
    sensors = [scan.sensor for scan in inputs._sink.records]
    if node.count_subscribers('/tf_static'):  # they wait for their mounts
        assert sensors == []
    else:
        assert sensors == ['rear/scan', 'front/scan', 'rear/scan']
    assert inputs.received['rear/scan'] == 2
    silent = [text.split(' after')[0] for text in inputs.silence()]
    assert 'nothing on /robot1/rear/scan' not in silent
    assert 'nothing on /robot1/left/rgb/image_raw' in silent
