"""Odd and damaged recordings: what they hold is read, what is lost is named with the reason."""

import os
import re
import shutil
import stat

import numpy as np
import odd_bags
import pytest
import yaml
from backports import zstd
from odd_bags import COUNT, content, only_file, times
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from explore_slam import messages
from explore_slam.errors import RecordingError
from explore_slam.recording import BagReader

ALL = times(content())


def read(path):
    """Topics and log times of all messages, and the warnings afterwards."""
    with BagReader(path) as bag:
        found = [(message.topic, message.log_time) for message in bag.messages()]
        for message in bag.messages():
            bag.decode(message)
        assert [time for _, time in found] == sorted(time for _, time in found)
        return found, bag.warnings


def read_whole(path):
    """The warnings of a bag of which nothing is missing."""
    found, warnings = read(path)
    assert found == ALL
    return warnings


@pytest.fixture(scope='module')
def bags(tmp_path_factory):
    """Whole bags in all formats."""
    folder = tmp_path_factory.mktemp('bags')
    odd_bags.write_ros2(folder / 'mcap')
    odd_bags.write_ros2(folder / 'db', StoragePlugin.SQLITE3)
    odd_bags.write_ros1(folder / 'whole.bag')
    return folder


@pytest.fixture
def copies(bags, tmp_path):
    shutil.copytree(bags, tmp_path / 'bags')
    return tmp_path / 'bags'


# -- whole, in unusual form -----------------------------------------------------------------------


def test_whole_bags_are_read_without_a_warning(bags):
    for path in (bags / 'mcap', bags / 'db', bags / 'whole.bag', bags / 'mcap' / 'mcap.mcap'):
        assert read_whole(path) == []


@pytest.mark.parametrize('compression', ['BZ2', 'LZ4'])
def test_compressed_bags_of_ros_1_become_messages_of_ros_2(tmp_path, compression):
    path = odd_bags.write_ros1(tmp_path / 'x.bag', compression)
    assert read_whole(path) == []
    with BagReader(path) as bag:
        assert bag.topics == odd_bags.TOPICS
        scans = [messages.scan_record(bag.decode(raw)) for raw in bag.messages(['/scan'])]
        poses = [messages.odometry_record(bag.decode(raw)).pose for raw in bag.messages(['/odom'])]
    expected = np.random.default_rng(7).uniform(1.0, 7.0, 90).astype(np.float32)
    np.testing.assert_array_equal(scans[7].ranges, expected)
    assert poses[50].x == pytest.approx(1.0)


@pytest.mark.parametrize('mode', [CompressionMode.FILE, CompressionMode.MESSAGE])
@pytest.mark.parametrize('with_metadata', [True, False])
def test_bags_compressed_by_file_or_by_message(tmp_path, mode, with_metadata):
    folder = odd_bags.write_compressed(tmp_path / 'bag', mode)
    if not with_metadata:
        (folder / 'metadata.yaml').unlink()
    warnings = read_whole(folder)
    assert with_metadata == (not warnings)


@pytest.mark.parametrize('suffix', ['.zstd', '.zst'])
def test_a_file_compressed_as_a_whole(copies, suffix):
    from backports import zstd

    source = copies / 'mcap' / 'mcap.mcap'
    packed = copies / f'x.mcap{suffix}'
    packed.write_bytes(zstd.compress(source.read_bytes()))
    assert read_whole(packed) == []
    # the player of rosbag2 leaves the unpacked file beside it: it is one recording, not two
    shutil.copy(packed, copies / 'mcap' / f'mcap.mcap{suffix}')
    assert read_whole(copies / 'mcap') == []
    odd_bags.truncate(packed, 0.7)
    found, warnings = read(packed)
    assert 0 < len(found) < len(ALL)
    assert found == ALL[: len(found)]
    assert any('zstd data end too early' in text for text in warnings)


