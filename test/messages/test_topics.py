"""Which topics belong to whom, and what is said about those that do not."""

import pytest

from explore_slam.errors import RecordingError
from explore_slam.messages.topics import (
    MESSAGE_TYPES,
    TopicKind,
    topic_name,
    vehicle_topic,
    vehicle_topics,
)


@pytest.mark.parametrize('kind', list(TopicKind))
@pytest.mark.parametrize('vehicle', ['robot1', 'fleet/robot1'])
def test_names_and_kinds_are_found_again(kind, vehicle):
    found = vehicle_topic(topic_name(vehicle, kind))
    assert (found.vehicle, found.kind) == (vehicle, kind)


@pytest.mark.parametrize('name', ['/scan', '/map', '/tf', '/robot1/plan', '/robot1/scan/extra'])
def test_other_topics_belong_to_no_vehicle(name):
    assert vehicle_topic(name) is None


def topics(*names: str) -> dict[str, str]:
    return {name: MESSAGE_TYPES[vehicle_topic(name).kind] for name in names}


def test_vehicles_that_were_not_asked_for_are_named_and_left_out():
    found, warnings = vehicle_topics(topics('/a/odom', '/a/scan', '/b/odom'), ['a'])
    assert {topic.vehicle for topic in found} == {'a'}
    assert warnings == ["unknown vehicles ['b'] in the recording: unused"]


def test_a_wrong_type_is_named_and_left_out():
    found, warnings = vehicle_topics({**topics('/a/odom'), '/a/scan': 'std_msgs/msg/String'})
    assert [topic.name for topic in found] == ['/a/odom']
    assert '/a/scan' in warnings[0]
    assert 'std_msgs/msg/String' in warnings[0]


def test_an_absent_vehicle_and_a_bag_without_any_are_refused():
    with pytest.raises(RecordingError, match=r"no topics of \['c'\]; the recording holds .*'a'"):
        vehicle_topics(topics('/a/odom'), ['c'])
    with pytest.raises(RecordingError, match=r"<vehicle>/odom .* holds \['/map'\]"):
        vehicle_topics({'/map': 'nav_msgs/msg/OccupancyGrid'})
    with pytest.raises(RecordingError, match='no topics'):
        vehicle_topics({})
    with pytest.raises(RecordingError, match='no topic of a vehicle'):
        vehicle_topics(topics('/a/ground_truth'))
