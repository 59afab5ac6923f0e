"""Every subscription matches what ordinary tools and drivers offer."""

import time

import pytest
import rclpy
from geometry_msgs.msg import Point32, PolygonStamped
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import (
    QoSCompatibility,
    QoSDurabilityPolicy,
    QoSProfile,
    QoSReliabilityPolicy,
    qos_check_compatible,
    qos_profile_sensor_data,
)
from ros_domain import own_domain

from explore_slam.messages.measurement_kinds import MEASUREMENT_KINDS
from explore_slam.messages.topics import (
    RELIABLE,
    GlobalTopic,
    TeamTopic,
    TopicKind,
    VehicleTopic,
)
from explore_slam.nodes import endpoints
from explore_slam.nodes.endpoints import LatchedOrNotSubscription, qos_profile


# `ros2 topic pub`, RViz's tools and system defaults: reliable and volatile
def profile(depth=10, *, latched=False):
    durability = QoSDurabilityPolicy
    return QoSProfile(
        depth=depth,
        reliability=QoSReliabilityPolicy.RELIABLE,
        durability=durability.TRANSIENT_LOCAL if latched else durability.VOLATILE,
    )


TOOL, LATCHED = profile(), profile(1, latched=True)
COMMANDS = (
    TeamTopic.RESUME,
    TopicKind.INITIAL_POSE,
    GlobalTopic.SELECTED_INITIAL_POSE,
    VehicleTopic.VELOCITY_COMMAND,
    VehicleTopic.FOLLOWER_STATUS,
    VehicleTopic.POSE,
    TopicKind.GROUND_TRUTH,
)
SENSORS = tuple(
    topic
    for kind in MEASUREMENT_KINDS
    for topic in kind.topics
    if topic not in (TopicKind.LANDMARKS, TopicKind.INTER_ROBOT)  # large or rare: not to be lost
)


def matches(offered, requested):
    """Whether messages get through: a warning is about liveliness, which nobody has set."""
    return qos_check_compatible(offered, qos_profile(requested))[0] != QoSCompatibility.ERROR


@pytest.mark.parametrize('topic', [*COMMANDS, TopicKind.LANDMARKS, TopicKind.INTER_ROBOT])
def test_commands_match_what_tools_and_latched_publishers_offer(topic):
    assert matches(TOOL, topic.requested)
    assert matches(LATCHED, topic.requested)


@pytest.mark.parametrize('topic', SENSORS)
def test_sensors_match_best_effort_reliable_and_latched_drivers(topic):
    assert matches(qos_profile_sensor_data, topic.requested)
    assert matches(TOOL, topic.requested)
    assert matches(LATCHED, topic.requested)


def test_transforms_match_what_tf2_ros_publishes():
    assert matches(profile(100), GlobalTopic.TF.requested)
    assert matches(LATCHED, GlobalTopic.TF_STATIC.requested)


def test_plans_of_other_planners_reach_the_follower():
    assert matches(TOOL, RELIABLE)
    assert matches(LATCHED, VehicleTopic.PLAN.requested)


@pytest.mark.parametrize('topic', [TeamTopic.MAP, TeamTopic.MAP_PROBABILITY, VehicleTopic.PLAN])
def test_maps_match_latched_and_plain_subscribers(topic):
    for requested in (LATCHED, TOOL, qos_profile_sensor_data):
        compatible = qos_check_compatible(qos_profile(topic.offered), requested)
        assert compatible[0] != QoSCompatibility.ERROR


class Topics:
    """A node that subscribes to keep-out areas, and tools that publish them."""

    def __init__(self, context):
        self.listener = rclpy.create_node('listener', context=context)
        self.tools = rclpy.create_node('tools', context=context)
        self.executor = SingleThreadedExecutor(context=context)
        for node in (self.listener, self.tools):
            self.executor.add_node(node)
        self.heard, self.incompatible = [], []

    def subscribe(self):
        def hear(message):
            self.heard.append(message.polygon.points[0].x)

        LatchedOrNotSubscription(self.listener, TeamTopic.KEEP_OUT, hear)

    def publisher(self, qos):
        events = PublisherEventCallbacks(incompatible_qos=self.incompatible.append)
        return self.tools.create_publisher(
            PolygonStamped, TeamTopic.KEEP_OUT.value, qos, event_callbacks=events
        )

    def publish(self, publisher, number):
        message = PolygonStamped()
        message.polygon.points = [Point32(x=float(number))]
        publisher.publish(message)

    def wait_for(self, condition, timeout=20.0):
        end = time.monotonic() + timeout
        while not condition() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.02)
        assert condition()


@pytest.fixture
def topics():
    context = rclpy.Context()
    context.init(domain_id=own_domain(61))
    made = Topics(context)
    yield made
    made.listener.destroy_node()
    made.tools.destroy_node()
    context.try_shutdown()


def test_a_publisher_that_is_not_latched_is_heard_and_sees_no_incompatible_qos(topics):
    topics.subscribe()
    tool = topics.publisher(TOOL)  # as `ros2 topic pub --once` has it
    topics.wait_for(lambda: tool.get_subscription_count() == 1)
    topics.publish(tool, 1)
    topics.wait_for(lambda: topics.heard == [1.0])
    assert topics.incompatible == []


def test_what_a_latched_publisher_has_published_reaches_a_late_subscriber(topics, monkeypatch):
    monkeypatch.setattr(endpoints, '_FETCH_REST', 0.2)
    latched = topics.publisher(profile(10, latched=True))
    for number in (1, 2):
        topics.publish(latched, number)
    topics.subscribe()
    topics.wait_for(lambda: topics.heard == [1.0, 2.0])
    topics.wait_for(lambda: latched.get_subscription_count() == 1)  # it is fetched once
    topics.publish(latched, 3)
    topics.wait_for(lambda: 3.0 in topics.heard)
    another = topics.publisher(profile(10, latched=True))
    topics.publish(another, 4)
    topics.wait_for(lambda: 4.0 in topics.heard)
    topics.wait_for(lambda: latched.get_subscription_count() == 1)
    # from now on a tool that is not latched is no trouble either
    tool = topics.publisher(TOOL)
    topics.wait_for(lambda: tool.get_subscription_count() == 1)
    topics.publish(tool, 5)
    topics.wait_for(lambda: topics.heard[-1] == 5.0)
    assert topics.incompatible == []


def test_latched_messages_are_fetched_when_the_tools_are_gone_or_do_not_go(topics, monkeypatch):
    monkeypatch.setattr(endpoints, '_FETCH_PATIENCE', 1.0)
    tool, latched = topics.publisher(TOOL), topics.publisher(profile(10, latched=True))
    topics.publish(latched, 1)
    topics.subscribe()
    topics.wait_for(lambda: topics.heard == [1.0])
    assert topics.incompatible  # it stays: the message is worth a warning
    topics.tools.destroy_publisher(tool)
