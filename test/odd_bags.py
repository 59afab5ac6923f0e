"""Small recordings in all formats, whole and damaged, for tests."""

import shutil
import sqlite3
import struct
import zlib
from pathlib import Path

import numpy as np
from backports import zstd
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from explore_slam import messages
from explore_slam.data import LaserScan, OdometryReading
from explore_slam.geometry import Pose2
from explore_slam.recording.rosbags_types import MESSAGES, serialize, typestore
from explore_slam.recording.storage.storage import RawMessage

ODOMETRY, SCAN = 'nav_msgs/msg/Odometry', 'sensor_msgs/msg/LaserScan'
TOPICS = {'/odom': ODOMETRY, '/scan': SCAN}
COUNT = 300  # of odometry messages and of scans
PERIOD = 0.05  # s


def content(count=COUNT, begin=100.0):
    """Yield topic, type, log time (ns) and CDR data: odometry and scans in turn."""
    for index in range(count):
        stamp = begin + PERIOD * index
        reading = OdometryReading(stamp, Pose2(0.02 * index, 0.0, 0.0))
        odometry = messages.odometry_message(MESSAGES, reading, 'odom', 'base_link')
        yield '/odom', ODOMETRY, round(stamp * 1e9), serialize(ODOMETRY, odometry)
        ranges = np.random.default_rng(index).uniform(1.0, 7.0, 90).astype(np.float32)
        scan = LaserScan(stamp, -1.5, 0.03, ranges, 0.1, 8.0)
        message = messages.scan_message(MESSAGES, scan, 'laser')
        yield '/scan', SCAN, round(stamp * 1e9) + 1000, serialize(SCAN, message)


def raw(topic, kind, time, data):
    return RawMessage(topic, kind, time, data)


def times(found):
    """Topics and log times of messages: what must come out again."""
    return [(topic, time) for topic, _, time, *_ in found]


def write_ros2(path, plugin=StoragePlugin.MCAP, mode=None, records=None):
    """A rosbag2 folder."""
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        if mode is not None:
            writer.set_compression(mode, CompressionFormat.ZSTD)
        known = {}
        for topic, kind, time, data in content() if records is None else records:
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=typestore())
            writer.write(known[topic], time, data)
    return path


def write_compressed(path, mode):
    """As write_ros2; the mode must be set before the folder is opened."""
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        known = {}
        for topic, kind, time, data in content():
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=typestore())
            writer.write(known[topic], time, data)
    return path


def as_ros1(data, kind):
    return bytes(typestore().cdr_to_ros1(data, kind))


def write_ros1(path, compression=None):
    """A bag of ROS 1, with several chunks."""
    noetic = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer1(path)
    writer.chunk_threshold = 20_000
    if compression is not None:
        writer.set_compression(Writer1.CompressionFormat[compression])
    with writer:
        known = {}
        for topic, kind, time, data in content():
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=noetic)
            writer.write(known[topic], time, as_ros1(data, kind))
    return path


# -- mcap, record by record -----------------------------------------------------------------------

MAGIC = b'\x89MCAP0\r\n'


def text(value):
    data = value.encode()
    return struct.pack('<I', len(data)) + data


def record(kind, data):
    return struct.pack('<BQ', kind, len(data)) + data


def message_record(channel, time, data):
    return record(5, struct.pack('<HIQQ', channel, 0, time, time) + data)


def chunk(records, first, last, compression='zstd', checksum=None):
    data = zstd.compress(records) if compression == 'zstd' else records
    head = struct.pack('<QQQI', first, last, len(records), checksum or zlib.crc32(records))
    return record(6, head + text(compression) + struct.pack('<Q', len(data)) + data)


def write_mcap(path, encoding='cdr', compression='zstd', per_chunk=60, shuffled=False, **spoilt):
    """A file without index and without summary.

    compression None: messages outside of chunks. spoilt: number of a chunk -> its checksum.
    """
    channels = b''
    for number, (topic, kind) in enumerate(TOPICS.items(), start=1):
        schema = {'cdr': 'ros2msg', 'json': 'jsonschema'}.get(encoding, encoding)
        channels += record(3, struct.pack('<H', number) + text(kind) + text(schema) + text(''))
        channels += record(
            4, struct.pack('<HH', number, number) + text(topic) + text(encoding) + text('')
        )
    found = list(content())
    if encoding == 'ros1':
        found = [(*rest, kind, at, as_ros1(data, kind)) for *rest, kind, at, data in found]
    numbers = {topic: number for number, topic in enumerate(TOPICS, start=1)}
    parts = [found[at : at + per_chunk] for at in range(0, len(found), per_chunk)]
    data = MAGIC + record(1, text('ros2') + text('test'))
    if compression is None:
        data += channels
    for index, part in enumerate(reversed(parts) if shuffled else parts):
        records = b''.join(message_record(numbers[t], at, cdr) for t, _, at, cdr in part)
        if compression is None:
            data += records
        else:
            checksum = spoilt.get(f'chunk{index}')
            data += chunk(channels + records, part[0][2], part[-1][2], compression, checksum)
    path.write_bytes(data + record(15, bytes(4)) + record(2, bytes(20)) + MAGIC)
    return path


# -- damage ---------------------------------------------------------------------------------------


def overwrite(path, share, length=3000, value=b'\xa5'):
    """Overwrite bytes from a share of the file on."""
    data = bytearray(path.read_bytes())
    at = int(share * len(data))
    data[at : at + length] = (value * length)[: len(data[at : at + length])]
    path.write_bytes(bytes(data))


def truncate(path, share):
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])


def only_file(folder, suffix):
    (file,) = folder.glob(f'*{suffix}')
    return file


def with_write_ahead_log(folder, source):
    """Copy a database in such a way that its rows are in the write-ahead log alone."""
    work, live = folder / 'work', folder / 'live.db3'
    work.mkdir(parents=True)
    database = sqlite3.connect(live)
    database.execute('PRAGMA journal_mode = WAL')
    database.execute('PRAGMA wal_autocheckpoint = 0')
    database.execute('ATTACH ? AS source', (str(source),))
    tables = database.execute(
        "SELECT sql FROM source.sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite_%'"
    ).fetchall()
    for (sql,) in tables:
        database.execute(sql)
    for name in ('topics', 'messages'):
        database.execute(f'INSERT INTO {name} SELECT * FROM source.{name}')
    database.commit()
    for end in ('', '-wal'):
        shutil.copyfile(f'{live}{end}', work / f'bag_0.db3{end}')
    database.close()
    return work


def damage_page(path, share):
    """Overwrite the page of a database at a share of the file."""
    data = bytearray(path.read_bytes())
    size = struct.unpack_from('>H', data, 16)[0]
    at = int(share * len(data)) // size * size
    data[at : at + size] = bytes(size)
    path.write_bytes(bytes(data))


def copy_of(folder: Path, name: str) -> Path:
    return Path(shutil.copytree(folder, folder.with_name(name)))