@pytest.mark.parametrize('compression', ['zstd', '', None])
def test_an_mcap_without_index_and_without_summary(tmp_path, compression):
    path = odd_bags.write_mcap(tmp_path / 'x.mcap', compression=compression)
    assert read_whole(path) == []


def test_messages_of_ros_1_in_an_mcap_become_those_of_ros_2(tmp_path):
    path = odd_bags.write_mcap(tmp_path / 'x.mcap', 'ros1')
    assert read_whole(path) == []
    with BagReader(path) as bag:
        assert bag.topics == odd_bags.TOPICS
        last = list(bag.messages(['/odom']))[-1]
        assert messages.odometry_record(bag.decode(last)).pose.x == pytest.approx(0.02 * 299)


def test_chunks_in_any_order_are_read_by_time(tmp_path):
    assert read_whole(odd_bags.write_mcap(tmp_path / 'x.mcap', shuffled=True)) == []


def test_the_rows_of_a_write_ahead_log_are_read_and_the_folder_stays_as_it_is(bags, tmp_path):
    folder = odd_bags.with_write_ahead_log(tmp_path, bags / 'db' / 'db.db3')
    before = {file.name: file.stat().st_mtime_ns for file in folder.iterdir()}
    (warning,) = read_whole(folder)
    assert 'metadata.yaml is missing' in warning
    folder.chmod(stat.S_IRUSR | stat.S_IXUSR)
    assert len(read_whole(folder)) == 1
    assert {file.name: file.stat().st_mtime_ns for file in folder.iterdir()} == before
    folder.chmod(stat.S_IRWXU)


def test_a_split_recording_with_a_part_missing(tmp_path):
    records = list(content())
    for part in range(3):
        odd_bags.write_ros2(tmp_path / f'p{part}', records=records[200 * part : 200 * part + 200])
    folder = tmp_path / 'bag'
    folder.mkdir()
    for part in range(3):
        shutil.copy(only_file(tmp_path / f'p{part}', '.mcap'), folder / f'bag_{part}.mcap')
    assert 'metadata.yaml is missing' in read_whole(folder)[0]
    metadata = yaml.safe_load((tmp_path / 'p0' / 'metadata.yaml').read_text())
    info = metadata['rosbag2_bagfile_information']
    info['relative_file_paths'] = [f'bag_{part}.mcap' for part in range(3)]
    for topic in info['topics_with_message_count']:
        topic['message_count'] = COUNT
    (folder / 'metadata.yaml').write_text(yaml.safe_dump(metadata))
    assert read_whole(folder) == []
    (folder / 'bag_1.mcap').unlink()
    found, warnings = read(folder)
    assert found == ALL[:200] + ALL[400:]
    text = ' '.join(warnings)
    assert 'bag_1.mcap is missing' in text
    assert '200 of 300 on /odom' in text
    with BagReader(folder) as bag:
        assert bag.expected == {'/odom': 300, '/scan': 300}


def test_metadata_that_is_empty_wrong_or_given_in_place_of_the_folder(copies):
    path = copies / 'mcap' / 'metadata.yaml'
    assert read_whole(path) == []
    original = path.read_text()
    path.write_text(re.sub(r'message_count: 300', 'message_count: 900', original))
    (warning,) = read_whole(copies / 'mcap')
    assert 'metadata.yaml counts 1800 messages, its files hold 600' in warning
    path.write_text(original.replace('mcap.mcap', 'renamed.mcap'))
    assert read_whole(copies / 'mcap') == []
    for wrong in ('', 'just text', '[1, 2', 'rosbag2_bagfile_information: {}', '\x00\x01'):
        path.write_text(wrong)
        (warning,) = read_whole(copies / 'mcap')
        assert 'metadata.yaml' in warning


