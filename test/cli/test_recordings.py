"""The commands on recordings: import, replay, report."""

import json
from pathlib import Path

import numpy as np
import pytest
from synthetic import SyntheticWorld

from explore_slam.cli.main import main
from explore_slam.geometry import Pose2
from explore_slam.recording.importers import intel


@pytest.fixture
def data_set(tmp_path) -> Path:
    """A log of 60 scans in a square room, driven on a circle, with a reference."""
    folder = tmp_path / 'set'
    folder.mkdir()
    increments = np.tile([0.05, 0.0, 0.1], (60, 1))
    poses = intel.odometry_poses(increments)
    room = SyntheticWorld()
    # the log has 180 of the 181 beams of the scanner
    scans = [room.scan_from(0.0, Pose2(*pose), beams=181).ranges[:180] for pose in poses[:60]]
    np.savez(
        folder / intel.LOG,
        ranges=np.array(scans, np.float32),
        valid=np.ones((60, 180), np.uint8),
        odom_inc=increments,
    )
    table = np.column_stack([np.arange(60), poses[:60]])
    np.savetxt(folder / intel.REFERENCE, table)
    return folder


def test_import_replay_report(data_set, tmp_path, capsys):
    bag, runs = tmp_path / 'bag', tmp_path / 'runs'
    assert main(['import', 'intel', str(data_set), str(bag)]) == 0
    output = capsys.readouterr().out
    assert '60  /robot1/scan' in output
    assert '181 messages' in output

    command = ['replay', str(bag), '--out', str(runs), '--set', 'resolution=0.1']
    assert main([*command, '--particles', '20', '--no-progress']) == 0
    captured = capsys.readouterr()
    assert 'robot1' in captured.out
    assert 'known area' in captured.out
    assert 'from the settings of the team' in captured.err
    folder = runs / 'latest'
    assert f'report: {folder.resolve() / "report.html"}' in captured.out
    metrics = json.loads((folder / 'metrics.json').read_text())
    assert metrics['vehicles']['robot1']['online']['position_rms'] < 0.01
    settings = (folder / 'settings.yaml').read_text()
    assert 'resolution: 0.1' in settings
    assert 'particles: 20' in settings
    assert 'max_laser_range: 20.0' in settings  # what the bag asks for

    assert main(['report', str(folder)]) == 0
    assert str(folder.resolve() / 'report.html') in capsys.readouterr().out


@pytest.mark.parametrize(
    ('options', 'words'),
    [
        (['--set', 'resolution'], 'expected NAME=VALUE'),
        (['--set', 'resolutoin=0.1'], "did you mean 'resolution'"),
        (['--start', 'robot1=1,2'], 'VEHICLE=X,Y,THETA'),
        (['--start', 'robot7=1,2,3'], 'robot7'),
        (['--start', 'robot7=unknown'], 'robot7'),
        (['--start', '=unknown'], 'VEHICLE=unknown'),
        (['--vehicles', 'robot7'], 'robot7'),
        (['--threads', '0'], '--threads is 0'),
        (['--config', 'absent.yaml'], 'absent.yaml'),
    ],
)
def test_wrong_options_are_one_line_and_exit_code_1(data_set, tmp_path, capsys, options, words):
    bag = tmp_path / 'bag'
    main(['import', 'intel', str(data_set), str(bag)])
    capsys.readouterr()
    assert main(['replay', str(bag), '--out', str(tmp_path / 'runs'), *options]) == 1
    error = capsys.readouterr().err
    assert words in error
    assert error.count('\n') == 1
    assert not (tmp_path / 'runs').exists()


def test_a_bag_and_a_run_that_are_absent_are_named(tmp_path, capsys):
    assert main(['replay', str(tmp_path / 'absent')]) == 1
    assert 'absent does not exist' in capsys.readouterr().err
    assert main(['report', str(tmp_path)]) == 1
    assert 'metrics.json cannot be read' in capsys.readouterr().err
