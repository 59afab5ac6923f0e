"""The experiments end to end at small size: tables, plots, command."""

import argparse
import json

import numpy as np
import pytest

from explore_slam.cli import experiment
from explore_slam.errors import EvaluationError
from explore_slam.settings import with_values
from explore_slam.studies.experiments import experiment1, experiment2, experiment3, experiment4
from explore_slam.studies.experiments.filter_study import filter_config, run_filter
from explore_slam.studies.experiments.scenarios import dead_reckoning, draw_scenario
from explore_slam.studies.experiments.tables import ExperimentReport, Table, share, spread
from explore_slam.studies.experiments.trials import SmootherEstimator, rms, run_trial
from explore_slam.studies.experiments.tum_frames import read_tum
from explore_slam.studies.experiments.walk_trials import WalkOptions
from explore_slam.vision import VisionConfig

FEW = WalkOptions(seeds=(0,), particles=30)


@pytest.fixture(scope='module')
def first():
    return experiment1.run(
        experiment1.Options(seeds=(0, 1), particles=60, paper_particles=40, filter_runs=2)
    )


# -- trials -------------------------------------------------------------------------------------


def odometry_rms(scenario):
    off = [
        np.subtract(dead_reckoning(scenario, name), scenario.true_path(name))[1:, :2]
        for name in scenario.start_poses
    ]
    return rms(np.hypot(*np.concatenate(off).T))


def test_smoother_is_better_than_odometry_and_common_maps_than_dedicated():
    scenario = draw_scenario('crossing', 0)
    dedicated, common = (
        run_trial(scenario, SmootherEstimator(scenario.start_poses, maps))
        for maps in ('dedicated', 'common')
    )
    assert common.position_rms < 0.7 * dedicated.position_rms
    assert dedicated.position_rms < odometry_rms(scenario)


def test_smoother_gains_nothing_from_a_common_map_where_paths_are_separate():
    scenario = draw_scenario('separate', 0)
    dedicated, common = (
        run_trial(scenario, SmootherEstimator(scenario.start_poses, maps))
        for maps in ('dedicated', 'common')
    )
    assert common.position_rms == pytest.approx(dedicated.position_rms, rel=1e-3)


@pytest.mark.parametrize('engine', ['paper', 'fastslam2'])
def test_filter_trial_is_repeatable(engine):
    scenario = draw_scenario('separate', 1)
    options = experiment1.Options(particles=50, paper_particles=50)
    one, two = (
        run_trial(
            scenario, experiment1.make_estimator(engine, 'common', scenario, options, seed=3)
        )
        for _ in range(2)
    )
    for name in scenario.start_poses:
        assert one.vehicles[name].errors == two.vehicles[name].errors
    assert one.landmarks == two.landmarks


def test_fastslam2_stays_near_the_smoother():
    scenario = draw_scenario('separate', 0)
    options = experiment1.Options(particles=300)
    estimator = experiment1.make_estimator('fastslam2', 'dedicated', scenario, options, 0)
    smoother = run_trial(scenario, SmootherEstimator(scenario.start_poses, 'dedicated'))
    assert run_trial(scenario, estimator).position_rms < 1.5 * smoother.position_rms


# -- reports ------------------------------------------------------------------------------------


def test_experiment1_prints_both_tables_beside_the_published(first):
    text = first.markdown()
    assert 'Table II: crossing paths, 28 steps' in text
    assert 'Table III: separate paths, 16 steps' in text
    assert '| published | common    | robot2  | 0.038' in text
    for maps in ('common', 'dedicated'):
        for method in ('paper', 'fastslam2', 'iSAM2'):
            assert f'| {method} ' in text
        entry = first.metrics[f'crossing/fastslam2/{maps}']
        assert len(entry['position_rms_of_seeds']) == 4
        assert len(set(entry['position_rms_of_seeds'])) == 4
        assert 0.2 < entry['position_ratio'] < 100.0


def test_experiment1_is_saved_with_its_plots(first, tmp_path):
    folder = first.save(tmp_path)
    assert {path.name for path in folder.iterdir()} == {
        'report.md', 'metrics.json', 'paths.png', 'errors.png', 'effective_particles.png',
    }  # fmt: skip
    assert json.loads((folder / 'metrics.json').read_text())['seeds'] == [0, 1]
    assert (tmp_path / 'latest').resolve() == folder.resolve()


def test_experiment2_sweeps_both_thresholds(small_walks):
    report = ExperimentReport('a sweep')
    experiment2.sweep(small_walks[:1], FEW, report)
    table = report.tables[0]
    assert [row[:2] for row in table.rows][:2] == [('P0', '0.3'), ('P0', '0.5')]
    assert len(table.rows) == len(experiment2.QUALITIES) + len(experiment2.THRESHOLDS)
    updates = report.metrics['updates']['P0']
    assert updates['0.3'][0] >= updates['0.95'][0]
    assert 'figure8' in report.figures