def test_a_folder_that_holds_one_bag_or_several(copies):
    (copies / 'whole.bag').unlink()
    with pytest.raises(RecordingError, match=r'holds 2 bags: name one of db, mcap'):
        BagReader(copies)
    shutil.rmtree(copies / 'db')
    (warning,) = read_whole(copies)
    assert 'holds one bag, mcap' in warning
    shutil.copy(copies / 'mcap' / 'mcap.mcap', copies / 'mcap' / 'other.mcap')
    (copies / 'mcap' / 'metadata.yaml').unlink()
    with pytest.raises(RecordingError, match=r'holds 2 recordings and no metadata\.yaml'):
        BagReader(copies / 'mcap')


# -- damaged --------------------------------------------------------------------------------------


@pytest.mark.parametrize('share', [0.02, 0.2, 0.5, 0.8, 0.97])
@pytest.mark.parametrize('kind', ['mcap', 'unindexed', 'db', 'ros1'])
def test_truncated_files_give_what_came_before_the_cut(copies, kind, share):
    unindexed = odd_bags.write_mcap(copies / 'unindexed.mcap', compression='')
    path = {
        'mcap': copies / 'mcap' / 'mcap.mcap', 'unindexed': unindexed,
        'db': copies / 'db' / 'db.db3', 'ros1': copies / 'whole.bag',
    }[kind]  # fmt: skip
    odd_bags.truncate(path, share)
    if share < 0.1 and kind == 'db':  # the cut lies before the first row
        with pytest.raises(RecordingError, match=path.name):
            BagReader(path)
        return
    found, warnings = read(path)
    assert set(found) <= set(ALL)
    assert len(found) >= (share - 0.2) * len(ALL)
    assert warnings or found == ALL
    assert all(str(path) in text for text in warnings)


@pytest.mark.parametrize('share', [0.1, 0.5, 0.8])
@pytest.mark.parametrize('kind', ['zstd', '', 'ros1'])
def test_after_a_damage_in_the_middle_reading_goes_on(copies, kind, share):
    path = copies / 'whole.bag'
    if kind != 'ros1':
        path = odd_bags.write_mcap(copies / 'x.mcap', compression=kind)
    odd_bags.overwrite(path, share, 4000)
    found, warnings = read_damaged(path)
    assert set(found) <= set(ALL)
    assert len(found) >= 0.6 * len(ALL)
    assert ALL[0] in found
    assert ALL[-1] in found
    assert any('is damaged' in text for text in warnings)
    assert len(warnings) <= 3


def read_damaged(path):
    """As read, without decoding: the data themselves may be damaged."""
    with BagReader(path) as bag:
        found = [(message.topic, message.log_time) for message in bag.messages()]
        return found, bag.warnings


def test_a_wrong_checksum_is_named_once_and_the_messages_are_used(tmp_path):
    path = odd_bags.write_mcap(tmp_path / 'x.mcap', chunk1=1, chunk3=2)
    (warning,) = read_whole(path)
    assert 'the checksum of the chunk at byte' in warning
    assert 'and 1 other place' in warning


@pytest.mark.parametrize('share', [0.3, 0.5, 0.7])
def test_a_database_with_a_damaged_page_gives_the_rows_on_the_others(copies, share):
    path = copies / 'db' / 'db.db3'
    odd_bags.damage_page(path, share)
    found, warnings = read_damaged(path)
    assert set(found) <= set(ALL)
    assert len(found) >= 0.9 * len(ALL)
    found, warnings = read_damaged(copies / 'db')
    if len(found) < len(ALL):
        text = ' '.join(warnings)
        assert 'malformed' in text
        assert 'metadata.yaml counts 600 messages' in text


def test_a_bag_of_ros_1_that_was_not_closed(copies):
    path = copies / 'whole.bag'
    data = path.read_bytes()
    at = data.index(b'index_pos=') + len(b'index_pos=')
    index = int.from_bytes(data[at : at + 8], 'little')
    active = copies / 'x.bag.active'
    active.write_bytes(data[:at] + bytes(8) + data[at + 8 : index])
    (warning,) = read_whole(active)
    assert 'has no index (it was not closed): 600 messages can be read' in warning


