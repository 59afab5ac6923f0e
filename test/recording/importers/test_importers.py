"""Public data sets as bags: against made-up ones with known content, and the recordings."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from explore_slam import messages
from explore_slam.agent.config import AgentConfig
from explore_slam.cli.main import main
from explore_slam.errors import RecordingError
from explore_slam.recording import BagReader, Replay, TopicKind
from explore_slam.recording.importers import intel, mrclam, tum
from explore_slam.recording.tum_sequence import ASSOCIATIONS, TRUTH
from explore_slam.settings import values_of, with_values
from explore_slam.slam import FastSlamConfig


def events(path: Path) -> list:
    with BagReader(path) as bag:
        return list(Replay(bag).events())


def of_kind(found: list, kind: TopicKind, vehicle: str = 'robot1') -> list:
    return [event for event in found if event.kind is kind and event.vehicle == vehicle]


# -- MR.CLAM ------------------------------------------------------------------------------------


@pytest.fixture
def small_mrclam(tmp_path) -> Path:
    """Five robots on circles of 1 m; robot 1 sees landmark 6 (code 63), robot 2, and a code 99."""
    folder = tmp_path / 'set'
    folder.mkdir(exist_ok=True)
    (folder / 'Barcodes.dat').write_text(
        '# Subject Barcode\n' + ''.join(f'{s} {60 + s}\n' for s in range(1, 21))
    )
    for number in range(1, 6):
        begin = 100.0 + 0.1 * number
        stamps = np.arange(begin, 110.0, 0.02)
        odometry = np.column_stack([stamps, np.full((len(stamps), 2), 0.5)])
        np.savetxt(folder / f'Robot{number}_Odometry.dat', odometry, fmt='%.3f')
        times = np.arange(99.0, 111.0, 0.01)
        angle = 0.5 * (times - 99.0) + number
        truth = np.column_stack(
            [times, np.sin(angle), -np.cos(angle), np.mod(angle + np.pi, 2 * np.pi) - np.pi]
        )
        np.savetxt(folder / f'Robot{number}_Groundtruth.dat', truth, fmt='%.8f')
        rows = [[99.5, 66, 1.0, 0.0], [102.0, 66, 2.0, 0.5], [102.0, 67, 4.0, -0.1]]
        rows += [[103.0, 62, 1.5, 0.2], [104.0, 99, 1.0, 0.0]]
        np.savetxt(folder / f'Robot{number}_Measurement.dat', np.array(rows), fmt='%.3f')
    return folder


def test_mrclam_becomes_odometry_landmarks_inter_robot_observations_and_truth(
    small_mrclam, tmp_path, caplog
):
    counts = mrclam.import_mrclam(small_mrclam, tmp_path / 'bag')
    assert 'unknown bar codes [99]' in caplog.text
    found = events(tmp_path / 'bag')
    assert sum(counts.values()) == len(found)

    with BagReader(tmp_path / 'bag') as bag:
        starts = Replay(bag).start_poses()
    angle = 0.5 * 1.5 + 1.0  # all robots have odometry from 100.5 s on
    assert starts['robot1'] == pytest.approx((np.sin(angle), -np.cos(angle), angle), abs=1e-6)

    odometry = of_kind(found, TopicKind.ODOMETRY)
    assert odometry[0].stamp == pytest.approx(100.5)
    assert odometry[0].record.pose == pytest.approx((0, 0, 0))
    assert odometry[-1].stamp == pytest.approx(109.98)
    final = starts['robot1'].compose(odometry[-1].record.pose)
    end = 0.5 * 10.98 + 1.0
    assert final[:2] == pytest.approx((np.sin(end), -np.cos(end)), abs=1e-6)

    seen = of_kind(found, TopicKind.LANDMARKS)
    assert [round(event.stamp, 3) for event in seen] == [102.0]
    record = seen[0].record
    distance = 0.973 * 2.0 / np.cos(0.5) - 0.04  # the logged range is the depth
    assert record.positions[0] == pytest.approx(
        (distance * np.cos(0.5), distance * np.sin(0.5), 0.0), abs=1e-6
    )
    assert np.linalg.norm(record.descriptors, axis=1) == pytest.approx([1.0, 1.0], abs=1e-6)
    assert record.descriptors[0] == pytest.approx(mrclam.landmark_descriptor(6), abs=1e-7)

    measured = of_kind(found, TopicKind.INTER_ROBOT)
    assert [event.record.vehicle for event in measured] == ['robot2']
    assert of_kind(found, TopicKind.INTER_ROBOT, 'robot2') == []  # nobody observes itself
    truth = of_kind(found, TopicKind.GROUND_TRUTH)
    assert truth[0].record.pose == pytest.approx(starts['robot1'], abs=1e-6)


STARTS = [f'robot{number}={number},0.5,{10 * number}deg' for number in range(1, 6)]


def test_mrclam_without_truth_takes_start_poses_and_keeps_its_times(small_mrclam, tmp_path):
    for number in (1, 2, 3, 4, 5):
        (small_mrclam / f'Robot{number}_Groundtruth.dat').unlink()
    with pytest.raises(RecordingError, match=r'Robot4_Groundtruth\.dat, Robot5.* --start robot4='):
        mrclam.import_mrclam(small_mrclam, tmp_path / 'bag', STARTS[:3])
    with pytest.raises(RecordingError, match='robot9'):
        mrclam.import_mrclam(small_mrclam, tmp_path / 'bag', [*STARTS, 'robot9=0,0,0'])
    counts = mrclam.import_mrclam(small_mrclam, tmp_path / 'bag', STARTS)
    assert not any('ground_truth' in topic for topic in counts)
    with BagReader(tmp_path / 'bag') as bag:
        replay = Replay(bag)
        starts = replay.start_poses()
        first = next(replay.events())
    assert starts['robot3'] == pytest.approx((3.0, 0.5, np.pi / 6))
    assert first.stamp == pytest.approx(100.5)


@pytest.mark.parametrize('shift', [-100.5, 1.2e9])
def test_mrclam_keeps_times_from_zero_and_from_1970(small_mrclam, tmp_path, shift):
    for path in small_mrclam.glob('Robot*.dat'):
        table = np.loadtxt(path, ndmin=2)
        table[:, 0] += shift
        np.savetxt(path, table, fmt='%.6f')
    mrclam.import_mrclam(small_mrclam, tmp_path / 'bag')
    stamps = [event.stamp for event in of_kind(events(tmp_path / 'bag'), TopicKind.ODOMETRY)]
    assert stamps[0] == pytest.approx(100.5 + shift, abs=1e-5)
    assert stamps[-1] == pytest.approx(109.98 + shift, abs=1e-5)


def test_the_noise_of_a_measurement_lies_along_and_across_the_line_of_sight():
    position, covariance = mrclam.planar_measurement(4.0, np.pi / 2)
    assert position == pytest.approx((0.0, 4.0))
    assert np.sqrt(np.diag(covariance)) == pytest.approx((4.0 * 0.0125, 0.02 + 0.015 * 4.0))
    assert covariance[0, 1] == pytest.approx(0.0, abs=1e-12)


def test_a_depth_becomes_a_distance_that_is_never_negative():
    found = mrclam.distances(np.array([1.0, 4.0, 0.01]), np.array([0.0, -0.5, 0.3]))
    assert found == pytest.approx([0.933, 0.973 * 4.0 / np.cos(0.5) - 0.04, 0.05])


def turning_robot(delay, count=200, seed=0):
    """Odometry of a robot that turns to and fro, and bearings of a landmark 5 m away.

    It follows the odometry after a delay (s).
    """
    stamps = np.arange(0.0, 40.0, 0.05)
    odometry = np.column_stack([stamps, 0.1 * np.ones_like(stamps), np.sin(1.3 * stamps)])
    times = np.linspace(2.0, 38.0, count)
    heading = (1.0 - np.cos(1.3 * (times - delay))) / 1.3
    noise = np.random.default_rng(seed).normal(0.0, 0.005, count)
    bearings = 0.3 - heading + noise
    rows = np.column_stack([times, np.full(count, 6.0), np.full(count, 5.0), bearings])
    return odometry, rows


@pytest.mark.parametrize('delay', [0.0, 0.1, 0.24])
def test_the_delay_of_the_odometry_is_found_from_bearings(delay):
    robots = [turning_robot(delay, seed=seed) for seed in range(3)]
    assert mrclam.odometry_delay(robots) == pytest.approx(delay, abs=0.04)


@pytest.mark.parametrize(('gap', 'found'), [(0.95, 0.2), (1.05, 0.0)])
def test_only_bearings_within_a_second_of_each_other_are_compared(gap, found):
    robots = [turning_robot(0.2, count=1 + int(36.0 / gap), seed=seed) for seed in range(3)]
    assert min(np.diff(rows[:, 0]).min() for _, rows in robots) == pytest.approx(gap, abs=0.04)
    assert mrclam.odometry_delay(robots) == pytest.approx(found, abs=0.04)


def test_without_bearings_of_landmarks_there_is_no_delay():
    odometry, rows = turning_robot(0.3, count=20)
    assert mrclam.odometry_delay([(odometry, rows)]) == 0.0  # too few
    odometry, rows = turning_robot(0.3)
    rows[:, 1] = 3.0  # all of them of a robot, which moves
    assert mrclam.odometry_delay([(odometry, rows)]) == 0.0


def test_no_landmarks_are_no_observations():
    found = mrclam.observe(1.0, np.empty(0), np.empty((0, 2)))
    assert len(found) == 0
    assert found.descriptors.shape == (0, 128)


def test_descriptors_are_unit_vectors_far_apart_and_always_the_same():
    vectors = np.stack([mrclam.landmark_descriptor(subject) for subject in range(6, 21)])
    squared = 2.0 - 2.0 * vectors @ vectors.T
    assert squared[~np.eye(15, dtype=bool)].min() > 1.2
    again = np.stack([mrclam.landmark_descriptor(subject) for subject in range(6, 21)])
    np.testing.assert_array_equal(vectors, again)


def test_velocities_are_held_and_integrated_along_arcs():
    table = np.array([[0.0, 1.0, 0.0], [1.0, 0.5 * np.pi, 0.5 * np.pi], [2.0, 0.0, 0.0]])
    stamps, poses = mrclam.integrate_velocities(table, 0.5, 3.0)
    assert stamps.tolist() == [0.5, 1.0, 2.0, 3.0]
    assert poses[1] == pytest.approx((0.5, 0.0, 0.0))
    assert poses[2] == pytest.approx((1.5, 1.0, 0.5 * np.pi))
    assert poses[3] == pytest.approx(poses[2])


def test_two_imports_are_the_same_bag(small_mrclam, tmp_path):
    for name in ('a', 'b'):
        mrclam.import_mrclam(small_mrclam, tmp_path / name / 'bag')
    first, second = ((tmp_path / n / 'bag' / 'bag.mcap').read_bytes() for n in ('a', 'b'))
    assert first == second


def first_minute(folder: Path, out: Path) -> Path:
    """Copy an MR.CLAM data set up to a minute after the robots' odometry begins."""
    out.mkdir()
    begin = max(
        np.loadtxt(folder / f'Robot{number}_Odometry.dat', usecols=0, max_rows=1)
        for number in range(1, 6)
    )
    for path in folder.glob('*.dat'):
        lines = path.read_text().splitlines(keepends=True)
        if path.name.startswith('Robot'):
            lines = [
                line for line in lines if line[0] == '#' or float(line.split()[0]) < begin + 60.0
            ]
        (out / path.name).write_text(''.join(lines))
    return out


