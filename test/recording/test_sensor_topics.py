"""Recordings of vehicles with several lasers and cameras: which topics are theirs."""

import pytest

from explore_slam.messages.topics import RecordedTopic, TopicKind
from explore_slam.recording.sensor_topics import choices_of_settings, with_sensors

SCAN, CLOUD = TopicKind.SCAN.message_type, TopicKind.CLOUD.message_type
IMAGE, INFO = TopicKind.COLOR.message_type, TopicKind.CAMERA_INFO.message_type
TOPICS = {
    '/robot1/odom': TopicKind.ODOMETRY.message_type,
    '/robot1/front/scan': SCAN,
    '/robot1/rear/scan': SCAN,
    '/robot1/velodyne_points': CLOUD,
    '/robot1/left/rgb/image_raw': IMAGE,
    '/robot1/left/depth_registered/image_raw': IMAGE,
    '/robot1/left/rgb/camera_info': INFO,
    '/robot1/right/rgb/image_raw': IMAGE,
    '/robot1/right/depth_registered/image_raw': IMAGE,
    '/robot1/right/rgb/camera_info': INFO,
}


def names(choices):
    return {(choice.vehicle, choice.kind.name, choice.name) for choice in choices}


def test_settings_choose_the_topics_of_several_sensors():
    settings = {'robot1.scans': ['front/scan', 'rear/scan'], 'robot1.clouds': ['velodyne_points']}
    choices, notes = choices_of_settings(TOPICS, (), settings)
    assert notes == []
    assert names(choices) == {
        ('robot1', 'SCAN', '/robot1/front/scan'),
        ('robot1', 'SCAN', '/robot1/rear/scan'),
        ('robot1', 'CLOUD', '/robot1/velodyne_points'),
    }
    choices, _ = choices_of_settings(TOPICS, ['robot1'], {'cameras': ['left', 'right']})
    assert len(choices) == 6
    assert choices_of_settings(TOPICS, (), {'vision': 'none'}) == ([], [])


def test_topics_of_a_recording_without_namespaces_are_found_and_missing_ones_named():
    bare = {name.removeprefix('/robot1'): kind for name, kind in TOPICS.items()}
    settings = {'scans': ['front/scan', 'side/scan']}
    choices, notes = choices_of_settings(bare, (), settings)
    assert names(choices) == {('robot1', 'SCAN', '/front/scan')}
    assert notes == [f'robot1: the recording does not hold side/scan ({SCAN})']


@pytest.mark.parametrize('space', ['/robot1', ''])
def test_sensors_are_named_where_there_are_several(space):
    kinds = {
        'odom': 'ODOMETRY',
        'scan': 'SCAN',
        'velodyne_points': 'CLOUD',
        'camera_info': 'CAMERA_INFO',
    }
    found = []
    for name in TOPICS:
        last = name.rsplit('/', 1)[1]
        kind = kinds.get(last, 'DEPTH' if 'depth' in name else 'COLOR')
        found.append(
            RecordedTopic(space + name.removeprefix('/robot1'), 'robot1', TopicKind[kind])
        )
    sensors = {topic.name.removeprefix(space): topic.sensor for topic in with_sensors(found)}
    assert sensors['/odom'] == ''
    assert sensors['/front/scan'] == 'front/scan'
    assert sensors['/velodyne_points'] == 'velodyne_points'
    assert sensors['/left/depth_registered/image_raw'] == 'left'
    assert sensors['/right/rgb/camera_info'] == 'right'
    single = [topic for topic in found if 'left' not in topic.name and 'front' not in topic.name]
    alone = [topic for topic in single if topic.kind is not TopicKind.CLOUD]
    assert {topic.sensor for topic in with_sensors(alone)} == {''}


def test_one_camera_that_is_recorded_raw_and_compressed_is_one():
    name = '/robot1/camera/rgb/image_raw'
    found = [
        RecordedTopic(name, 'robot1', TopicKind.COLOR),
        RecordedTopic(f'{name}/compressed', 'robot1', TopicKind.COLOR_COMPRESSED),
    ]
    assert with_sensors(found) == found
