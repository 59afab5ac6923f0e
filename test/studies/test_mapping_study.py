"""The mapping study: figures of generated logs, whole, cut in two and as a bag."""

import itertools
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from carmen_logs import Drive, write_log

from explore_slam.agent import Join
from explore_slam.cli.main import main
from explore_slam.errors import EvaluationError
from explore_slam.geometry import Pose2
from explore_slam.recording.carmen_log import read_carmen
from explore_slam.recording.importers.carmen import import_carmen
from explore_slam.results.relations import (
    LoggedOdometry,
    Relations,
    find_offset,
    relation_errors,
)
from explore_slam.studies import mapping_study
from explore_slam.studies.mapping_log import VehicleLog, cut_log, prepare
from explore_slam.studies.mapping_study import join_figures, markdown_table, run_mapping

PARTICLES = {'particles': 30}
KEYS = {
    'seed', 'translation_mean_m', 'translation_std_m', 'rotation_mean_deg', 'near_m', 'loops_m',
    'reference_translation_mean_m', 'reference_rms_m', 'closures', 'seconds', 'recorded_seconds',
    'peak_memory_mb', 'longest_step_s', 'joined_after_m', 'met_after_m', 'join_error_m',
    'false_joins',
}  # fmt: skip


@pytest.fixture
def drive():
    """Two laps of a circle, the laser at the vehicle origin as in logs of GMapping."""
    return Drive(steps=1200, mount=Pose2(0.0, 0.0, 0.0))


@pytest.fixture
def log_and_relations(drive, tmp_path):
    """A corrected log, and relations between true poses of its scans, 1000 s later."""
    random = np.random.default_rng(0)
    scans = list(drive.scans)
    rows = []
    # as in the benchmark: from scan to scan, and between far ones
    ends = [*itertools.pairwise(scans), *random.choice(scans, (60, 2)).tolist()]
    for first, second in ends:
        x, y, theta = drive.truth[first].between(drive.truth[second])
        times = (drive.stamps[first] + 1000.0, drive.stamps[second] + 1000.0)
        rows.append([*times, x, y, 0.0, 0.0, 0.0, theta])
    path = tmp_path / 'room.relations'
    np.savetxt(path, rows)
    return write_log(tmp_path / 'room.log', drive.corrected()), path


def test_a_whole_log(log_and_relations, tmp_path):
    log, relations = log_and_relations
    task = prepare(log, tmp_path, relations=relations, settings=PARTICLES)
    assert task.offset == pytest.approx(1000.0, abs=2e-3)
    figures = run_mapping(task, 0)
    assert set(figures) >= KEYS
    assert figures['reference_translation_mean_m'] < 0.01  # the truth to six digits
    assert figures['translation_mean_m'] < 0.1
    assert figures['reference_rms_m'] < 0.1
    assert figures['recorded_seconds'] == pytest.approx(119.9, abs=0.1)
    assert figures['longest_step_s'] >= figures['step_p99_s'] >= figures['step_median_s'] > 0.0
    assert figures['joined_after_m'] is None
    # the odometry alone is far worse: it turns too much
    read = read_carmen(log)
    wheels = relation_errors(
        Relations.load(relations),
        read.times[read.rows],
        read.odometry[read.rows],
        LoggedOdometry(read.times, read.odometry),
        1000.0,
    )
    assert wheels.translation.mean() > 2.0 * figures['translation_mean_m']


def test_without_relations_the_reference_alone_counts(log_and_relations, tmp_path):
    log, _ = log_and_relations
    figures = run_mapping(prepare(log, tmp_path, settings=PARTICLES), 0)
    assert figures['translation_mean_m'] is None
    assert figures['reference_translation_mean_m'] is None
    assert figures['reference_rms_m'] < 0.1


def test_two_vehicles_of_one_log(log_and_relations, tmp_path):
    log, relations = log_and_relations
    task = prepare(log, tmp_path, relations=relations, cut=60.0, settings=PARTICLES)
    assert list(task.vehicles) == ['robot1', 'robot2']
    figures = run_mapping(task, 0)
    # both are driven at the same time, in one map
    assert figures['recorded_seconds'] == pytest.approx(60.0, abs=1.0)
    assert figures['translation_mean_m'] < 0.15
    assert figures['reference_rms_m'] < 0.15


def test_in_a_square_room_a_vehicle_of_unknown_start_is_not_joined(log_and_relations, tmp_path):
    """It looks the same in four directions: the map is that of the first vehicle."""
    log, _ = log_and_relations
    task = prepare(log, tmp_path, cut=60.0, starts='unknown', settings=PARTICLES)
    assert task.unknown_starts == ('robot2',)
    figures = run_mapping(task, 0)
    assert figures['joined_after_m'] is None
    assert figures['false_joins'] == 0
    assert figures['reference_rms_m'] < 0.1


