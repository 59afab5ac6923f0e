"""Laps of the crossing paths at small size: as accurate as iSAM2, consistent, and bounded."""

import argparse
import json

import numpy as np
import pytest

from explore_slam.cli import experiment
from explore_slam.studies.experiments import laps
from explore_slam.studies.experiments.scenarios import draw_scenario
from explore_slam.studies.experiments.trials import SmootherEstimator
from explore_slam.studies.parallel import ALONE, Workers, make_runs


@pytest.fixture(scope='module')
def report():
    return laps.run(laps.Options(seeds=(0, 1), laps=(4,), particles=200))


def test_the_filter_is_as_accurate_as_isam2_and_consistent(report):
    found, exact = report.metrics['4 laps/fastslam2'], report.metrics['4 laps/iSAM2']
    assert found['position_rms'] < 1.25 * exact['position_rms']
    assert 1.5 < np.mean(found['pose_nees_of_seeds']) < 6.0
    assert np.mean(found['position_in_95_of_seeds']) > 0.85
    assert 1.5 < np.mean(exact['pose_nees_of_seeds']) < 5.0


def test_the_graph_stops_growing(report):
    """Of each landmark, three visits are kept."""
    sizes = np.array(report.metrics['4 laps/fastslam2']['keyframes_observations_seconds_of_laps'])
    growth = np.diff(sizes[:, :2], axis=0, prepend=0.0)
    assert (growth[0] > 0).all()
    assert (growth[3] < 0.5 * growth[0]).all()
    assert report.markdown().count('### ') == 2


def test_errors_are_those_of_the_scenario():
    scenario = draw_scenario('crossing', 0, laps=2)
    run = laps.follow(scenario, SmootherEstimator(scenario.start_poses, 'common'))
    assert len(run.errors) == len(scenario.steps) == 2 * 2 * 28
    assert run.by_lap(2).shape == (2, 3)
    assert run.sizes[-1] == (0, 0)
    assert 0.0 < run.position_rms < 0.05


def test_command_writes_tables_and_plots(tmp_path, capsys):
    parser = argparse.ArgumentParser()
    experiment.configure(parser)
    arguments = parser.parse_args(
        ['laps', '--laps', '2', '--seeds', '0', '--particles', '50', '--without-isam2']
        + ['--output', str(tmp_path)]
    )
    assert experiment.run(arguments) == 0
    assert '| 2    | fastslam2 |' in capsys.readouterr().out
    folder = tmp_path / 'latest'
    assert (folder / 'growth.png').stat().st_size > 10_000
    metrics = json.loads((folder / 'metrics.json').read_text())
    assert len(metrics['2 laps/fastslam2']['position_rms_of_seeds']) == 1


def test_other_processes_give_the_same_runs():
    pytest.importorskip('joblib', reason='several workers need joblib')
    tasks = [
        (laps.Options(seeds=(seed,), laps=(1,), particles=50, isam2=False), 1, seed)
        for seed in (0, 1)
    ]
    for alone, other in zip(
        make_runs(laps._run_seed, tasks, ALONE),
        make_runs(laps._run_seed, tasks, Workers(2)),
        strict=True,
    ):
        assert alone.keys() == other.keys() == {'fastslam2'}
        assert np.array_equal(alone['fastslam2'].errors, other['fastslam2'].errors)
        assert np.array_equal(alone['fastslam2'].covariances, other['fastslam2'].covariances)
