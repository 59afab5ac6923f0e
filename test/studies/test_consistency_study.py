"""The consistency study: runs of a small world, files that grow as runs end."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from explore_slam.cli import benchmark
from explore_slam.cli.main import build_parser
from explore_slam.errors import ConfigError, EvaluationError
from explore_slam.results.consistency import EstimationErrors
from explore_slam.simulation import world_path
from explore_slam.studies.consistency_study import (
    ConsistencyRun,
    ConsistencyStudy,
    SeedResult,
    markdown_table,
    run_seed,
    save_results,
)

SMALL = world_path('small')
FIGURES = (
    'pose_nees_mean',
    'pose_nees_median',
    'position_nees_mean',
    'position_in_95',
    'position_rms',
    'best_path_rms',
)


def test_the_command_runs_seeds_without_camera_and_writes_their_figures(tmp_path, capsys):
    words = [
        'benchmark', 'consistency', '--world', 'small', '--vehicles', '2', '--vision', 'none',
        '--duration', '6', '--seeds', '0,2', '--workers', '1', '--output', str(tmp_path / 'out'),
        '--set', 'particles=40',
    ]  # fmt: skip
    assert benchmark.run(build_parser('benchmark').parse_args(words)) == 0
    printed = capsys.readouterr()
    assert printed.out.startswith('| seed | vehicle | pose NEES mean |')
    assert '[2/2] seed 2: robot1 NEES' in printed.err
    content = json.loads((tmp_path / 'out' / 'consistency.json').read_text())
    assert content['vision'] == 'none'
    assert [(run['seed'], run['vehicle']) for run in content['runs']] == [
        (0, 'robot1'), (0, 'robot2'), (2, 'robot1'), (2, 'robot2'),
    ]  # fmt: skip
    for run in content['runs']:
        assert run['duration'] == pytest.approx(6.0, abs=0.1)
        assert 0.0 < run['position_rms'] < 0.05
        assert 0.0 < run['best_path_rms'] < 0.05
        assert 0.0 <= run['position_in_95'] <= 1.0
        assert run['pose_nees_mean'] > 0.0
    metrics = json.loads((tmp_path / 'out' / 'seed_2' / 'metrics.json').read_text())
    assert (
        metrics['vehicles']['robot1']['online']['position_in_95']
        == (content['runs'][2]['position_in_95'])
    )
    # without camera there are no landmarks
    assert metrics['landmarks'] == 0
    assert (tmp_path / 'out' / 'nees.png').stat().st_size > 10_000


def test_figures_that_are_not_finite_are_null(tmp_path):
    run = ConsistencyRun(1, 'robot1', math.inf, 2.0, math.inf, 0.5, math.nan, 0.01, 10.0)
    errors = EstimationErrors(
        np.arange(2.0), np.ones((2, 3)), np.stack([np.eye(3), np.zeros((3, 3))])
    )
    result = SeedResult(1, [run], {'robot1': errors})
    path = save_results(ConsistencyStudy(SMALL), [result], tmp_path)
    found = json.loads(path.read_text())['runs'][0]
    assert [found[name] for name in FIGURES] == [None, 2.0, None, 0.5, None, 0.01]
    assert '| 1 | robot1 | inf | 2.00 | inf | 0.50 | nan | 0.0100 |' in markdown_table([run])


def test_wrong_studies_are_refused(tmp_path):
    with pytest.raises(EvaluationError, match="vision is 'vehicle'"):
        ConsistencyStudy(SMALL, vision='vehicle')
    with pytest.raises(EvaluationError, match='no seeds'):
        ConsistencyStudy(SMALL, seeds=())
    with pytest.raises(ConfigError, match='particels'):
        ConsistencyStudy(SMALL, settings={'particels': 10})
    with pytest.raises(EvaluationError, match='9 vehicles, expected 1 to'):
        run_seed(ConsistencyStudy(Path(SMALL), vehicles=9), 0, tmp_path)