@pytest.mark.data
def test_the_recording_mrclam6(recordings, tmp_path):
    folder = first_minute(recordings('mrclam6'), tmp_path / 'set')
    counts = mrclam.import_mrclam(folder, tmp_path / 'bag')
    assert {topic.split('/')[1] for topic in counts} == {f'robot{n}' for n in range(1, 6)}
    with BagReader(tmp_path / 'bag') as bag:
        assert (bag.end - bag.start) * 1e-9 == pytest.approx(60.0, abs=1.0)
        assert Replay(bag).start_poses()['robot5'].is_finite()


# -- Intel --------------------------------------------------------------------------------------


@pytest.fixture
def small_intel(tmp_path) -> Path:
    folder = tmp_path / 'set'
    folder.mkdir(exist_ok=True)
    ranges = np.full((6, 180), 2.0, np.float32)
    valid = np.ones((6, 180), np.uint8)
    ranges[2, 5], valid[2, 6] = 81.8, 0
    increments = np.tile([0.5, 0.0, 0.1], (6, 1))
    increments[0] = 0.0
    np.savez(folder / intel.LOG, ranges=ranges, valid=valid, odom_inc=increments)
    (folder / intel.REFERENCE).write_text('# step x y theta\n2 10 10 1.0\n4 11 10 1.0\n')
    return folder


