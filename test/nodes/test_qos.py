"""Every subscription matches what ordinary tools and drivers offer."""

import pytest
from rclpy.qos import (
    QoSCompatibility,
    QoSDurabilityPolicy,
    QoSProfile,
    QoSReliabilityPolicy,
    qos_check_compatible,
    qos_profile_sensor_data,
)

from explore_slam.messages.measurement_kinds import MEASUREMENT_KINDS
from explore_slam.messages.topics import (
    RELIABLE,
    GlobalTopic,
    TeamTopic,
    TopicKind,
    VehicleTopic,
)
from explore_slam.nodes.endpoints import qos_profile


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
