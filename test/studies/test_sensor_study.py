"""The sensor rig and its study: truth, odometry, sweeps, figures, files."""

import itertools
import json
import math

import numpy as np
import pytest

from explore_slam.agent import AgentConfig
from explore_slam.cli.main import main
from explore_slam.data import LaserScan, SweepTiming
from explore_slam.errors import ConfigError, EvaluationError
from explore_slam.geometry import Pose2, to_world
from explore_slam.mapping import OccupancyGrid
from explore_slam.simulation.worlds.walls import distances_from
from explore_slam.studies import sensor_rig, sensor_study
from explore_slam.studies.sensor_rig import FLOOR, LASER, START, Drive, Laser
from explore_slam.studies.sensor_study import Case, SensorStudy, markdown_table, run_case


@pytest.fixture
def short_tour(monkeypatch):
    monkeypatch.setattr(sensor_rig, 'TOUR', (2.0 * math.pi, (2.2, 4.0)))


def test_the_drive_keeps_to_its_speeds_and_clear_of_the_walls():
    drive = Drive(0.9)
    steps = np.diff(drive.poses, axis=0) * sensor_rig.TRUTH_RATE
    assert np.hypot(steps[:, 0], steps[:, 1]).max() == pytest.approx(0.4, abs=1e-6)
    assert np.abs(steps[:, 2]).max() == pytest.approx(0.9, abs=1e-6)
    assert steps[:, 2].min() < -0.89
    assert np.abs(np.diff(steps[:, 2])).max() < 0.04  # rad/s in 5 ms: no jumps
    assert distances_from(FLOOR, drive.poses[::50, :2]).min() > 0.4
    assert tuple(drive.poses[0]) == tuple(START)


@pytest.mark.usefixtures('short_tour')
def test_odometry_turns_too_far_and_drives_right():
    drive = Drive(0.9)
    readings = sensor_rig.odometry(drive, 1.05, np.random.default_rng(0))
    assert readings[0].pose == Pose2(0.0, 0.0, 0.0)
    turned = sum(
        before.pose.between(after.pose).theta for before, after in itertools.pairwise(readings)
    )
    true = drive.poses[-1, 2] - drive.poses[0, 2]
    assert turned == pytest.approx(1.05 * true, abs=0.05)
    at_rest = [reading.pose for reading in readings if reading.stamp < sensor_rig.REST]
    assert set(at_rest) == {Pose2(0.0, 0.0, 0.0)}


@pytest.mark.usefixtures('short_tour')
@pytest.mark.parametrize('backward', [False, True])
@pytest.mark.parametrize('last', [False, True])
def test_every_beam_is_measured_from_where_the_vehicle_is_at_its_time(backward, last):
    drive = Drive(0.9)
    laser = Laser(10.0, backward=backward, last=last)
    scan = sensor_rig.scans(drive, laser, np.random.default_rng(0))[40]
    assert scan.time_increment == pytest.approx(1.0 / 3600.0)
    times = laser.shares - (laser.shares.max() if last else 0.0)
    ends = [
        to_world(
            Pose2.from_array(pose).compose(LASER),
            distance * np.array([[math.cos(angle), math.sin(angle)]]),
        )[0]
        for pose, angle, distance in zip(
            drive.at(scan.stamp + times), scan.angles, scan.ranges, strict=True
        )
        if np.isfinite(distance)
    ]
    assert len(ends) > 300
    assert distances_from(FLOOR, np.array(ends)).max() < 0.05  # five deviations of a range
    assert scan.timing == SweepTiming(
        None, 'backward' if backward else 'forward', 'last' if last else 'first'
    )


@pytest.mark.usefixtures('short_tour')
def test_nothing_is_said_of_a_laser_whose_sweeps_are_not_stated():
    scan = sensor_rig.scans(Drive(0.9), Laser(stated=False), np.random.default_rng(0))[0]
    assert (scan.time_increment, scan.timing) == (0.0, SweepTiming())


@pytest.mark.usefixtures('short_tour')
def test_an_increment_that_the_driver_states_wrongly_gives_a_right_map():
    (case,) = SensorStudy(titles=['0.9 rad/s, increment of the LDS-01']).cases()
    (laser,) = case.lasers
    scan = sensor_rig.scans(Drive(0.9), laser, np.random.default_rng(0))[0]
    assert (scan.time_increment, scan.timing) == (sensor_study.LDS_INCREMENT, SweepTiming())
    run, _ = run_case(case, 0, AgentConfig())
    assert run.position_rms <= 0.02
    assert run.wrong_cells <= 0.01


@pytest.mark.usefixtures('short_tour')
def test_scans_arrive_when_their_last_beam_is_measured():
    drive = Drive(0.9)
    random = np.random.default_rng(0)
    readings = sensor_rig.odometry(drive, 1.0, random)
    first, last = Laser(5.0), Laser(5.0, last=True)
    for laser, late in ((first, 0.2 - 0.2 / 360), (last, 0.0)):
        sweeps = sensor_rig.scans(drive, laser, np.random.default_rng(1))
        records = sensor_rig.in_order_of_arrival(readings, [sweeps], [laser])
        assert len(records) == len(readings) + len(sweeps)
        number = next(k for k, record in enumerate(records) if isinstance(record, LaserScan))
        arrival = records[number].stamp + late
        assert records[number - 1].stamp <= arrival <= records[number + 1].stamp


