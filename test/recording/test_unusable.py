"""Recordings of which most cannot be used: one line for each topic, with the reason."""

import numpy as np
import odd_bags
import pytest
from odd_bags import content

from explore_slam import messages
from explore_slam.data import Intrinsics, RgbdFrame
from explore_slam.errors import RecordingError
from explore_slam.messages.frame_pairing import frame_messages
from explore_slam.recording import BagReader, Replay, TopicKind
from explore_slam.recording.bag import BagWriter
from explore_slam.recording.rosbags_types import MESSAGES, serialize
from explore_slam.results.replay_run import known_area, replay_bag


def restamped(change):
    """The usual content, with stamps by a function of topic, number and stamp (s)."""
    for number, (topic, kind, time, data) in enumerate(content()):
        message = BagReader.decode(odd_bags.raw(topic, kind, time, data))
        stamp = change(topic, number // 2, messages.seconds(message.header.stamp))
        message.header.stamp = messages.time_message(MESSAGES, stamp)
        yield topic, kind, time, serialize(kind, message)


def replayed(path):
    """What most of a recording is unusable for, and the notes."""
    with BagReader(path) as bag:
        replay = Replay(bag)
        for _ in replay.events():
            pass
        return replay.unusable(), replay.warnings


CASES = {
    'frozen': (lambda _, __, s: 100.0 if s > 100.0 else s, 'have the stamp of the one before'),
    'reversed': (lambda _, __, s: 200.0 - s, 'have an earlier stamp than the one before'),
}


@pytest.mark.parametrize('topic', ['/odom', '/scan'])
@pytest.mark.parametrize('case', CASES)
def test_stamps_that_cannot_be_right_make_a_topic_unusable(tmp_path, case, topic):
    change, reason = CASES[case]
    records = restamped(lambda name, n, s: change(name, n, s) if name == topic else s)
    found, notes = replayed(odd_bags.write_ros2(tmp_path / 'bag', records=records))
    (text,) = [text for text in found if topic in text]
    assert reason in text
    assert sum(f'on {topic}' in note for note in notes) <= 2


def test_stamps_of_zero_later_in_a_recording_fall_back_to_the_log_time(tmp_path):
    records = restamped(lambda name, n, s: 0.0 if name == '/scan' and n % 3 else s)
    path = odd_bags.write_ros2(tmp_path / 'bag', records=records)
    found, notes = replayed(path)
    assert found == []
    (note,) = [note for note in notes if '/scan' in note and 'zero' in note]
    assert note == '200 of 300 messages on /scan have the stamp zero: the log time is used'


def test_a_first_stamp_of_zero_does_not_hide_another_clock(tmp_path):
    records = restamped(lambda name, n, s: 0.05 * n if name == '/scan' else s)
    _, notes = replayed(odd_bags.write_ros2(tmp_path / 'bag', records=records))
    assert any('stamps on /' in note and '100.000 s' in note for note in notes)


def test_a_message_with_huge_numbers_is_refused_alone(tmp_path):
    def spoilt():
        for number, (topic, kind, time, data) in enumerate(content()):
            message = BagReader.decode(odd_bags.raw(topic, kind, time, data))
            if number == 20:
                message.pose.pose.orientation.w = 1e300
            yield topic, kind, time, serialize(kind, message)

    found, notes = replayed(odd_bags.write_ros2(tmp_path / 'bag', records=spoilt()))
    assert found == []
    assert any('1 messages on /odom refused' in note and '1e+300' in note for note in notes)


def test_a_recording_of_topics_without_messages_is_refused(tmp_path):
    with BagWriter(tmp_path / 'bag') as writer:
        for topic, kind in odd_bags.TOPICS.items():
            writer.add_topic(topic, kind)
    with pytest.raises(RecordingError, match='and no message on /odom, /scan'):
        replayed(tmp_path / 'bag')


@pytest.mark.parametrize('value', [np.nan, 0.0, 0.01])
def test_scans_without_any_range_are_unusable(tmp_path, value):
    def blind():
        for topic, kind, time, data in content(60):
            message = BagReader.decode(odd_bags.raw(topic, kind, time, data))
            if topic == '/scan':
                message.ranges = np.full(90, value, np.float32)
            yield topic, kind, time, serialize(kind, message)

    bag = odd_bags.write_ros2(tmp_path / 'bag', records=blind())
    data = replay_bag(bag, options={'particles': 10, 'resolution': 0.2})
    assert any('60 of 60 scans of robot1 hold no range' in t for t in data.metrics['unusable'])


def test_the_area_at_the_end_is_that_of_the_map(tmp_path):
    bag = odd_bags.write_ros2(tmp_path / 'bag', records=content(60))
    data = replay_bag(bag, options={'particles': 10, 'resolution': 0.2}, until=2.0)
    assert data.grid is not None
    assert known_area(data.grid) > 1.0
    assert data.metrics['coverage'] == pytest.approx(known_area(data.grid))


def test_messages_lost_with_their_file_make_a_topic_unusable(tmp_path):
    """Metadata count all messages; only the first part of the file is left."""
    folder = odd_bags.write_ros2(tmp_path / 'bag')
    whole = odd_bags.write_mcap(tmp_path / 'x.mcap', compression='')
    (folder / 'bag.mcap').write_bytes(whole.read_bytes())
    odd_bags.truncate(folder / 'bag.mcap', 0.4)
    found, notes = replayed(folder)
    assert len(found) == 2
    assert all('cannot be read' in text and 'of 300 messages' in text for text in found)
    assert sum('truncated' in note for note in notes) == 1


CAMERA = Intrinsics(32, 24, 30.0, 30.0, 16.0, 12.0)


def write_frames(path, *, info_after=0, depth_late=0.0, info=True, good_depth=True):
    """Odometry and 20 frames; camera_info once, after so many frames."""
    names = {
        TopicKind.COLOR: '/camera/color/image_raw',
        TopicKind.DEPTH: '/camera/aligned_depth/image_raw',
        TopicKind.CAMERA_INFO: '/camera/color/camera_info',
    }
    with BagWriter(path) as writer:
        for topic, kind, time, data in content(20):
            if topic == '/odom':
                writer.add_topic(topic, kind)
                writer.write(topic, time, data)
        for number in range(20):
            stamp = 100.0 + 0.05 * number
            depth = np.full((24, 32), 1500, np.uint16)
            frame = RgbdFrame(stamp, np.full((24, 32, 3), 90, np.uint8), depth, CAMERA)
            for kind, message in frame_messages(MESSAGES, 'camera', frame):
                if kind is TopicKind.CAMERA_INFO and (not info or number != info_after):
                    continue
                if kind is TopicKind.DEPTH:
                    message.header.stamp = messages.time_message(MESSAGES, stamp + depth_late)
                    message.encoding = '16UC1' if good_depth else 'weird'
                writer.write_message(names[kind], kind.message_type, stamp, message)
    return path


def frames_of(path, settings=None):
    with BagReader(path) as bag:
        replay = Replay(bag, settings=settings)
        found = sum(event.kind is TopicKind.COLOR for event in replay.events())
        return found, replay.unusable(), replay


def test_a_camera_info_that_comes_later_serves_the_frames_before_it(tmp_path):
    found, unusable, _ = frames_of(write_frames(tmp_path / 'bag', info_after=15))
    assert (found, unusable) == (20, [])


def test_depth_that_is_too_late_is_named_with_the_tolerance_and_can_be_set(tmp_path):
    path = write_frames(tmp_path / 'bag', depth_late=0.024)
    found, (text,), _ = frames_of(path)
    assert found == 0
    assert 'by at most 20 ms (pairing_tolerance)' in text
    found, unusable, _ = frames_of(path, {'pairing_tolerance': 0.03})
    assert found >= 19
    assert unusable == []


def test_refusals_are_counted_on_the_topic_that_was_refused(tmp_path):
    found, (text,), replay = frames_of(write_frames(tmp_path / 'bag', good_depth=False))
    assert found == 0
    assert replay.tally.refused == {'/camera/aligned_depth/image_raw': 20}
    assert '20 of 20 messages on /camera/aligned_depth/image_raw unusable' in text