def test_an_index_without_its_entries_does_not_empty_a_file(copies):
    """Each message index says that it has no entries, as some converters write it."""
    path = copies / 'mcap' / 'mcap.mcap'
    data = path.read_bytes()
    kept, at = [odd_bags.MAGIC], len(odd_bags.MAGIC)
    while at < len(data) - len(odd_bags.MAGIC):
        kind, size = data[at], int.from_bytes(data[at + 1 : at + 9], 'little')
        if kind != 7:
            kept.append(data[at : at + 9 + size])
        at += 9 + size
    path.write_bytes(b''.join(kept) + odd_bags.MAGIC)
    assert read_whole(copies / 'mcap') == []


# -- no recording ---------------------------------------------------------------------------------


POINTER = (
    'version https://git-lfs.github.com/spec/v1\noid sha256:4d7a214614ab2935c943f9e0ff69d22e\n'
    'size 12345\n'
)


@pytest.mark.parametrize('name', ['x.mcap', 'x.db3', 'x.bag', 'folder'])
def test_a_pointer_of_git_lfs_is_named(tmp_path, copies, name):
    path = tmp_path / name
    if name == 'folder':
        path = copies / 'mcap'
        (path / 'mcap.mcap').write_text(POINTER)
    else:
        path.write_text(POINTER)
    with pytest.raises(RecordingError, match=r'Git LFS pointer .* run `git lfs pull`'):
        BagReader(path)


@pytest.mark.parametrize('encoding', ['json', 'protobuf'])
def test_content_of_another_encoding_is_named(tmp_path, encoding):
    path = odd_bags.write_mcap(tmp_path / 'x.mcap', encoding)
    with pytest.raises(RecordingError, match=rf'/odom holds {encoding.upper()} messages'):
        BagReader(path)


@pytest.mark.parametrize(
    ('data', 'reason'),
    [
        (b'', 'it is empty'),
        (bytes(5000), 'it begins with zeros'),
        (b'<!DOCTYPE html><html>', r'it begins with .*<!DOCTYPE ht'),
        (b'#ROSBAG V1.2\n', 'format 1.x'),
        (b'PK\x03\x04abcdef', 'expected an mcap file'),
    ],
)
@pytest.mark.parametrize('name', ['x.mcap', 'x.db3', 'x.bag'])
def test_what_is_no_recording_is_named(tmp_path, data, reason, name):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(RecordingError, match=reason):
        BagReader(tmp_path / name)


def test_a_recording_whose_only_file_is_gone(copies):
    (copies / 'mcap' / 'mcap.mcap').unlink()
    with pytest.raises(RecordingError, match=r'mcap\.mcap, named in metadata\.yaml, is missing'):
        BagReader(copies / 'mcap')


@pytest.mark.skipif(os.geteuid() == 0, reason='root may read everything')
def test_a_file_that_may_not_be_read(copies):
    path = copies / 'mcap' / 'mcap.mcap'
    path.chmod(0)
    with pytest.raises(RecordingError, match='Permission denied'):
        BagReader(path)


def test_a_database_whose_header_is_damaged_is_named(copies):
    path = odd_bags.only_file(copies / 'db', '.db3')
    data = bytearray(path.read_bytes())
    data[28:32] = b'\xf0\x00\x00\x00'  # pages
    data[16:18] = b'\x80\x00'  # bytes of each
    path.write_bytes(bytes(data))
    with pytest.raises(RecordingError, match=rf'{path.name} .*(damaged|cannot be read)'):
        BagReader(path)


def test_a_packed_file_that_ends_within_its_first_block_is_named_so(tmp_path):
    packed = tmp_path / 'bag.mcap.zstd'
    packed.write_bytes(zstd.compress(bytes(range(256)) * 40)[:12])
    with pytest.raises(RecordingError, match='its zstd data end too early'):
        BagReader(packed)