@pytest.mark.usefixtures('short_tour')
@pytest.mark.parametrize('source', ['live', 'bag'])
def test_a_spinning_lidar_gives_a_right_map(source):
    laser = Laser(5.5, backward=True, last=True)
    run, grid = run_case(Case('case', (laser,), source=source), 0, AgentConfig())
    assert run.position_rms <= 0.02
    assert run.wrong_cells <= 0.01
    assert run.unmatched == 0
    assert run.occupied == np.count_nonzero(grid.to_trinary() == 100) > 500
    assert run.matched > 50


@pytest.mark.usefixtures('short_tour')
@pytest.mark.parametrize('title', ['10 Hz, on one topic', '3-D lidar'])
def test_two_lasers_and_a_3d_lidar_give_a_right_map(title):
    (case,) = SensorStudy(groups=['lasers'], titles=[title]).cases()
    run, _ = run_case(case, 0, AgentConfig())
    assert run.position_rms <= 0.02
    assert run.wrong_cells <= 0.01
    assert run.unmatched == 0
    assert run.occupied > 500
    assert run.matched == pytest.approx(138, abs=3)  # those of two lasers together


@pytest.mark.usefixtures('short_tour')
def test_a_gyroscope_measures_the_turns_with_a_bias():
    drive = Drive(0.9)
    readings = sensor_rig.gyroscope(drive, np.random.default_rng(1))
    stamps = np.array([reading.stamp for reading in readings])
    rates = np.array([reading.yaw_rate for reading in readings])
    rest = rates[stamps < sensor_rig.REST - 0.02]
    assert np.diff(stamps) == pytest.approx(1.0 / sensor_rig.IMU_RATE)
    assert np.std(rest) == pytest.approx(sensor_rig.RATE_DEVIATION, rel=0.3)
    turned = np.sum(rates - rest.mean()) / sensor_rig.IMU_RATE
    true = drive.poses[-1, 2] - drive.poses[0, 2]
    assert turned == pytest.approx(true, rel=3.0 * sensor_rig.SCALE_DEVIATION)
    assert abs(rest.mean()) > 0.003


@pytest.mark.usefixtures('short_tour')
@pytest.mark.parametrize(
    ('title', 'largest'),
    [
        ('1.4 x, and a gyroscope, from a bag', 0.02),
        ('0.7 x, and a gyroscope', 0.02),
        ('no wheels, 5.5 Hz, 0.9 rad/s', 0.02),
        ('no wheels, two lasers', 0.02),
    ],
)
def test_poor_odometry_or_none_gives_a_right_map(title, largest):
    (case,) = SensorStudy(groups=['odometry'], titles=[title]).cases()[:1]
    run, _ = run_case(case, 0, AgentConfig())
    assert run.position_rms <= largest
    assert run.wrong_cells <= 0.01
    assert run.unmatched <= 1
    assert run.named == ''


@pytest.mark.usefixtures('short_tour')
def test_wheels_that_never_report_motion_are_named():
    (case,) = SensorStudy(groups=['odometry'], titles=['never report']).cases()
    run, _ = run_case(case, 0, AgentConfig())
    assert 'odometry does not move while the scans do' in run.named


def test_the_table_has_a_row_per_case_and_the_range_of_its_seeds():
    runs = [
        sensor_study.CaseRun('a', 0, 0.01, 0.001, 0.0, 900, 50, 0, 4.0),
        sensor_study.CaseRun('a', 1, 0.02, 0.001, 0.005, 900, 49, 1, 4.0),
        sensor_study.CaseRun('b', 0, 0.03, 0.001, 0.0, 900, 50, 0, 4.0),
    ]
    lines = markdown_table(runs).splitlines()
    assert lines[2].startswith('| a | 0.010–0.020 | 0.06 | 0.0–0.5 % | 1 of 100 |')
    assert lines[3].startswith('| b | 0.030 |')


@pytest.mark.usefixtures('short_tour')
def test_the_command_writes_figures_and_pictures(tmp_path, capsys):
    out = tmp_path / 'out'
    arguments = ['benchmark', 'sensors', '--seeds', '3', '--case', 'one moment, 5.5 Hz']
    assert main([*arguments, '--output', str(out)]) == 0
    content = json.loads((out / 'sensors.json').read_text(encoding='utf-8'))
    (run,) = content['runs']
    assert (run['title'], run['seed']) == ('one moment, 5.5 Hz', 3)
    assert run['position_rms'] <= 0.02
    assert (out / '00.png').stat().st_size > 5000
    assert '| one moment, 5.5 Hz |' in capsys.readouterr().out


@pytest.mark.parametrize(
    ('make', 'words'),
    [
        (lambda: SensorStudy(groups=('wheels',)), r"groups \['wheels'\], expected some of"),
        (lambda: SensorStudy(titles=('none such',)), 'no title of a case contains'),
        (lambda: Case('a', source='radio'), "source is 'radio'"),
        (lambda: Case('a', odometry='sonar'), "odometry is 'sonar'"),
    ],
)
def test_a_study_that_cannot_be_is_refused(make, words):
    with pytest.raises(EvaluationError, match=words):
        make()


def test_an_unknown_setting_is_refused():
    with pytest.raises(ConfigError, match='matching_windo'):
        SensorStudy(settings={'matching_windo': 3})


def test_a_picture_of_an_empty_map_is_drawn(tmp_path):
    grid = OccupancyGrid()
    grid.insert_scan(START, LaserScan(0.0, 0.0, 0.1, np.ones(3, np.float32), 0.0, 8.0))
    sensor_study.plot_map(grid, 'title', tmp_path / 'map.png')
    assert (tmp_path / 'map.png').exists()
