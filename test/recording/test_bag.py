"""Bags: what goes in comes out; cut and foreign ones are named, and used as far as they go."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from explore_slam import messages
from explore_slam.data import LaserScan, OdometryReading
from explore_slam.errors import RecordingError
from explore_slam.geometry import Pose2
from explore_slam.messages.topics import TopicKind
from explore_slam.recording.bag import BagReader, BagWriter
from explore_slam.recording.events import Event, odometry_event, write_event
from explore_slam.recording.rosbags_types import MESSAGES, serialize, typestore


def scan_event(stamp: float, beams: int = 200) -> Event:
    ranges = np.linspace(0.5, 7.5, beams, dtype=np.float32)
    return Event(stamp, 'robot1', TopicKind.SCAN, LaserScan(stamp, -1.5, 0.01, ranges, 0.1, 8.0))


def make_bag(path: Path, count: int, *, compress: bool = False) -> None:
    with BagWriter(path, compress=compress) as writer:
        for index in range(count):
            stamp = 10.0 + 0.1 * index
            write_event(writer, odometry_event('robot1', stamp, Pose2(0.1 * index, 0.0, 0.0)))
            write_event(writer, scan_event(stamp))


def cut(path: Path, share: float) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])


@pytest.mark.parametrize('compress', [False, True])
def test_round_trip(tmp_path, compress):
    make_bag(tmp_path / 'bag', 50, compress=compress)
    with BagReader(tmp_path / 'bag') as bag:
        assert bag.topics == {
            '/robot1/odom': 'nav_msgs/msg/Odometry',
            '/robot1/scan': 'sensor_msgs/msg/LaserScan',
        }
        assert bag.message_count == 100
        assert (bag.start, bag.end // 10) == (10_000_000_000, 1_490_000_000)
        log_times = [message.log_time for message in bag.messages()]
        assert log_times == sorted(log_times)
        scans = list(bag.messages(['/robot1/scan']))
        assert len(scans) == 50
        scan = messages.scan_record(bag.decode(scans[3]))
        np.testing.assert_array_equal(scan.ranges, scan_event(0.0).record.ranges)
        assert scan.stamp == pytest.approx(10.3, abs=1e-9)
        assert bag.warnings == []


def test_reads_a_single_file_and_sqlite(tmp_path):
    make_bag(tmp_path / 'bag', 3)
    assert BagReader(tmp_path / 'bag' / 'bag.mcap').message_count == 6
    kind = 'nav_msgs/msg/Odometry'
    reading = OdometryReading(1.0, Pose2(1.0, 2.0, 0.5))
    message = messages.odometry_message(MESSAGES, reading, 'odom', 'base_link')
    with Writer(tmp_path / 'db', version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection('/a/odom', kind, typestore=typestore())
        writer.write(connection, 1_000_000_000, serialize(kind, message))
    with BagReader(tmp_path / 'db') as bag:
        (raw,) = bag.messages()
        assert messages.odometry_record(bag.decode(raw)).pose == pytest.approx((1.0, 2.0, 0.5))


@pytest.mark.parametrize('compress', [False, True])
@pytest.mark.parametrize('share', [0.3, 0.6, 0.95])
def test_a_truncated_bag_gives_what_came_before_the_cut(tmp_path, compress, share):
    make_bag(tmp_path / 'whole', 3000, compress=compress)
    whole = list(BagReader(tmp_path / 'whole').messages())
    shutil.copytree(tmp_path / 'whole', tmp_path / 'bag')
    cut(tmp_path / 'bag' / 'whole.mcap', share)
    with BagReader(tmp_path / 'bag') as bag:
        found = list(bag.messages())
        assert 0 < len(found) <= len(whole)
        assert found == whole[: len(found)]
        if not compress:
            assert len(found) > (share - 0.1) * len(whole)
        assert any('whole.mcap' in text for text in bag.warnings)
        if len(found) < len(whole):  # else the cut went through the index alone
            assert any('whole.mcap is truncated' in text for text in bag.warnings)


def test_a_bag_without_metadata_is_read_whole(tmp_path):
    make_bag(tmp_path / 'bag', 10)
    (tmp_path / 'bag' / 'metadata.yaml').unlink()
    with BagReader(tmp_path / 'bag') as bag:
        assert len(list(bag.messages())) == 20
        assert 'metadata.yaml' in bag.warnings[0]


def test_a_writer_that_fails_leaves_a_readable_bag(tmp_path):
    def record() -> None:
        with BagWriter(tmp_path / 'bag') as writer:
            write_event(writer, scan_event(1.0))
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        record()
    assert BagReader(tmp_path / 'bag').message_count == 1


def test_an_empty_bag_can_be_written_and_read(tmp_path):
    with BagWriter(tmp_path / 'bag') as writer:
        writer.add_topic('/robot1/scan', 'sensor_msgs/LaserScan')
    bag = BagReader(tmp_path / 'bag')
    assert (bag.message_count, bag.start, bag.end) == (0, 0, 0)
    assert list(bag.messages()) == []


def test_what_is_no_bag_is_named(tmp_path):
    with pytest.raises(RecordingError, match=r'absent does not exist'):
        BagReader(tmp_path / 'absent')
    (tmp_path / 'text.txt').write_text('no bag')
    with pytest.raises(RecordingError, match=r'text\.txt is not a bag'):
        BagReader(tmp_path / 'text.txt')
    (tmp_path / 'wrong.mcap').write_text('no bag either')
    with pytest.raises(RecordingError, match=r'wrong\.mcap'):
        BagReader(tmp_path / 'wrong.mcap')
    (tmp_path / 'wrong.db3').write_text('no bag either')
    with pytest.raises(RecordingError, match=r'wrong\.db3'):
        BagReader(tmp_path / 'wrong.db3')
    (tmp_path / 'empty').mkdir()
    with pytest.raises(RecordingError, match='empty is not a bag'):
        BagReader(tmp_path / 'empty')


def test_existing_paths_and_unknown_types_are_refused(tmp_path):
    make_bag(tmp_path / 'bag', 1)
    with pytest.raises(RecordingError, match='exists'):
        BagWriter(tmp_path / 'bag')
    with BagWriter(tmp_path / 'other') as writer:
        with pytest.raises(RecordingError, match=r'nobody_msgs/msg/Nothing'):
            writer.add_topic('/x', 'nobody_msgs/Nothing')
        with pytest.raises(RecordingError, match='/y was not declared'):
            writer.write('/y', 0, b'')


def test_data_that_do_not_fit_their_type_are_named(tmp_path):
    make_bag(tmp_path / 'bag', 1)
    with BagReader(tmp_path / 'bag') as bag:
        message = next(bag.messages(['/robot1/scan']))
        with pytest.raises(RecordingError, match=r'/robot1/scan at 10\.000 s'):
            bag.decode(message._replace(data=message.data[:40]))
