"""What the agent's subscriptions make of messages and clocks, by real nodes and messages."""

import pytest
import rclpy
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from ros_domain import own_domain

from explore_slam.messages.sensor_mounts import SensorMounts
from explore_slam.messages.topics import TopicKind
from explore_slam.messages.transforms import TransformTree
from explore_slam.nodes import agent_inputs
from explore_slam.nodes.agent_inputs import LIMITS, VehicleInputs
from explore_slam.nodes.inbox import Inbox
from explore_slam.nodes.transform_listener import TransformListener


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

    def make(simulated):
        node = Node(
            'agent',
            context=context,
            parameter_overrides=[Parameter('use_sim_time', value=simulated)],
        )
        nodes.append(node)
        return VehicleInputs(
            node,
            SensorMounts('robot1', TransformTree()),
            ['robot1'],
            Inbox(LIMITS),
            sink=Sink(),
            operator=None,
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
        inputs.take(TopicKind.ODOMETRY, odometry(1_700_000_000 + k))
    assert inputs.clock_problems() == {}  # it may begin in a moment
    monkeypatch.setattr(agent_inputs, 'SILENCE', 0.0)
    (topic, (text, *_)), *others = inputs.clock_problems().items()
    assert (topic, others) == ('/clock', [])
    assert text.startswith('use_sim_time is true, but no time has come')
    assert 'offset' not in text


def test_stamps_are_compared_with_a_clock_that_runs(make_inputs):
    inputs = make_inputs(simulated=False)
    for k in range(10):
        inputs.take(TopicKind.ODOMETRY, odometry(1_000 + k))
    problems = {topic: one.text for topic, one in inputs.clock_problems().items()}
    assert problems.keys() == {'robot1/odom'}
    assert 'behind the clock of this node' in problems['robot1/odom']
    assert problems['robot1/odom'].endswith('set robot1.odom_time_offset')
    inputs.take(TopicKind.ODOMETRY, odometry(0))
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