def test_joins_are_judged_by_the_reference():
    """A vehicle that drives 1 m/s along x, and one behind it along y."""
    stamps = np.arange(0.0, 20.0, 0.5)
    zeros = np.zeros_like(stamps)
    paths = [
        np.stack(columns, axis=1) for columns in [(stamps, zeros, zeros), (zeros, stamps, zeros)]
    ]
    logs = {
        name: VehicleLog(stamps, stamps, path, stamps[::4], path[::4])
        for name, path in zip(('robot1', 'robot2'), paths, strict=True)
    }
    right = Join('robot2', 11.0, 9.0, 'robot1', 3.0, Pose2(-3.0, 11.1, 0.0))
    figures = join_figures(logs, [right])
    assert figures['joined_after_m'] == 9.0
    assert figures['met_after_m'] == 0.0
    assert figures['join_error_m'] == pytest.approx(0.1)
    assert figures['false_joins'] == 0
    wrong = right._replace(relative=Pose2(-3.0, 13.0, 0.0))
    turned = right._replace(relative=Pose2(-3.0, 11.0, 0.2))
    assert join_figures(logs, [wrong])['false_joins'] == 1
    assert join_figures(logs, [turned])['false_joins'] == 1
    assert join_figures(logs, [])['joined_after_m'] is None
    assert join_figures(logs, [])['false_joins'] == 0
    later = logs['robot2']
    away = replace(later, reference=later.reference + np.array([0.0, 6.0, 0.0]))
    assert join_figures({'robot1': logs['robot1'], 'robot2': away}, [])['met_after_m'] is None
    back = replace(later, reference=np.array([6.0, 6.0, 0.0]) - later.reference)
    assert join_figures({'robot1': logs['robot1'], 'robot2': back}, [])['met_after_m'] == 6.0
    alone = join_figures({'robot1': logs['robot1']}, [])
    assert set(alone.values()) == {None}


def test_the_parts_of_a_cut_log_make_up_the_whole(log_and_relations):
    log = read_carmen(log_and_relations[0])
    first, second = cut_log(log, 60.0)
    assert len(first.scans) + len(second.scans) == len(log.scans)
    assert len(first.odometry) + len(second.odometry) == len(log.odometry)
    assert second.rows[0] == 0
    assert second.stamps[0] == log.stamps[0]
    np.testing.assert_allclose(np.diff(second.stamps), np.diff(log.stamps[len(first.stamps) :]))
    for seconds in (0.0, 1e4):
        with pytest.raises(EvaluationError, match='leaves a part without scans'):
            cut_log(log, seconds)


def test_a_bag_as_log(log_and_relations, tmp_path):
    log, relations = log_and_relations
    import_carmen([log], tmp_path / 'bag')
    task = prepare(tmp_path / 'bag', tmp_path, relations=relations, settings=PARTICLES)
    assert task.offset == pytest.approx(1000.0, abs=5e-3)
    direct = run_mapping(
        prepare(log, tmp_path / 'other', relations=relations, settings=PARTICLES), 0
    )
    figures = run_mapping(task, 0)
    assert figures['translation_mean_m'] == pytest.approx(direct['translation_mean_m'], abs=2e-3)
    assert figures['reference_rms_m'] == pytest.approx(direct['reference_rms_m'], abs=2e-3)


def test_what_cannot_be_evaluated_is_refused(drive, log_and_relations, tmp_path):
    raw = write_log(tmp_path / 'raw.log', drive.raw())
    with pytest.raises(EvaluationError, match='no corrected poses'):
        prepare(raw, tmp_path)
    with pytest.raises(EvaluationError, match='raw log'):
        prepare(raw, tmp_path, cut=10.0)
    with pytest.raises(EvaluationError, match='expected --cut with --starts unknown'):
        prepare(log_and_relations[0], tmp_path, starts='unknown')


def test_the_command_writes_figures_table_and_maps(log_and_relations, tmp_path, capsys):
    log, relations = log_and_relations
    out = tmp_path / 'out'
    command = ['benchmark', 'mapping', str(log), str(relations), '--seeds', '0..1']
    assert main([*command, '--output', str(out), '--set', 'particles=30']) == 0
    printed = capsys.readouterr()
    assert printed.out.count('\n') == 4
    assert 'corrected log' in printed.err
    content = json.loads((out / 'mapping.json').read_text())
    assert [run['seed'] for run in content['runs']] == [0, 1]
    assert all(set(run) >= KEYS for run in content['runs'])
    assert all(run['peak_memory_mb'] > 50.0 for run in content['runs'])
    assert content['settings'] == {'particles': 30}
    assert {path.name for path in out.iterdir()} == {
        'mapping.json', 'table.md', 'map_seed0.png', 'map_seed1.png',
    }  # fmt: skip


def test_the_table_shows_what_is_missing():
    run = dict.fromkeys((name for name, _, _ in mapping_study.FIGURES))
    run.update(seed=3, seconds=1.25, closures=2)
    row = markdown_table([run]).splitlines()[-1]
    assert row.startswith('| 3 | - |')
    assert '| 2 | - | - | - | - | 1.2 | - | - |' in row


def test_the_evaluation_of_the_slam_benchmark(recordings):
    """Figures of the log's own poses as published with the relations: 0.053 and 0.057 m, 2.0°."""
    folder = recordings('carmen')
    log = read_carmen(folder / 'intel.log')
    relations = Relations.load(folder / 'intel.relations')
    assert find_offset(relations, LoggedOdometry(log.times, log.odometry)) == pytest.approx(
        976052857.337, abs=1e-3
    )
    figures = relation_errors(
        relations,
        log.times[log.rows],
        log.reference,
        LoggedOdometry(log.times, log.odometry),
        976052857.337,
    ).figures()
    assert figures['translation_mean_m'] == pytest.approx(0.0527, abs=1e-4)
    assert figures['loops_m'] == pytest.approx(0.0567, abs=1e-4)
    assert figures['rotation_mean_deg'] == pytest.approx(1.98, abs=0.01)
    assert math.isclose(figures['near_m'], 0.0500, abs_tol=1e-4)
