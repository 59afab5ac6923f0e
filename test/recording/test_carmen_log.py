"""CARMEN logs: raw and corrected ones, all laser messages, and damaged lines."""

import math

import numpy as np
import pytest
from carmen_logs import Drive, errors, laser_line, odometry_line, write_log

from explore_slam.errors import RecordingError
from explore_slam.geometry import Pose2, between, compose
from explore_slam.recording.carmen_log import read_carmen

DIGITS = 1e-4  # six digits in the log


def test_a_raw_log_is_read_as_it_stands(tmp_path):
    drive = Drive()
    log = read_carmen(write_log(tmp_path / 'raw.log', drive.raw()))
    assert not log.corrected
    assert 'raw log' in log.notes[0]
    assert log.mount == pytest.approx((0.1, 0.0, 0.0), abs=DIGITS)
    assert len(log.scans) == len(drive.scans) == len(log.rows)
    expected = [drive.odometry[index] for index in drive.scans]
    assert max(errors(log.odometry[log.rows], expected)) < DIGITS
    np.testing.assert_allclose(log.scans[3].ranges, drive.scans[20], atol=1e-3)
    np.testing.assert_allclose(
        log.stamps[log.rows], [drive.stamps[i] for i in drive.scans], atol=0.01
    )


@pytest.mark.parametrize('marked', [True, False])
def test_restarts_of_a_corrected_log_are_no_motion(tmp_path, marked):
    drive = Drive()
    log = read_carmen(write_log(tmp_path / 'log', drive.corrected(marked)))
    assert log.corrected
    assert 'corrected log' in log.notes[0]
    at_scans = [drive.odometry[index] for index in drive.scans]
    # the wheel odometry, as if it had never been corrected
    motion = between(np.array(at_scans[0]), np.array(at_scans))
    assert max(errors(between(log.odometry[log.rows[0]], log.odometry[log.rows]), motion)) < 2e-3
    laser = compose(np.array([drive.truth[index] for index in drive.scans]), drive.mount)
    assert max(errors(log.reference, laser)) < DIGITS


def test_a_raw_log_of_a_robot_at_rest_is_not_taken_for_a_corrected_one(tmp_path):
    pose = Pose2(1.0, 2.0, 0.5)
    lines = []
    for index in range(40):
        lines.append(odometry_line(pose, 1.0 + 0.1 * index))
        lines.append(laser_line([1.0] * 180, pose, pose, 1.0 + 0.1 * index))
    assert not read_carmen(write_log(tmp_path / 'log', lines)).corrected


def test_a_raw_log_with_odometry_after_the_scan_is_raw(tmp_path):
    lines = []
    for index in range(40):
        pose = Pose2(0.05 * index, 0.0, 0.0)
        lines.append(laser_line([1.0] * 180, pose, pose, 1.0 + 0.1 * index))
        lines.append(odometry_line(pose, 1.0 + 0.1 * index))
    log = read_carmen(write_log(tmp_path / 'log', lines))
    assert not log.corrected
    assert log.odometry[-1, 0] == pytest.approx(0.05 * 39)


@pytest.mark.parametrize(('beams', 'degrees'), [(180, 1.0), (181, 1.0), (360, 0.5), (361, 0.5)])
def test_beams_of_flaser(tmp_path, beams, degrees):
    pose = Pose2(0.0, 0.0, 0.0)
    lines = [odometry_line(pose, 1.0), laser_line([2.0] * beams, pose, pose, 1.0)]
    (scan,) = read_carmen(write_log(tmp_path / 'log', lines)).scans
    assert scan.fov_start == pytest.approx(math.radians(-90.0))
    assert scan.step == pytest.approx(math.radians(degrees))
    assert scan.range_max == 80.0


def test_robotlaser_states_its_own_angles_and_range(tmp_path):
    drive = Drive()
    lines = drive.raw('ROBOTLASER1')
    log = read_carmen(write_log(tmp_path / 'log', lines))
    scan = log.scans[0]
    assert scan.fov_start == pytest.approx(-math.pi / 2, abs=DIGITS)
    assert scan.step == pytest.approx(0.0174533)
    assert scan.range_max == 30.0
    assert log.mount == pytest.approx((0.1, 0.0, 0.0), abs=DIGITS)
    assert len(log.scans) == len(drive.scans)


def test_a_scan_that_is_written_twice_counts_once(tmp_path):
    drive = Drive()
    lines = []
    for old, new in zip(drive.raw(), drive.raw('ROBOTLASER1'), strict=True):
        lines.extend([old, new] if old != new else [old])
    log = read_carmen(write_log(tmp_path / 'log', lines))
    assert len(log.scans) == len(drive.scans)
    assert log.scans[0].range_max == 30.0


