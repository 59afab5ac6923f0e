"""Which topics of a recording are used, and the warnings about the others."""

import pytest

from explore_slam.errors import RecordingError
from explore_slam.messages.topics import TopicKind, vehicle_topic
from explore_slam.recording.topic_selection import (
    frames_or_landmarks,
    topic_choices,
    vehicle_topics,
)


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


SCAN, ODOMETRY = TopicKind.SCAN.message_type, TopicKind.ODOMETRY.message_type
IMAGE, INFO = TopicKind.COLOR.message_type, TopicKind.CAMERA_INFO.message_type
COMPRESSED = TopicKind.COLOR_COMPRESSED.message_type


def chosen(found):
    return {(topic.vehicle, topic.kind): topic.name for topic in found}


def test_a_bag_without_namespaces_is_one_vehicle():
    found, warnings = vehicle_topics(
        {'/odom': ODOMETRY, '/scan': SCAN, '/tf': 'tf2_msgs/msg/TFMessage'}
    )
    assert chosen(found) == {
        ('robot1', TopicKind.ODOMETRY): '/odom',
        ('robot1', TopicKind.SCAN): '/scan',
    }
    assert 'robot1.scan is /scan (found by its type)' in warnings


@pytest.mark.parametrize(
    'names', [('/front/scan', '/odom'), ('/lidar', '/wheels/odometry'), ('/sick_scan', '/o')]
)
def test_topics_of_other_names_are_found_by_their_type(names):
    found, _ = vehicle_topics({names[0]: SCAN, names[1]: ODOMETRY})
    assert chosen(found) == {
        ('robot1', TopicKind.SCAN): names[0],
        ('robot1', TopicKind.ODOMETRY): names[1],
    }


def test_namespaces_with_other_names_are_vehicles():
    names = {f'/{v}/{t}': k for v in ('a', 'b') for t, k in (('o', ODOMETRY), ('lidar', SCAN))}
    found, _ = vehicle_topics(names)
    assert len(found) == 4
    assert chosen(found)[('b', TopicKind.SCAN)] == '/b/lidar'


def test_a_vehicle_found_by_name_gets_what_it_lacks_by_type():
    found, _ = vehicle_topics({'/a/odom': ODOMETRY, '/a/front/lidar': SCAN, '/b/odom': ODOMETRY})
    assert chosen(found)[('a', TopicKind.SCAN)] == '/a/front/lidar'


def test_candidates_are_listed_with_their_rates_instead_of_guessed():
    names = {'/odom': ODOMETRY, '/front_scan': SCAN, '/rear_scan': SCAN}
    with pytest.raises(
        RecordingError, match=r'/front_scan \(10.0 Hz\), /rear_scan \(5.0 Hz\)'
    ) as e:
        vehicle_topics(names, rates={'/front_scan': 10.0, '/rear_scan': 5.0})
    assert '--topic robot1.scan=/front_scan' in str(e.value)
    found, _ = vehicle_topics(names, choices=topic_choices(['robot1.scan=/rear_scan']))
    assert chosen(found)[('robot1', TopicKind.SCAN)] == '/rear_scan'
    assert chosen(found)[('robot1', TopicKind.ODOMETRY)] == '/odom'
    # a usual name is no reason to guess
    with pytest.raises(RecordingError, match=r'2 topics may be robot1.scan: /scan, /scan_2;'):
        vehicle_topics({'/odom': ODOMETRY, '/scan': SCAN, '/scan_2': SCAN})


def test_beside_a_name_of_this_package_other_topics_of_its_type_are_named():
    names = {'/a/odom': ODOMETRY, '/a/scan': SCAN, '/a/rear': SCAN, '/a/fused': ODOMETRY}
    found, warnings = vehicle_topics(names, rates={'/a/rear': 5.0})
    assert chosen(found)[('a', TopicKind.SCAN)] == '/a/scan'
    assert chosen(found)[('a', TopicKind.ODOMETRY)] == '/a/odom'
    assert 'a.scan: also recorded: /a/rear (5.0 Hz); --topic chooses' in warnings
    assert 'a.odometry: also recorded: /a/fused; --topic chooses' in warnings


