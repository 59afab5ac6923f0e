"""Which topics of a recording are used, and the warnings about the others."""

import pytest

from explore_slam.errors import RecordingError
from explore_slam.messages.topics import vehicle_topic
from explore_slam.recording.topic_selection import frames_or_landmarks, vehicle_topics


def topics(*names: str) -> dict[str, str]:
    return {name: vehicle_topic(name).kind.message_type for name in names}


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


@pytest.mark.parametrize(
    ('vision', 'kept', 'warned'),
    [
        ('agent', '/a/camera/rgb/image_raw/compressed', False),
        ('vehicle', '/a/landmarks', False),
        (None, '/a/landmarks', True),
    ],
)
def test_frames_or_landmarks_of_a_vehicle_that_has_both(vision, kept, warned):
    names = ('/a/odom', '/a/landmarks', '/a/camera/rgb/image_raw/compressed')
    alone = ('/b/odom', '/b/landmarks')
    found, warnings = vehicle_topics(topics(*names, *alone))
    used = {topic.name for topic in frames_or_landmarks(found, vision, warnings)}
    assert used == {'/a/odom', kept, *alone}
    assert bool(warnings) == warned