def test_experiment2_studies_real_frames(recordings):
    config = with_values(VisionConfig(), {'feature_budget': 150})
    frames = read_tum(recordings('tum_fr1_rpy'), config, limit=9)
    report = ExperimentReport('a study')
    experiment2.study_frames(frames, report)
    distances, associations = report.tables
    assert [row[0] for row in distances.rows] == ['0.1', '0.3', '0.5', '0.7', '0.9', '1.1', '1.2']
    shares = [float(row[2]) for row in distances.rows]
    assert shares == sorted(shares)
    assert associations.rows[0][2:] == (
        '4/4 = 100 %', '13/14 = 93 %', '22/25 = 88 %', '31/42 = 74 %',
    )  # fmt: skip
    best = report.metrics['association']['ratio test, stride 1, E0 0.5']
    assert best['correct'] > 50
    assert best['precision'] > 0.9


def test_filter_updates_the_landmarks_that_it_sees(recordings):
    frames = read_tum(recordings('tum_fr1_rpy'), VisionConfig(), limit=9)
    run = run_filter(frames, filter_config(0.4, 100), seed=0)
    assert run.total > 50
    assert run.precision > 0.95
    assert run.position_rms < 0.1


def test_experiment3_shows_thresholds_and_times(small_walks, tmp_path):
    report = experiment3.evaluate(small_walks[:1], FEW)
    thresholds, times = report.tables
    assert [row[1] for row in thresholds.rows] == ['0.3', '0.4', '0.5', '0.6'] * 3
    assert [row[0] for row in times.rows] == ['published', 'paper', 'fastslam2']
    assert (report.save(tmp_path) / 'figure11.png').stat().st_size > 10_000


def test_experiment4_compares_maps_and_insertion(small_walks, tmp_path):
    report = experiment4.evaluate(small_walks, FEW)
    team, maps = report.tables
    assert len(team.rows) == 4 + 2 * 2 * 3
    assert maps.rows[0] == ('published', '0.57')
    common = report.metrics['fastslam2, common, unmapped_region']['landmarks'][0]
    free = report.metrics['fastslam2, common, always']['landmarks'][0]
    assert 0 < common <= free
    assert (report.save(tmp_path) / 'figure14.png').stat().st_size > 10_000


# -- tables -------------------------------------------------------------------------------------


def test_table_is_aligned_markdown():
    table = Table('A table', ('a', 'bb'), (('1', '2'), ('333', '4')))
    assert table.markdown().splitlines() == [
        '### A table', '', '| a   | bb |', '| --- | -- |', '| 1   | 2  |', '| 333 | 4  |',
    ]  # fmt: skip


def test_table_with_a_short_row_is_refused():
    with pytest.raises(EvaluationError, match='expected 2'):
        Table('A table', ('a', 'b'), (('1',),))


def test_spread_and_share():
    assert spread([1.0, 3.0], 1) == '2.0 ± 1.4'
    assert spread([1.0], 2) == '1.00'
    assert spread([float('nan')]) == '–'
    assert share(7.5, 16) == '7.5/16'


# -- command ------------------------------------------------------------------------------------


def command(*words):
    parser = argparse.ArgumentParser()
    experiment.configure(parser)
    return parser.parse_args(words)


def test_command_runs_an_experiment(tmp_path, capsys):
    words = ['laps', '--seeds', '4', '--particles', '10', '--laps', '1', '--without-isam2']
    arguments = command(*words, '--output', str(tmp_path))
    assert experiment.run(arguments) == 0
    out, err = capsys.readouterr()
    assert '| fastslam2 |' in out
    assert '| iSAM2 ' not in out
    assert str(tmp_path) in err
    assert (tmp_path / 'latest' / 'report.md').is_file()


@pytest.mark.parametrize('words', [('5',), (), ('1', '--seeds', 'x')])
def test_command_refuses_what_it_does_not_know(words, capsys):
    with pytest.raises(SystemExit):
        command(*words)
    assert 'usage' in capsys.readouterr().err


def test_step_without_observations_keeps_its_place_in_the_series():
    scenario = draw_scenario('separate', 0, landmarks=3)
    assert any(len(step.observations) == 0 for step in scenario.steps)
    options = experiment1.Options(particles=20)
    estimator = experiment1.make_estimator('fastslam2', 'common', scenario, options, 0)
    trial = run_trial(scenario, estimator)
    assert len(trial.effective) == len(trial.landmarks) == len(trial.seconds) == 32
    assert np.isnan(trial.effective).any()