def test_topics_without_messages_are_no_candidates():
    names = {'/odom': ODOMETRY, '/scan': SCAN, '/scan_2': SCAN}
    found, warnings = vehicle_topics(names, rates={'/odom': 10.0, '/scan': 0.0, '/scan_2': 5.0})
    assert chosen(found)[('robot1', TopicKind.SCAN)] == '/scan_2'
    assert '/scan holds no message' in warnings
    with pytest.raises(RecordingError, match='and no message on /odom, /scan, /scan_2'):
        vehicle_topics(names, rates=dict.fromkeys(names, 0.0))


def test_the_user_names_the_vehicle_and_the_topic():
    found, _ = vehicle_topics(
        {'/o': ODOMETRY, '/l': SCAN}, choices=topic_choices(['tb.odom=/o', 'tb.scan=/l'])
    )
    assert {topic.vehicle for topic in found} == {'tb'}
    for text, reason in {
        'robot1.scan': 'expected VEHICLE.KIND=/TOPIC',
        'robot1.sonar=/s': 'expected VEHICLE.KIND=/TOPIC',
    }.items():
        with pytest.raises(RecordingError, match=reason):
            topic_choices([text])
    with pytest.raises(RecordingError, match='no such topic; the recording holds'):
        vehicle_topics({'/o': ODOMETRY}, choices=topic_choices(['a.scan=/l']))
    with pytest.raises(RecordingError, match=f'of type {ODOMETRY}, expected {SCAN}'):
        vehicle_topics({'/o': ODOMETRY}, choices=topic_choices(['a.scan=/o']))


def test_a_realsense_is_found_with_its_aligned_depth():
    camera = {
        '/camera/color/image_raw': IMAGE,
        '/camera/color/image_raw/compressed': COMPRESSED,
        '/camera/color/camera_info': INFO,
        '/camera/depth/image_rect_raw': IMAGE,
        '/camera/depth/camera_info': INFO,
        '/camera/aligned_depth_to_color/image_raw': IMAGE,
        '/camera/infra1/image_rect_raw': IMAGE,
    }
    found, _ = vehicle_topics({'/odom': ODOMETRY, **camera})
    assert chosen(found) == {
        ('robot1', TopicKind.ODOMETRY): '/odom',
        ('robot1', TopicKind.COLOR): '/camera/color/image_raw',
        ('robot1', TopicKind.DEPTH): '/camera/aligned_depth_to_color/image_raw',
        ('robot1', TopicKind.CAMERA_INFO): '/camera/color/camera_info',
    }
    two = {name.replace('/camera/', '/left/'): kind for name, kind in camera.items()}
    found, warnings = vehicle_topics({'/odom': ODOMETRY, **camera, **two})
    assert len(found) == 1
    assert any('several images' in text for text in warnings)


def test_ground_truth_is_no_odometry():
    found, _ = vehicle_topics({'/ground_truth/odom': ODOMETRY, '/wheel': ODOMETRY, '/s': SCAN})
    assert chosen(found)[('robot1', TopicKind.ODOMETRY)] == '/wheel'


@pytest.mark.parametrize(('raw_rate', 'kept'), [(30.0, ''), (2.0, '/compressed')])
def test_of_an_image_in_two_forms_one_is_kept(raw_rate, kept):
    raw = '/a/camera/rgb/image_raw'
    names = {'/a/odom': ODOMETRY, raw: IMAGE, f'{raw}/compressed': COMPRESSED}
    found, warnings = vehicle_topics(names, rates={raw: raw_rate, f'{raw}/compressed': 30.0})
    assert [topic.name for topic in found if topic.name.startswith(raw)] == [raw + kept]
    assert any('is the same image' in text for text in warnings)
    chosen_form = topic_choices([f'a.color={raw}/compressed'])
    found, _ = vehicle_topics(names, choices=chosen_form, rates={raw: 30.0})
    assert [t.name for t in found if t.name.startswith(raw)] == [f'{raw}/compressed']
