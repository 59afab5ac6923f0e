"""Recordings without odometry are replayed by their scans; IMUs are recorded and replayed."""

import math

import numpy as np
import pytest

from explore_slam.agent import Agent, AgentConfig
from explore_slam.cli.main import main
from explore_slam.data import ImuReading, OdometryReading
from explore_slam.errors import RecordingError
from explore_slam.geometry import Pose2, quaternion_from_rotation, rotation_matrix
from explore_slam.messages import transform_message
from explore_slam.messages.topics import GlobalTopic, TopicKind
from explore_slam.recording import BagReader, BagWriter, Event, Replay
from explore_slam.recording.events import truth_event, write_event
from explore_slam.recording.rosbags_types import MESSAGES
from explore_slam.recording.topic_selection import vehicle_topics
from explore_slam.results.replay_run import replay_bag
from explore_slam.settings import with_values
from explore_slam.studies import sensor_rig
from explore_slam.studies.sensor_rig import LASER, START, Drive, Laser

OPTIONS = {'particles': 20, 'laser_mount': list(LASER), 'sweep_stamp': 'first'}
STARTS = {'robot1': START}


@pytest.fixture(scope='module')
def drive():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sensor_rig, 'TOUR', (0.5 * math.pi, (2.0, 4.0)))
        return Drive(0.9)


@pytest.fixture
def bag(tmp_path, drive):
    """Scans and truth of a vehicle without odometry."""
    events = [
        Event(scan.stamp, 'robot1', TopicKind.SCAN, scan)
        for scan in sensor_rig.scans(drive, Laser(10.0), np.random.default_rng(0))
    ]
    for stamp in np.arange(0.0, drive.duration, 0.1):
        pose = Pose2.from_array(drive.at(np.array([stamp]))[0])
        events.append(truth_event('robot1', float(stamp), pose))
    with BagWriter(tmp_path / 'bag') as writer:
        for event in sorted(events, key=lambda item: item.stamp):
            write_event(writer, event)
    return tmp_path / 'bag'


def test_a_recording_without_odometry_is_replayed_by_its_scans(bag):
    data = replay_bag(bag, starts=STARTS, options=OPTIONS)
    (vehicle,) = data.vehicles
    errors = (
        vehicle.online.poses[:, :2]
        - np.stack(
            [
                np.interp(vehicle.online.stamps, vehicle.truth.stamps, c)
                for c in vehicle.truth.poses.T
            ],
            axis=1,
        )[:, :2]
    )
    assert len(vehicle.odometry) > 50
    assert np.sqrt((errors**2).sum(axis=1).mean()) < 0.03
    assert data.metrics['odometry_sources']['robot1']['source'] == 'scan'
    assert data.metrics['unusable'] == []
    note = 'robot1 has no odometry: its scans are taken for it (odometry: scan)'
    assert note in data.notes
    assert 'robot1: its odometry is that of its scans (odometry: scan)' in data.notes


def test_the_command_replays_it_too(bag, tmp_path):
    arguments = ['replay', str(bag), '--out', str(tmp_path / 'runs'), '--no-progress']
    assert main([*arguments, '--particles', '20', '--start', 'robot1=2,2.6,0']) == 0
    report = (tmp_path / 'runs' / 'latest' / 'report.html').read_text()
    assert 'robot1 has no odometry' in report


def test_odometry_in_a_recording_can_be_left_aside(bag, tmp_path):
    with BagWriter(tmp_path / 'both') as writer, BagReader(bag) as reader:
        events = list(Replay(reader, starts=STARTS).events())
        dead = [
            Event(stamp, 'robot1', TopicKind.ODOMETRY, OdometryReading(stamp, Pose2(0, 0, 0)))
            for stamp in np.arange(0.0, events[-1].stamp, 0.05).tolist()
        ]
        for event in sorted([*events, *dead], key=lambda item: item.stamp):
            write_event(writer, event)
    data = replay_bag(tmp_path / 'both', starts=STARTS, options={**OPTIONS, 'odometry': 'scan'})
    assert data.metrics['agent']['robot1']['unused_odometry'] == len(dead)
    with BagReader(tmp_path / 'both') as reader:
        replay = Replay(reader, starts=STARTS, settings={'laser_mount': list(LASER)})
        assert replay.sources == {'robot1': 'wheels'}
        agent = Agent(with_values(AgentConfig(), {'particles': 20}), replay.start_poses())
        replay.feed(agent)
    problem = agent.odometry_sources()['robot1']['problem']
    assert 'odometry does not move while the scans do' in problem


