"""The topic tables: names that vehicles' topics are recognized by, types and QoS."""

import pytest

from explore_slam.messages.topics import (
    GlobalTopic,
    TeamTopic,
    TopicKind,
    VehicleTopic,
    topic_name,
    vehicle_topic,
)
from explore_slam.nodes.ros_types import message_class

ALL = [topic for table in (TopicKind, VehicleTopic, TeamTopic, GlobalTopic) for topic in table]


@pytest.mark.parametrize('kind', [kind for kind in TopicKind if kind is not TopicKind.CLOUD])
@pytest.mark.parametrize('vehicle', ['robot1', 'fleet/robot1'])
def test_names_and_kinds_are_found_again(kind, vehicle):
    found = vehicle_topic(topic_name(vehicle, kind))
    assert (found.vehicle, found.kind) == (vehicle, kind)


@pytest.mark.parametrize('name', ['/scan', '/map', '/tf', '/robot1/plan', '/robot1/scan/extra'])
def test_other_topics_belong_to_no_vehicle(name):
    assert vehicle_topic(name) is None


def test_no_two_topics_have_the_same_name():
    names = [topic.value for topic in ALL]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize('topic', [t for t in ALL if not t.message_type.startswith('tf2_msgs/')])
def test_message_types_exist(topic):
    package, name = topic.message_type.split('/msg/')
    made = message_class(topic.message_type)()
    assert (type(made).__module__.split('.')[0], type(made).__name__) == (package, name)


def test_offered_quality_of_service_satisfies_the_requested_one():
    """A best-effort or volatile publisher would never match a stricter subscription (REP-2003)."""
    for topic in ALL:
        assert topic.offered.reliable >= topic.requested.reliable, topic
        assert topic.offered.latched >= topic.requested.latched, topic