def test_intel_becomes_scans_odometry_and_truth(small_intel, tmp_path):
    counts = intel.import_intel(small_intel, tmp_path / 'bag')
    assert counts == {
        '/robot1/initialpose': 1,
        '/robot1/odom': 6,
        '/robot1/scan': 6,
        '/robot1/ground_truth': 2,
    }
    found = events(tmp_path / 'bag')
    odometry = of_kind(found, TopicKind.ODOMETRY)
    stamps = np.array([event.stamp for event in odometry])
    assert np.diff(stamps) == pytest.approx([0.1, 1.0, 1.0, 1.0, 1.0])
    assert odometry[2].record.pose == pytest.approx((0.5, 0.0, 0.1))
    scan = of_kind(found, TopicKind.SCAN)[2].record
    assert np.degrees(scan.angles[[0, -1]]) == pytest.approx([-90.0, 89.0], abs=1e-4)
    assert np.isposinf(scan.ranges[5])
    assert np.isnan(scan.ranges[6])
    assert scan.ranges[7] == 2.0
    truth = of_kind(found, TopicKind.GROUND_TRUTH)
    assert truth[0].record.pose == pytest.approx(odometry[2].record.pose)
    moved = truth[0].record.pose.between(truth[1].record.pose)
    assert moved == pytest.approx((np.cos(1.0), -np.sin(1.0), 0.0))


