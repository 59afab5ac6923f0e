"""Recordings through the real agent: the same result every time, and bad recordings named."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from synthetic import SyntheticWorld

from explore_slam import messages
from explore_slam.agent.agent import Agent
from explore_slam.data import (
    Intrinsics,
    LandmarkObservations,
    LaserScan,
    OdometryReading,
    RgbdFrame,
)
from explore_slam.errors import ConfigError, RecordingError
from explore_slam.geometry import Pose2
from explore_slam.mounts import LaserMountConfig
from explore_slam.recording import BagReader, BagWriter, Event, Replay, TopicKind
from explore_slam.recording.events import odometry_event, start_event, truth_event, write_event
from explore_slam.recording.importers.importing import write_settings
from explore_slam.recording.rosbags_types import MESSAGES, serialize
from explore_slam.results.replay_run import configuration, recorded_starts, replay_bag

STARTS = {'robot1': Pose2(0.0, 0.0, 0.0), 'robot2': Pose2(0.0, -2.0, 0.3)}
LANDMARKS = np.random.default_rng(5).uniform([-3, -5, 0], [6, 5, 1], (40, 3))
DESCRIPTORS = np.random.default_rng(6).normal(size=(40, 128)).astype(np.float32)
DESCRIPTORS /= np.linalg.norm(DESCRIPTORS, axis=1, keepdims=True)


def observe(stamp: float, pose: Pose2, rng: np.random.Generator) -> LandmarkObservations:
    c, s = np.cos(pose.theta), np.sin(pose.theta)
    apart = LANDMARKS - [pose.x, pose.y, 0.0]
    local = np.column_stack([c * apart[:, 0] + s * apart[:, 1],
                             c * apart[:, 1] - s * apart[:, 0], apart[:, 2]])  # fmt: skip
    seen = (local[:, 0] > 0.5) & (np.hypot(local[:, 0], local[:, 1]) < 4.0)
    noise = rng.normal(0.0, 0.02, (int(seen.sum()), 3))
    covariances = np.repeat(4e-4 * np.eye(3)[None], len(noise), axis=0)
    return LandmarkObservations(stamp, local[seen] + noise, covariances, DESCRIPTORS[seen])


def team_events(seconds: float = 12.0) -> list[Event]:
    """Two vehicles on circles; odometry that drifts, landmarks, scans, truth, start poses."""
    rng = np.random.default_rng(7)
    found = [start_event(name, 5.0, pose) for name, pose in STARTS.items()]
    room, laser = SyntheticWorld(), LaserMountConfig().pose
    for name, start in STARTS.items():
        true, odometry = start, Pose2(9.0, 9.0, 1.0)
        for index in range(round(20 * seconds)):
            stamp = 5.0 + 0.05 * index
            found.append(odometry_event(name, stamp, odometry))
            found.append(truth_event(name, stamp, true))
            if index % 10 == 5:
                seen = observe(stamp, true, rng)
                found.append(Event(stamp, name, TopicKind.LANDMARKS, seen))
                scan = room.scan_from(stamp, true.compose(laser))
                found.append(Event(stamp, name, TopicKind.SCAN, scan))
            true = true.compose(Pose2(0.02, 0.0, 0.015))
            odometry = odometry.compose(Pose2(0.021, 0.0, 0.017))
    return sorted(found, key=lambda event: event.stamp)


def write(path: Path, events: list[Event]) -> Path:
    with BagWriter(path) as writer:
        for event in events:
            write_event(writer, event)
    return path


@pytest.fixture(scope='module')
def team_bag(tmp_path_factory) -> Path:
    return write(tmp_path_factory.mktemp('team') / 'bag', team_events())


# the command in a process of its own, so that --threads comes before the numeric libraries
RUN_REPLAY = """
import argparse, sys
from explore_slam.cli import replay
parser = argparse.ArgumentParser()
replay.configure(parser)
sys.exit(replay.run(parser.parse_args()))
"""


def plain(value):
    """Metrics without what the clock says."""
    return {name: item for name, item in value.items() if name != 'timing'}


def test_the_agent_corrects_the_odometry_of_a_recording(team_bag):
    data = replay_bag(team_bag, options={'particles': 100})
    assert data.metrics['mean_odometry_position_rms'] > 0.3
    assert data.metrics['mean_online_position_rms'] < 0.1
    assert data.metrics['landmarks'] <= 44
    assert data.metrics['coverage'] > 5.0
    assert data.grid is not None
    assert data.notes == ()
    assert data.metrics['records']['robot1/odom'] == 240
    assert data.metrics['refused'] == {}


def test_twice_it_is_the_same_bit_for_bit_and_another_seed_is_not(team_bag):
    first, second = (replay_bag(team_bag, options={'particles': 50}) for _ in range(2))
    assert plain(first.metrics) == plain(second.metrics)
    for a, b in zip(first.vehicles, second.vehicles, strict=True):
        for kind, path in a.trajectories().items():
            np.testing.assert_array_equal(path.poses, b.trajectories()[kind].poses)
    np.testing.assert_array_equal(first.grid.probability(), second.grid.probability())
    np.testing.assert_array_equal(first.landmarks.means, second.landmarks.means)
    other = replay_bag(team_bag, options={'particles': 50}, seed=1)
    assert plain(other.metrics) != plain(first.metrics)


def test_with_one_and_with_two_threads_the_files_are_the_same(team_bag, tmp_path):
    contents = []
    for threads in (1, 2):
        out = tmp_path / str(threads)
        command = [sys.executable, '-c', RUN_REPLAY, str(team_bag)]
        command += ['--particles', '50', '--threads', str(threads), '--out', str(out)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == 0, done.stderr
        assert 'robot2' in done.stdout
        folder = out / 'latest'
        names = ['map.pgm', 'map.yaml', 'landmarks.ply', 'robot1_estimated.tum']
        names += ['robot2_online.tum', 'settings.yaml']
        contents.append({name: (folder / name).read_bytes() for name in names})
    assert contents[0] == contents[1]


def test_live_order_does_not_matter_as_long_as_it_is_nearly_right(team_bag, tmp_path):
    rng = np.random.default_rng(3)
    events = team_events()
    with BagWriter(tmp_path / 'bag') as writer:
        late = sorted(events, key=lambda event: event.stamp + rng.uniform(0.0, 0.4))
        for index, event in enumerate(late):
            _write_at(writer, event, 100.0 + 0.002 * index)
    first = replay_bag(team_bag, options={'particles': 50})
    second = replay_bag(tmp_path / 'bag', options={'particles': 50})
    assert first.metrics['records'] == second.metrics['records']
    assert first.metrics['mean_online_position_rms'] == pytest.approx(
        second.metrics['mean_online_position_rms'], abs=0.03
    )


def test_a_frame_waits_for_the_scan_of_its_moment_that_comes_after_it(tmp_path):
    def rank(event: Event) -> tuple[float, bool]:
        return event.stamp, event.kind is TopicKind.SCAN

    frames_first = write(tmp_path / 'frames', sorted(team_events(), key=rank))
    without = [event for event in team_events() if event.kind is not TopicKind.SCAN]
    no_scans = write(tmp_path / 'without', without)
    error, alone = (
        replay_bag(bag, options={'particles': 50}).metrics['mean_online_position_rms']
        for bag in (frames_first, no_scans)
    )
    assert error < 0.75 * alone  # were the frames processed at once, the scans would be of no use


def _write_at(writer: BagWriter, event: Event, log_time: float) -> None:
    class Shifted:
        def write_message(self, topic: str, name: str, _stamp: float, message) -> None:
            writer.write_message(topic, name, log_time, message)

    write_event(Shifted(), event)


def feed(path: Path, values: dict | None = None, **options) -> tuple[Replay, Agent]:
    bag = BagReader(path)
    replay = Replay(bag, **options)
    settings = configuration(path, None, {'particles': 10, **(values or {})})
    agent = Agent(settings, replay.start_poses())
    replay.feed(agent)
    bag.close()
    return replay, agent


def test_start_poses_come_from_options_then_initialpose_then_truth(tmp_path):
    events = team_events(1.0)
    bag = write(tmp_path / 'all', events)
    found = Replay(BagReader(bag)).start_poses()
    assert list(found) == ['robot1', 'robot2']
    assert found['robot1'] == pytest.approx(STARTS['robot1'])
    assert found['robot2'] == pytest.approx(STARTS['robot2'])
    given = Replay(BagReader(bag), starts={'robot1': Pose2(7, 8, 0.5)}).start_poses()
    assert given['robot1'] == (7, 8, 0.5)
    assert given['robot2'] == pytest.approx(STARTS['robot2'])
    bag = write(tmp_path / 'truth', [e for e in events if e.kind is not TopicKind.INITIAL_POSE])
    replay = Replay(BagReader(bag))
    assert replay.start_poses()['robot2'] == pytest.approx(STARTS['robot2'])
    assert 'start pose of robot1 is taken from its ground truth' in replay.warnings
    kinds = (TopicKind.INITIAL_POSE, TopicKind.GROUND_TRUTH)
    bag = write(tmp_path / 'none', [e for e in events if e.kind not in kinds])
    with pytest.raises(RecordingError, match=r"no start pose of \['robot1', 'robot2'\]"):
        Replay(BagReader(bag)).start_poses()
    replay = Replay(BagReader(bag), ['robot1'])
    assert replay.start_poses() == {'robot1': (0.0, 0.0, 0.0)}
    with pytest.raises(RecordingError, match='robot9'):
        Replay(BagReader(bag), starts={'robot9': Pose2(0, 0, 0)})


def test_a_start_that_is_given_as_unknown_is_not_taken_from_the_bag(team_bag, tmp_path):
    apart = {'relocalization': False}  # no join by landmarks
    replay = Replay(BagReader(team_bag), starts={'robot2': None})
    assert replay.start_poses()['robot2'] is None
    _, agent = feed(team_bag, apart, starts={'robot2': None})
    assert agent.is_in_map('robot1')
    assert not agent.is_in_map('robot2')
    # a pose that an operator sets later is used
    events = team_events(4.0)
    stamp = events[-1].stamp - 1.0
    reading = OdometryReading(stamp, Pose2(0.5, -2.0, 0.3), 1e-4 * np.eye(3))
    later = Event(stamp, 'robot2', TopicKind.INITIAL_POSE, reading)
    bag = write(tmp_path / 'set', sorted([*events, later], key=lambda event: event.stamp))
    _, agent = feed(bag, apart, starts={'robot2': None})
    assert agent.is_in_map('robot2')


def test_a_vehicle_that_was_not_found_is_left_out_of_the_results(team_bag):
    data = replay_bag(
        team_bag,
        starts={'robot2': None},
        options={'particles': 10, 'relocalization': False},
        until=3.0,
    )
    by_name = {vehicle.name: vehicle for vehicle in data.vehicles}
    assert len(by_name['robot1'].estimated) > 5
    assert len(by_name['robot2'].estimated) == len(by_name['robot2'].online) == 0
    assert any('robot2 was not found in the map' in note for note in data.notes)


def test_unknown_starts_are_recorded_as_nan(team_bag):
    values = {
        'vehicles': ['robot1', 'robot2'],
        'start_poses': [1.0, 2.0, 0.5, *[float('nan')] * 3],
    }
    write_settings(team_bag, values)
    assert recorded_starts(team_bag) == {'robot1': Pose2(1.0, 2.0, 0.5), 'robot2': None}


def test_an_unknown_vehicle_is_named_and_the_others_go_on(team_bag):
    replay, agent = feed(team_bag, vehicles=['robot2'])
    assert agent.vehicles == ['robot2']
    assert replay.tally.fed['robot2/odom'] == 240
    assert replay.warnings == ["unknown vehicles ['robot1'] in the recording: unused"]


def test_a_truncated_bag_is_replayed_up_to_the_cut(team_bag, tmp_path):
    data = (team_bag / 'bag.mcap').read_bytes()
    (tmp_path / 'cut.mcap').write_bytes(data[: len(data) // 2])
    run = replay_bag(tmp_path / 'cut.mcap', options={'particles': 20})
    assert 60 < run.metrics['records']['robot1/odom'] < 240
    assert any('cut.mcap is truncated' in note for note in run.notes)


def test_a_bag_without_odometry_or_sensors_is_refused_by_name(tmp_path):
    only = [e for e in team_events(1.0) if e.kind is TopicKind.LANDMARKS]
    assert only
    with pytest.raises(RecordingError, match=r'neither odometry \(<vehicle>/odom\) nor scans'):
        replay_bag(write(tmp_path / 'landmarks', only))
    truth = [e for e in team_events(1.0) if e.kind is TopicKind.GROUND_TRUTH]
    with pytest.raises(RecordingError, match='no topic of a vehicle'):
        replay_bag(write(tmp_path / 'truth', truth))


def damaged(make: Callable[[float], tuple[str, str, object]]) -> list[tuple[float, object]]:
    return [(6.0 + 0.5 * index, make(6.0 + 0.5 * index)) for index in range(3)]


def scan_message(stamp: float, **changes):
    scan = LaserScan(stamp, -1.5, 0.01, np.full(10, 2.0, np.float32), 0.1, 8.0)
    message = messages.scan_message(MESSAGES, scan, 'laser')
    for name, value in changes.items():
        setattr(message, name, value)
    return message


@pytest.mark.parametrize(
    ('changes', 'words'),
    [
        ({'ranges': np.empty(0, np.float32)}, 'at least one beam'),
        ({'angle_increment': float('nan')}, 'angle_increment'),
        ({'range_max': 0.0}, 'range_max 0.0'),
    ],
)
def test_malformed_scans_are_counted_and_named_and_the_rest_is_used(tmp_path, changes, words):
    with BagWriter(tmp_path / 'bag') as writer:
        for event in team_events(3.0):
            write_event(writer, event)
        for stamp in (6.0, 6.5, 7.0):
            writer.write_message(
                '/robot1/scan', 'sensor_msgs/LaserScan', stamp, scan_message(stamp, **changes)
            )
    replay, agent = feed(tmp_path / 'bag')
    assert replay.tally.refused == {'/robot1/scan': 3}
    assert words in replay.tally.first_refusals['/robot1/scan']
    assert any('3 messages on /robot1/scan refused' in note for note in replay.warnings)
    assert agent.grid.known().any()


def test_data_cut_short_are_counted_and_named(tmp_path):
    with BagWriter(tmp_path / 'bag') as writer:
        for event in team_events(3.0):
            write_event(writer, event)
        whole = serialize('sensor_msgs/LaserScan', scan_message(6.0))
        writer.write('/robot1/scan', 6_000_000_000, whole[:30])
        writer.write('/robot1/scan', 6_100_000_000, whole[:6])
    replay, _ = feed(tmp_path / 'bag')
    assert replay.tally.refused == {'/robot1/scan': 1}
    assert any('1 messages on /robot1/scan are too short' in note for note in replay.warnings)


def test_messages_far_out_of_order_and_clock_jumps_are_named(tmp_path):
    with BagWriter(tmp_path / 'bag') as writer:
        for index, event in enumerate(team_events(8.0)):
            _write_at(writer, event, event.stamp)
            if index == 500:
                _write_at(writer, odometry_event('robot1', event.stamp - 3.5, Pose2(0, 0, 0)),
                          event.stamp)  # fmt: skip
        for event in team_events(1.0)[2:]:
            _write_at(writer, event, event.stamp + 20.0)
    replay, agent = feed(tmp_path / 'bag')
    text = ' | '.join(replay.warnings)
    assert '1 messages on /robot1/odom came more than 2 s out of order' in text
    assert 'the recorded clock jumps back from 12.9' in text
    assert agent.estimate('robot1')[0].is_finite()


def test_the_settings_in_a_bag_count_unless_told_otherwise(team_bag, tmp_path):
    bag = write(tmp_path / 'bag', team_events(1.0))
    write_settings(bag, {'particles': 77, 'nothing_of_the_agent': 1})
    assert configuration(bag).slam.particles == 77
    assert configuration(bag, None, {'particles': 5}).slam.particles == 5
    own = configuration(team_bag, None, {'resolution': 0.1})
    assert configuration(bag, own).slam.particles == own.slam.particles
    with pytest.raises(ConfigError, match='particels'):
        configuration(bag, None, {'particels': 5})
    (bag / 'settings.yaml').write_text('just text')
    with pytest.raises(ConfigError, match=r'settings\.yaml: expected a mapping, found str'):
        configuration(bag)


def test_a_bag_in_a_run_folder_takes_settings_and_starts_from_there(tmp_path):
    kinds = (TopicKind.INITIAL_POSE, TopicKind.GROUND_TRUTH)
    events = [event for event in team_events(1.0) if event.kind not in kinds]
    bag = write(tmp_path / 'run' / 'bag', events)
    poses = [float(value) for pose in STARTS.values() for value in pose]
    write_settings(bag.parent, {'particles': 33, 'vehicles': list(STARTS), 'start_poses': poses})
    assert configuration(bag).slam.particles == 33
    starts = recorded_starts(bag)
    assert starts['robot2'] == pytest.approx(STARTS['robot2'])
    data = replay_bag(bag, vehicles=['robot1'])
    assert data.vehicles[0].odometry.poses[0] == pytest.approx(STARTS['robot1'])
    assert data.notes == ("unknown vehicles ['robot2'] in the recording: unused",)


def test_a_recording_that_begins_after_the_vehicle_had_moved_starts_at_its_truth(tmp_path):
    events = [event for event in team_events(4.0) if event.kind is not TopicKind.INITIAL_POSE]
    late = [event for event in events if event.stamp > 7.0]
    poses = [float(value) for pose in STARTS.values() for value in pose]
    for name, kept in (('whole', events), ('late', late)):
        bag = write(tmp_path / name / 'bag', kept)
        write_settings(bag.parent, {'vehicles': list(STARTS), 'start_poses': poses})
    truth = next(e for e in late if (e.vehicle, e.kind) == ('robot1', TopicKind.GROUND_TRUTH))
    assert truth.record.pose.x - STARTS['robot1'].x > 0.5
    whole, replay = (
        Replay(BagReader(bag), recorded_starts=recorded_starts(bag))
        for bag in (tmp_path / 'whole' / 'bag', tmp_path / 'late' / 'bag')
    )
    assert whole.start_poses()['robot1'] == pytest.approx(STARTS['robot1'])
    assert not any('had moved' in text for text in whole.warnings)
    assert replay.start_poses()['robot1'] == pytest.approx(truth.record.pose)
    assert any('robot1 begins after it had moved' in text for text in replay.warnings)
    given = Replay(BagReader(bag), starts={'robot1': STARTS['robot1']})
    assert given.start_poses()['robot1'] == pytest.approx(STARTS['robot1'])


@pytest.mark.parametrize(
    ('vision', 'used'),
    [('agent', 'camera/rgb/image_raw'), ('vehicle', 'landmarks'), (None, 'landmarks')],
)
def test_what_was_seen_counts_once(tmp_path, vision, used):
    camera = Intrinsics(64, 48, 60.0, 60.0, 32.0, 24.0)
    image, depth = np.zeros((48, 64, 3), np.uint8), np.full((48, 64), 1000, np.uint16)
    events = [event for event in team_events(1.0) if event.vehicle == 'robot1']
    events += [
        Event(stamp, 'robot1', TopicKind.COLOR, RgbdFrame(stamp, image, depth, camera))
        for stamp in (5.2, 5.4)
    ]
    bag = write(tmp_path / 'bag', events)
    replay = Replay(BagReader(bag), vision=vision)
    seen = {e.kind.value for e in replay.events()} & {'landmarks', 'camera/rgb/image_raw'}
    assert seen == {used}
    assert any('landmarks are used' in text for text in replay.warnings) == (vision is None)


def test_it_can_stop_early_and_tells_how_far_it_is(team_bag):
    shares: list[float] = []
    data = replay_bag(team_bag, options={'particles': 10}, until=3.0, progress=shares.append)
    assert 55 <= data.metrics['records']['robot1/odom'] <= 62
    calibration = data.metrics['odometry_calibration']['robot1']
    assert calibration['turn_scale'] == pytest.approx(1.0, abs=0.3)
    assert calibration['turn_scale_deviation'] > 0.0
    assert shares == sorted(shares)
    assert 0.2 < shares[-1] < 0.5