def test_a_recording_without_odometry_and_scans_is_refused(tmp_path):
    with BagWriter(tmp_path / 'bag') as writer:
        for stamp in (1.0, 2.0):
            seen = ImuReading(stamp, (0.0, 0.0, 0.1))
            write_event(writer, Event(stamp, 'robot1', TopicKind.IMU, seen))
    with pytest.raises(RecordingError, match='no topic of a vehicle'):
        replay_bag(tmp_path / 'bag')


def test_an_imu_is_replayed_in_the_frame_of_the_vehicle(tmp_path):
    turn = quaternion_from_rotation(rotation_matrix(math.pi, 0.0, 0.0))  # upside down
    topic = GlobalTopic.TF_STATIC
    mount = transform_message(
        MESSAGES, 0.0, 'robot1/base_link', 'robot1/imu_link', (0.0, 0.0, 0.1), turn
    )
    with BagWriter(tmp_path / 'bag') as writer:
        writer.add_topic(topic.value, topic.message_type, latched=True)
        message = MESSAGES.make(topic.message_type, transforms=[mount])
        writer.write_message(topic.value, topic.message_type, 0.0, message)
        for stamp in (1.0, 1.1):
            reading = OdometryReading(stamp, Pose2(0, 0, 0))
            write_event(writer, Event(stamp, 'robot1', TopicKind.ODOMETRY, reading))
            seen = ImuReading(stamp, (0.1, 0.2, 0.3))
            write_event(writer, Event(stamp, 'robot1', TopicKind.IMU, seen))
    with BagReader(tmp_path / 'bag') as bag:
        replay = Replay(bag, starts=STARTS, settings={'robot1.odometry': 'wheels+gyro'})
        events = [event for event in replay.events() if event.kind is TopicKind.IMU]
        assert replay.sources == {'robot1': 'wheels+gyro'}
    assert [event.stamp for event in events] == [1.0, 1.1]
    assert events[0].record.angular_velocity == pytest.approx((0.1, -0.2, -0.3))


def test_a_reading_that_is_not_finite_is_named_and_left_out(tmp_path):
    with BagWriter(tmp_path / 'bag') as writer:
        for number in range(20):
            stamp = 1.0 + 0.05 * number
            reading = OdometryReading(stamp, Pose2(0, 0, 0))
            write_event(writer, Event(stamp, 'robot1', TopicKind.ODOMETRY, reading))
            seen = ImuReading(stamp, (0.0, 0.0, 0.0))
            object.__setattr__(seen, 'angular_velocity', (0.0, 0.0, math.nan))
            write_event(writer, Event(stamp, 'robot1', TopicKind.IMU, seen))
    data = replay_bag(tmp_path / 'bag', starts=STARTS, options={'odometry': 'wheels+gyro'})
    notes = [note for note in data.notes if 'angular_velocity is (0.0, 0.0, nan)' in note]
    assert len(notes) == 1
    assert data.metrics['records']['robot1/odom'] == 20


def test_an_imu_is_found_by_its_type_and_several_are_left_alone():
    scan, odometry, imu = (
        kind.message_type for kind in (TopicKind.SCAN, TopicKind.ODOMETRY, TopicKind.IMU)
    )
    one = {'/scan': scan, '/odom': odometry, '/imu/data': imu}
    found, _ = vehicle_topics(one)
    assert {topic.kind: topic.name for topic in found}[TopicKind.IMU] == '/imu/data'
    found, warnings = vehicle_topics({**one, '/camera/imu': imu})
    assert TopicKind.IMU not in {topic.kind for topic in found}
    assert any('several IMUs' in text and '--topic robot1.imu=' in text for text in warnings)


@pytest.mark.data
def test_the_turtlebot_drives_the_same_path_without_its_odometry(recordings):
    folder = recordings('bags/turtlebot_lidar_turned')
    with_wheels, without = (
        replay_bag(folder, options={'particles': 50, 'odometry': odometry}).vehicles[0].estimated
        for odometry in ('wheels', 'scan')
    )
    known = without.stamps >= with_wheels.stamps[0]
    columns = with_wheels.poses[:, :2].T
    at = np.stack([np.interp(without.stamps, with_wheels.stamps, c) for c in columns], axis=1)
    apart = np.hypot(*(without.poses[:, :2] - at)[known].T)
    assert known.sum() > 150
    assert np.sqrt(np.mean(apart**2)) < 0.08
    assert apart.max() < 0.12