def test_intel_without_a_reference_has_no_truth(small_intel, tmp_path, caplog):
    (small_intel / intel.REFERENCE).unlink()
    assert '/robot1/ground_truth' not in intel.import_intel(small_intel, tmp_path / 'bag')
    assert intel.REFERENCE in caplog.text


@pytest.mark.data
def test_the_recording_intel(recordings, tmp_path):
    counts = intel.import_intel(recordings('intel_lab'), tmp_path / 'bag')
    assert counts['/robot1/scan'] == 2726
    found = events(tmp_path / 'bag')
    path = np.array([e.record.pose for e in of_kind(found, TopicKind.ODOMETRY)])
    assert np.hypot(*np.diff(path[:, :2], axis=0).T).sum() == pytest.approx(506, abs=1)
    stamps = [event.stamp for event in of_kind(found, TopicKind.SCAN)]
    assert (np.diff(stamps) > 0).all()


# -- TUM ----------------------------------------------------------------------------------------


@pytest.fixture
def small_tum(tmp_path) -> Path:
    folder = tmp_path / 'set'
    for name in ('rgb', 'depth'):
        (folder / name).mkdir(parents=True, exist_ok=True)
    color = np.zeros((48, 64, 3), np.uint8)
    color[:, :] = (200, 100, 50)  # RGB
    depth = np.full((48, 64), 5000, np.uint16)
    depth[0, 0] = 0
    lines = []
    for stamp in ('1.000000', '1.100000'):
        cv2.imwrite(str(folder / 'rgb' / f'{stamp}.png'), color[:, :, ::-1])
        cv2.imwrite(str(folder / 'depth' / f'{stamp}.png'), depth)
        lines.append(f'{stamp} rgb/{stamp}.png {stamp} depth/{stamp}.png\n')
    (folder / ASSOCIATIONS).write_text(''.join(lines))
    # an optical frame that looks along the map's y axis, level: body heading is pi / 2
    quaternion = '-0.70710678 0 0 0.70710678'
    (folder / TRUTH).write_text(
        '# t x y z q\n' + ''.join(f'{t} 1 2 3 {quaternion}\n' for t in (0.95, 1.05, 1.15, 9.0))
    )
    return folder


def test_tum_becomes_frames_and_truth(small_tum, tmp_path):
    tum.import_tum(small_tum, tmp_path / 'bag')
    found = events(tmp_path / 'bag')
    frames = of_kind(found, TopicKind.COLOR)
    assert [event.stamp for event in frames] == pytest.approx([1.0, 1.1])
    frame = frames[0].record
    assert frame.rgb[5, 5].tolist() == [200, 100, 50]
    assert frame.depth[0].tolist()[:2] == [0, 1000]
    assert (frame.intrinsics.fx, frame.intrinsics.cy) == (517.3, 255.3)
    assert frame.intrinsics.distortion == (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)
    truth = of_kind(found, TopicKind.GROUND_TRUTH)
    assert len(truth) == 3
    assert truth[0].record.pose == pytest.approx((1.0, 2.0, np.pi / 2), abs=1e-6)


def test_tum_as_downloaded_is_associated_by_its_stamps(small_tum, tmp_path, capsys):
    (small_tum / ASSOCIATIONS).unlink()
    for name in ('rgb', 'depth'):
        lines = [f'{stamp} {name}/{stamp}.png\n' for stamp in ('1.000000', '1.100000')]
        (small_tum / f'{name}.txt').write_text('# ' + name + '\n' + ''.join(lines))
    arguments = ['import', 'tum', str(small_tum), str(tmp_path / 'bag'), '--camera', 'freiburg3']
    assert main([*arguments, '--truth-offset', '0.03']) == 0
    assert '2  /robot1/camera/rgb/image_raw' in capsys.readouterr().out
    found = events(tmp_path / 'bag')
    assert of_kind(found, TopicKind.COLOR)[0].record.intrinsics.fx == 535.4
    truth = of_kind(found, TopicKind.GROUND_TRUTH)
    assert truth[0].stamp == pytest.approx(0.92)


