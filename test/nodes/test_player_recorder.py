"""A bag played over live topics and recorded again is the same bag."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from ros_domain import own_domain
from rosgraph_msgs.msg import Clock

from explore_slam.data import (
    ImuReading,
    Intrinsics,
    LandmarkObservations,
    LaserScan,
    OdometryReading,
    RgbdFrame,
)
from explore_slam.errors import RecordingError
from explore_slam.geometry import Pose2
from explore_slam.messages import odometry_message, scan_message, transform_message
from explore_slam.messages.topics import GlobalTopic
from explore_slam.nodes.endpoints import qos_profile
from explore_slam.nodes.player import Player, wait_for_listeners
from explore_slam.nodes.recorder import Recorder, WriterThread, recorded_names
from explore_slam.recording import BagReader, BagWriter, Event, TopicKind
from explore_slam.recording.events import odometry_event, start_event, write_event
from explore_slam.recording.recorded_transforms import recorded_transforms
from explore_slam.recording.rosbags_types import MESSAGES as BAG_MESSAGES
from explore_slam.recording.topic_selection import topic_choices

DOMAIN = own_domain(87)


@pytest.fixture(scope='module', autouse=True)
def context() -> Iterator[None]:
    rclpy.init(domain_id=DOMAIN)
    yield
    rclpy.try_shutdown()


def make_bag(path: Path, seconds: float = 2.0) -> Path:
    rng = np.random.default_rng(1)
    ranges = rng.uniform(0.5, 8.0, 181).astype(np.float32)
    ranges[3:6] = np.nan, np.inf, -np.inf
    rgb = rng.integers(0, 255, (48, 64, 3), dtype=np.uint8)
    depth = rng.integers(500, 3500, (48, 64), dtype=np.uint16)
    seen = LandmarkObservations(
        0.0, rng.normal(size=(3, 3)), np.repeat(0.01 * np.eye(3)[None], 3, 0),
        np.eye(3, 128, dtype=np.float32),
    )  # fmt: skip
    with BagWriter(path) as writer:
        write_event(writer, start_event('robot1', 50.0, Pose2(1.0, 2.0, 0.3)))
        for index in range(round(10 * seconds)):
            stamp = 50.0 + 0.1 * index
            write_event(writer, odometry_event('robot1', stamp, Pose2(0.01 * index, 0, 0)))
            turning = ImuReading(stamp, (0.01, -0.02, 0.1 * index))
            write_event(writer, Event(stamp, 'robot1', TopicKind.IMU, turning))
            scan = LaserScan(stamp, -1.57, 0.01744, ranges, 0.1, 8.0)
            write_event(writer, Event(stamp, 'robot1', TopicKind.SCAN, scan))
            if index % 5 == 0:
                frame = RgbdFrame(stamp, rgb, depth, Intrinsics(64, 48, 60.0, 60.0, 32.0, 24.0))
                write_event(writer, Event(stamp, 'robot1', TopicKind.COLOR, frame))
                marks = LandmarkObservations(
                    stamp, seen.positions, seen.covariances, seen.descriptors
                )
                write_event(writer, Event(stamp, 'robot2', TopicKind.LANDMARKS, marks))
    return path


class Spinner:
    """Spins a node in a thread of its own."""

    def __init__(self, node: Node) -> None:
        self.node = node
        self._going = True
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()

    def _spin(self) -> None:
        while self._going:
            self._executor.spin_once(timeout_sec=0.05)

    def end(self) -> None:
        self._going = False
        self._thread.join()
        self._executor.shutdown()


def wait(condition: Callable[[], bool], timeout: float = 10.0) -> None:
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, 'timed out'
        time.sleep(0.02)


def play_all(player: Player) -> None:
    while not player.done:
        time.sleep(player.step())


@pytest.mark.parametrize('sim_time', [False, True])
def test_played_and_recorded_again_it_is_the_same_bag(tmp_path, sim_time):
    with BagReader(make_bag(tmp_path / 'first')) as bag:
        recorder = Recorder(tmp_path / 'again', use_sim_time=sim_time)
        spinner = Spinner(recorder)
        player = Player(bag, rate=2.0)
        try:
            wait(lambda: not player.unmatched)
            play_all(player)
            wait(lambda: sum(recorder.counts.values()) == bag.message_count)
        finally:
            spinner.end()
            recorder.stop()
            recorder.destroy_node()
            player.destroy_node()
        with BagReader(tmp_path / 'again') as again:
            assert again.topics == bag.topics
            assert again.counts == bag.counts
            for topic in bag.topics:
                first = [message.data for message in bag.messages([topic])]
                second = [message.data for message in again.messages([topic])]
                assert first == second
            if sim_time:
                assert abs(again.start - bag.start) < 10**9
            else:
                assert again.start > 10**18
    assert recorder.dropped == {}


def test_the_clock_follows_the_stamps_and_the_rate(tmp_path):
    clocks: list[tuple[float, float]] = []
    node = Node('listener')
    node.create_subscription(
        Clock,
        '/clock',
        lambda m: clocks.append((time.monotonic(), m.clock.sec + 1e-9 * m.clock.nanosec)),
        50,
    )
    spinner = Spinner(node)
    with BagReader(make_bag(tmp_path / 'bag', 3.0)) as bag:
        player = Player(bag, rate=3.0, until=1.5)
        try:
            wait(lambda: player._clock.get_subscription_count() == 1)
            play_all(player)
            wait(lambda: len(clocks) > 20)
        finally:
            spinner.end()
            node.destroy_node()
            player.destroy_node()
    times = np.array(clocks)
    assert (np.diff(times[:, 1]) >= 0.0).all()
    assert 50.0 <= times[0, 1] < 50.5
    assert 51.3 < times[-1, 1] <= 51.5 + 0.1
    assert player.counts['/robot1/odom'] == 16


def test_only_what_was_asked_for_is_played(tmp_path):
    with BagReader(make_bag(tmp_path / 'bag', 0.5)) as bag:
        player = Player(bag, rate=100.0, vehicles=['robot2'])
        play_all(player)
        assert player.counts == {'/robot2/landmarks': 1}
        player.destroy_node()
        player = Player(bag, rate=100.0, topics=['/robot1/scan'])
        assert wait_for_listeners(player, lambda: False, timeout=0.1) is False
        assert player.unmatched == ['/robot1/scan']
        player.destroy_node()
        with pytest.raises(RecordingError, match='/robot9/scan'):
            Player(bag, topics=['/robot9/scan'])
        with pytest.raises(RecordingError, match='robot9'):
            Player(bag, vehicles=['robot9'])
        with pytest.raises(RecordingError, match='rate is 0'):
            Player(bag, rate=0.0)


def test_several_lasers_that_were_chosen_keep_their_names():
    choices = topic_choices(
        ['robot1.scan=/front/scan', 'robot1.scan=/robot1/rear/scan', 'robot1.odom=/wheels',
         'robot2.scan=/laser', 'robot2.cloud=/lidar/points']
    )  # fmt: skip
    assert recorded_names(choices) == {
        '/front/scan': '/robot1/front/scan',
        '/robot1/rear/scan': '/robot1/rear/scan',
        '/wheels': '/robot1/odom',
        '/laser': '/robot2/scan',
        '/lidar/points': '/robot2/lidar/points',
    }


def test_what_the_disk_cannot_take_is_dropped_and_counted(tmp_path):
    writer = BagWriter(tmp_path / 'bag')
    writer.add_topic('/a/odom', 'nav_msgs/Odometry')
    thread = WriterThread(writer, limit=10)
    thread.put('/a/odom', 1, b'x' * 11)
    thread.put('/a/odom', 2, b'x' * 10)
    thread.close()
    assert thread.dropped == {'/a/odom': 1}
    with BagReader(tmp_path / 'bag') as bag:
        assert [message.log_time for message in bag.messages()] == [2]


def test_a_bag_that_cannot_be_written_is_reported(tmp_path):
    writer = BagWriter(tmp_path / 'bag')
    thread = WriterThread(writer)
    thread.put('/not/declared', 1, b'x')
    thread.close()
    assert '/not/declared' in str(thread.error)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_recorder_asked_to_end_leaves_a_whole_bag(tmp_path, number):
    environment = dict(os.environ, ROS_DOMAIN_ID=str(DOMAIN))
    command = [
        sys.executable, '-m', 'explore_slam.nodes.executables', 'recorder', str(tmp_path / 'out'),
    ]  # fmt: skip
    with BagReader(make_bag(tmp_path / 'bag')) as bag:
        player = Player(bag, rate=4.0, vehicles=['robot1'])
        process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
        try:
            wait(lambda: not player.unmatched, 20.0)
            play_all(player)
            player.flush(10.0)
            process.send_signal(number)
            _, errors = process.communicate(timeout=20.0)
        finally:
            process.kill()
            player.destroy_node()
        assert process.returncode == 0, errors
        with BagReader(tmp_path / 'out') as recorded:
            assert recorded.warnings == []
            expected = {t: c for t, c in bag.counts.items() if t.startswith('/robot1')}
            assert recorded.counts == expected


def test_a_foreign_bag_is_played_as_a_vehicle_and_recorded_with_its_mounts(tmp_path):
    """/front/scan and /odom become robot1's; the mounts of /tf_static are heard, and kept."""
    tf2 = pytest.importorskip('tf2_msgs.msg', reason='tf2_msgs is not installed')
    link = transform_message(
        BAG_MESSAGES, 50.0, 'base_link', 'laser', (0.1, 0.0, 0.2), (0.0, 0.0, 0.6, 0.8)
    )
    ranges = np.ones(181, np.float32)
    with BagWriter(tmp_path / 'first') as writer:
        for child in ('laser', 'imu'):
            link.child_frame_id = child
            message = BAG_MESSAGES.make('tf2_msgs/msg/TFMessage', transforms=[link])
            writer.write_message('/tf_static', 'tf2_msgs/msg/TFMessage', 50.0, message)
        for index in range(10):
            stamp = 50.0 + 0.1 * index
            reading = OdometryReading(stamp, Pose2(0.01 * index, 0.0, 0.0))
            odometry = odometry_message(BAG_MESSAGES, reading, 'odom', 'base_link')
            writer.write_message('/odom', 'nav_msgs/msg/Odometry', stamp, odometry)
            scan = scan_message(
                BAG_MESSAGES, LaserScan(stamp, -1.57, 0.01744, ranges, 0.1, 8.0), 'laser'
            )
            writer.write_message('/front/scan', 'sensor_msgs/msg/LaserScan', stamp, scan)
    transforms: list[object] = []
    live = topic_choices(['tb.scan=/robot1/scan'])
    recorder = Recorder(tmp_path / 'again', choices=live)
    latched = qos_profile(GlobalTopic.TF_STATIC.requested)
    recorder.create_subscription(
        tf2.TFMessage, '/tf_static', lambda m: transforms.extend(m.transforms), latched
    )
    spinner = Spinner(recorder)
    with BagReader(tmp_path / 'first') as bag:
        player = Player(bag, choices=topic_choices(['robot1.scan=/front/scan']))
        try:
            wait(lambda: not player.unmatched and len(transforms) == 2)
            play_all(player)
            wait(lambda: sum(recorder.counts.values()) == 21)
        finally:
            spinner.end()
            recorder.stop()
            recorder.destroy_node()
            player.destroy_node()
    assert {item.child_frame_id for item in transforms} == {'laser', 'imu'}
    with BagReader(tmp_path / 'again') as again:
        assert again.counts == {'/robot1/odom': 10, '/tb/scan': 10, '/tf_static': 1}
        tree = recorded_transforms(again, ['tb'])['tb']
        assert tree.lookup('base_link', 'laser').position == (0.1, 0.0, 0.2)
