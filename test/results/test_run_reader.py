"""A run folder read back holds what was written, and its map can be drawn."""

import numpy as np
import pytest

from explore_slam.cli.main import main
from explore_slam.errors import EvaluationError
from explore_slam.results import RunFolder
from explore_slam.results.run_reader import read_metrics, read_run

PNG_SIGNATURE = b'\x89PNG\r\n\x1a\n'


@pytest.fixture
def written(some_run, tmp_path):
    data = some_run()
    folder = RunFolder.create(tmp_path)
    folder.write_run(data)
    return data, folder.path


def test_trajectories_and_grid_come_back(written):
    data, folder = written
    read = read_run(folder)
    assert [run.name for run in read.vehicles] == [run.name for run in data.vehicles]
    for mine, theirs in zip(read.vehicles, data.vehicles, strict=True):
        found = mine.trajectories()
        for kind, trajectory in theirs.trajectories().items():
            np.testing.assert_allclose(found[kind].poses, trajectory.poses, atol=1e-6)
    assert np.array_equal(read.grid.known(), data.grid.known())
    assert read.metrics['landmarks'] == data.metrics['landmarks']


def test_the_command_draws_the_map(written, tmp_path, capsys):
    _, folder = written
    picture = tmp_path / 'map.png'
    assert main(['report', str(folder), '--map', str(picture)]) == 0
    assert picture.read_bytes().startswith(PNG_SIGNATURE)
    assert f'map: {picture}' in capsys.readouterr().out


def test_an_empty_run_and_a_damaged_one_are_named(tmp_path, capsys):
    (tmp_path / 'metrics.json').write_text('{}')
    assert main(['report', str(tmp_path), '--map', str(tmp_path / 'map.png')]) == 1
    assert 'no grid, landmarks or trajectories' in capsys.readouterr().err
    (tmp_path / 'metrics.json').write_text('[1')
    with pytest.raises(EvaluationError, match=r'metrics\.json cannot be read'):
        read_metrics(tmp_path)
    with pytest.raises(EvaluationError, match='cannot be read'):
        read_run(tmp_path / 'nothing')
