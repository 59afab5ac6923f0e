"""Import of CARMEN logs as bags that the replay understands."""

import logging

import numpy as np
import pytest
import yaml
from carmen_logs import Drive, errors, laser_line, odometry_line, write_log

from explore_slam.errors import RecordingError
from explore_slam.geometry import Pose2
from explore_slam.messages.topics import TopicKind
from explore_slam.recording import BagReader, Replay
from explore_slam.recording.importers.carmen import import_carmen
from explore_slam.results.replay_run import replay_bag


def events_of(bag_path, kind, vehicle='robot1'):
    with BagReader(bag_path) as bag:
        return [
            event
            for event in Replay(bag).events()
            if event.kind is kind and event.vehicle == vehicle
        ]


def test_a_corrected_log_becomes_odometry_scans_and_reference(tmp_path, caplog):
    drive = Drive()
    with caplog.at_level(logging.WARNING):
        counts = import_carmen(
            [write_log(tmp_path / 'room.log', drive.corrected())], tmp_path / 'bag'
        )
    assert counts['/robot1/scan'] == len(drive.scans) == counts['/robot1/ground_truth']
    assert 'room.log: corrected log' in caplog.text
    truth = events_of(tmp_path / 'bag', TopicKind.GROUND_TRUTH)
    laser = [drive.truth[index].compose(drive.mount) for index in drive.scans]
    assert max(errors([event.record.pose for event in truth], laser)) < 1e-3
    scan_stamps = [event.stamp for event in events_of(tmp_path / 'bag', TopicKind.SCAN)]
    np.testing.assert_allclose([event.stamp for event in truth], scan_stamps)


def test_settings_of_the_bag_belong_to_the_sensor(tmp_path):
    import_carmen([write_log(tmp_path / 'log', Drive().raw())], tmp_path / 'bag')
    content = yaml.safe_load((tmp_path / 'bag' / 'settings.yaml').read_text())
    values = content['/**']['ros__parameters']
    assert set(values) == {
        'laser_x', 'laser_y', 'laser_yaw', 'max_laser_range', 'no_return_range',
    }  # fmt: skip
    assert values['laser_x'] == pytest.approx(0.1, abs=1e-4)


def test_readings_at_the_maximum_are_no_return(tmp_path):
    pose = Pose2(0.0, 0.0, 0.0)
    ranges = [2.0, 79.9, 80.0, 81.91, *[3.0] * 176]
    lines = [odometry_line(pose, 1.0), laser_line(ranges, pose, pose, 1.0)]
    import_carmen([write_log(tmp_path / 'log', lines)], tmp_path / 'bag')
    (event,) = events_of(tmp_path / 'bag', TopicKind.SCAN)
    np.testing.assert_allclose(event.record.ranges[:5], [2.0, 79.9, np.inf, np.inf, 3.0])


def test_several_logs_are_several_vehicles(tmp_path):
    first, second = Drive(steps=60), Drive(steps=80)
    counts = import_carmen(
        [write_log(tmp_path / 'a', first.raw()), write_log(tmp_path / 'b', second.raw())],
        tmp_path / 'bag',
    )
    assert counts['/robot1/scan'] == len(first.scans)
    assert counts['/robot2/scan'] == len(second.scans)


def test_absolute_and_relative_times_start_together(tmp_path):
    absolute = Drive(steps=60)
    absolute.stamps = [976052857.0 + stamp for stamp in absolute.stamps]
    lines = [line.replace('9.76053e+08', 'T') for line in absolute.raw()]
    # six digits do not hold such a time: write it out
    times = iter(
        stamp
        for index, stamp in enumerate(absolute.stamps)
        for _ in range(2 if index in absolute.scans else 1)
    )
    written = [
        line.replace('T', f'{next(times):.6f}') if line.endswith('T') else line for line in lines
    ]
    logs = [write_log(tmp_path / 'a', written), write_log(tmp_path / 'b', Drive().raw())]
    import_carmen(logs, tmp_path / 'bag')
    with BagReader(tmp_path / 'bag') as bag:
        assert (bag.end - bag.start) * 1e-9 < 20.0
    import_carmen(logs[:1], tmp_path / 'alone')
    with BagReader(tmp_path / 'alone') as bag:
        assert bag.start * 1e-9 == pytest.approx(976052867.0)


def test_different_mounts_are_refused(tmp_path):
    logs = [
        write_log(tmp_path / 'a', Drive().raw()),
        write_log(tmp_path / 'b', Drive(mount=Pose2(0.3, 0.0, 0.0)).raw()),
    ]
    with pytest.raises(RecordingError, match='the same mount'):
        import_carmen(logs, tmp_path / 'bag')
    assert not (tmp_path / 'bag').exists()


def test_a_replay_follows_the_reference(tmp_path):
    drive = Drive(steps=200, mount=Pose2(0.0, 0.0, 0.0))
    import_carmen([write_log(tmp_path / 'log', drive.corrected())], tmp_path / 'bag')
    run = replay_bag(tmp_path / 'bag', options={'particles': 50})
    found = run.metrics['vehicles']['robot1']
    assert found['estimated']['position_rms'] < 0.05
    assert run.metrics['refused'] == {}