def test_tum_truth_is_kept_in_space(small_tum, tmp_path):
    tum.import_tum(small_tum, tmp_path / 'bag')
    with BagReader(tmp_path / 'bag') as bag:
        raw = next(bag.messages(['/robot1/ground_truth']))
        pose = bag.decode(raw).pose.pose
    assert pose.position.z == 3.0
    assert messages.planar_pose(pose).theta == pytest.approx(np.pi / 2, abs=1e-6)


@pytest.mark.data
def test_the_recording_tum(recordings, tmp_path):
    counts = tum.import_tum(recordings('tum_fr1_rpy'), tmp_path / 'bag')
    assert counts['/robot1/camera/rgb/image_raw'] == 80
    found = events(tmp_path / 'bag')
    depths = [e.record.depth for e in of_kind(found, TopicKind.COLOR)]
    assert 500 < np.median([np.median(d[d > 0]) for d in depths]) < 3000


# -- all ----------------------------------------------------------------------------------------


@pytest.mark.parametrize('module', [mrclam, intel, tum])
def test_settings_of_the_recordings_belong_to_the_sensors(module):
    """Mount, range and noise of the sensors; how the filter works is the same for all data."""
    config = AgentConfig()
    sensor = {
        *values_of(config.laser_mount),
        *values_of(config.vision.mount),
        *values_of(config.slam.odometry_noise),
        *values_of(config.slam.correlation),
        'max_laser_range',
        'no_return_range',
        'camera_readout_time',
    }
    assert set(module.SETTINGS) <= sensor
    tree = with_values(AgentConfig(), module.SETTINGS)
    values = values_of(tree)
    assert all(values[name] == value for name, value in module.SETTINGS.items())


def test_benchmarks_without_camera_take_the_noise_of_the_robots():
    tree = with_values(FastSlamConfig(), mrclam.FILTER_SETTINGS)
    assert set(mrclam.SETTINGS) - set(values_of(tree)) == {'camera_readout_time'}


@pytest.mark.parametrize('importer', [mrclam.import_mrclam, intel.import_intel, tum.import_tum])
def test_a_folder_that_is_no_data_set_is_named(importer, tmp_path):
    with pytest.raises(RecordingError, match='absent is not a folder'):
        importer(tmp_path / 'absent', tmp_path / 'bag')
    with pytest.raises(RecordingError, match='is missing'):
        importer(tmp_path, tmp_path / 'bag')
    assert not (tmp_path / 'bag').exists()


def test_damaged_files_are_named_and_nothing_is_left_behind(
    small_mrclam, small_intel, small_tum, tmp_path
):
    out = tmp_path / 'bag'
    # all three fixtures share the folder
    (small_mrclam / 'Robot3_Odometry.dat').write_text('1 2 three\n')
    with pytest.raises(RecordingError, match=r'Robot3_Odometry\.dat is not a table'):
        mrclam.import_mrclam(small_mrclam, out)
    (small_mrclam / 'Robot3_Odometry.dat').write_text('1 2\n')
    with pytest.raises(RecordingError, match=r'1 rows of 2 numbers, expected .* of 3'):
        mrclam.import_mrclam(small_mrclam, out)
    (small_intel / intel.LOG).write_bytes(b'PK no archive')
    with pytest.raises(RecordingError, match='is not the log'):
        intel.import_intel(small_intel, out)
    (small_tum / 'depth' / '1.100000.png').write_bytes(b'no image')
    with pytest.raises(RecordingError, match=r'1\.100000\.png cannot be read'):
        tum.import_tum(small_tum, out)
    (small_tum / ASSOCIATIONS).write_text('1.0 one.png\n')
    with pytest.raises(RecordingError, match='line 1'):
        tum.import_tum(small_tum, out)
    assert not out.exists()
    assert not list(tmp_path.glob('.bag*'))


def test_an_existing_bag_is_not_overwritten(small_intel, tmp_path):
    intel.import_intel(small_intel, tmp_path / 'bag')
    with pytest.raises(RecordingError, match='exists already'):
        intel.import_intel(small_intel, tmp_path / 'bag')