def test_a_rear_laser_alone_looks_back(tmp_path):
    drive = Drive(mount=Pose2(-0.2, 0.0, math.pi))
    log = read_carmen(write_log(tmp_path / 'log', drive.raw('RLASER')))
    assert log.mount.x == pytest.approx(-0.2, abs=DIGITS)
    assert abs(log.mount.theta) == pytest.approx(math.pi, abs=DIGITS)


def test_a_second_laser_is_named_and_left_out(tmp_path):
    drive = Drive()
    lines = drive.raw() + [
        line.replace('FLASER', 'RLASER') for line in drive.raw() if line.startswith('FLASER')
    ]
    log = read_carmen(write_log(tmp_path / 'log', lines))
    assert len(log.scans) == len(drive.scans)
    assert any('a second laser RLASER: not used' in note for note in log.notes)


def test_the_offset_of_the_lines_counts_where_param_says_another(tmp_path):
    lines = Drive().raw()
    lines[1] = 'PARAM robot_frontlaser_offset 0.35 nohost 0'
    log = read_carmen(write_log(tmp_path / 'log', lines))
    assert log.mount.x == pytest.approx(0.1, abs=DIGITS)
    assert any('robot_frontlaser_offset 0.350 m' in note for note in log.notes)


def test_a_smaller_range_in_param_is_taken(tmp_path):
    lines = ['PARAM robot_front_laser_max 8.1 nohost 0', *Drive().raw()]
    assert read_carmen(write_log(tmp_path / 'log', lines)).scans[0].range_max == 8.1


def test_damaged_lines_are_named_and_the_rest_is_read(tmp_path):
    drive = Drive()
    lines = drive.raw()
    scans = [number for number, line in enumerate(lines) if line.startswith('FLASER')]
    lines[scans[1]] = ' '.join(lines[scans[1]].split()[:100])
    lines[scans[2]] = lines[scans[2]].replace(' host ', ' ')
    lines[scans[3]] = lines[scans[3]].replace('FLASER 180', 'FLASER x80')
    lines[scans[4]] = 'FLASER 0 1 2 0 1 2 0 12.5 host 12.5'
    lines[scans[5]] = lines[scans[5]].replace('FLASER 180 ', 'FLASER 180 nan ', 1)
    lines[scans[6]] = 'GYRO 1 2 3'
    log = read_carmen(write_log(tmp_path / 'log', lines))
    assert len(log.scans) == len(drive.scans) - 6
    text = '\n'.join(log.notes)
    for number, reason in (
        (scans[1], 'FLASER is cut short'),
        (scans[2], 'FLASER is cut short or too long'),
        (scans[3], 'FLASER holds a word that is not a number'),
        (scans[4], 'FLASER has 0 readings'),
        (scans[5], 'FLASER holds a number that is not finite'),
        (scans[6], 'unknown message GYRO'),
    ):
        assert f'line {number + 1}: {reason}' in text, text


def test_many_lines_of_one_kind_give_one_note(tmp_path):
    lines = Drive().raw() + ['GYRO 1'] * 50
    notes = read_carmen(write_log(tmp_path / 'log', lines)).notes
    (note,) = [note for note in notes if 'GYRO' in note]
    assert 'and 45 more' in note


def test_binary_content_gives_one_note(tmp_path):
    good = '\n'.join(Drive().raw()).encode()
    (tmp_path / 'log').write_bytes(good + b'\n' + bytes(range(256)) * 50)
    notes = read_carmen(tmp_path / 'log').notes
    (note,) = [note for note in notes if 'no message' in note]
    assert note.isprintable()


@pytest.mark.parametrize('content', ['', 'hello world\n', 'ODOM 0 0 0 0 0 0 1 host 1\n'])
def test_a_file_without_scans_is_an_error(tmp_path, content):
    (tmp_path / 'log').write_text(content)
    with pytest.raises(RecordingError, match='holds no scans'):
        read_carmen(tmp_path / 'log')


def test_a_missing_file_is_an_error(tmp_path):
    with pytest.raises(RecordingError, match='cannot be read'):
        read_carmen(tmp_path / 'none.log')


def test_the_recorded_logs(recordings):
    folder = recordings('carmen')
    scans = {'intel': 910, 'aces': 440, 'belgioioso': 395, 'orebro': 237}
    for name, count in scans.items():
        log = read_carmen(folder / f'{name}.log')
        assert log.corrected
        assert len(log.scans) == count
        assert (np.diff(log.stamps) > 0.0).all()
    assert any('have no odometry since the scan before' in note for note in log.notes)  # Örebro
