"""Run folders: files in common formats, and metrics of runs with known errors."""

import json
from datetime import UTC, datetime

import numpy as np
import pytest

from explore_slam.agent.config import AgentConfig
from explore_slam.errors import EvaluationError
from explore_slam.geometry import Pose2
from explore_slam.mapping import load_map
from explore_slam.results import RunFolder, RunRecorder, load_tum
from explore_slam.settings import load_settings, values_of, with_values

STARTS = {'robot1': Pose2(1.0, 0.0, 0.5), 'robot2': Pose2(0.0, 2.0, 0.0)}


def test_metrics_of_a_run_with_known_errors(some_run):
    metrics = some_run().metrics
    assert metrics['mean_online_position_rms'] == pytest.approx(0.05)
    assert metrics['mean_online_heading_rms'] == pytest.approx(0.02)
    assert metrics['mean_estimated_position_rms'] == pytest.approx(0.0, abs=1e-9)
    robot = metrics['vehicles']['robot2']
    # errors of one standard deviation in each coordinate
    assert robot['online']['pose_nees_mean'] == pytest.approx(3.0)
    assert robot['online']['position_nees_mean'] == pytest.approx(2.0)
    assert robot['online']['position_in_95'] == 1.0
    assert robot['distance'] == pytest.approx(5.0)
    assert robot['duration'] == pytest.approx(10.0)
    # odometry is 10 % too long: its error grows evenly to 0.5 m, RMS 0.5 / sqrt(3)
    assert robot['odometry']['position_rms'] == pytest.approx(0.5 / np.sqrt(3), rel=0.02)
    assert robot['odometry']['position_max'] == pytest.approx(0.5)
    assert metrics['coverage'] == pytest.approx(0.98)
    assert metrics['collisions'] == 0
    assert metrics['landmarks'] == 5


def test_a_run_without_truth_has_distances_but_no_errors():
    recorder = RunRecorder('a run', STARTS)
    for index in range(5):
        recorder.add_pose('robot1', 1.0 + index, Pose2(0.5 * index, 0.0, 0.0))
    metrics = recorder.finish({}).metrics
    assert metrics['vehicles']['robot1'] == {'distance': 2.0, 'duration': 4.0}
    assert 'mean_online_position_rms' not in metrics


def test_the_folder_holds_everything_in_formats_that_others_read(some_run, tmp_path):
    data = some_run(ratio=float('nan'), count=np.int64(3), nested={'a': np.float32(0.5)})
    folder = RunFolder.create(tmp_path)
    report = folder.write_run(data)
    names = {path.name for path in folder.path.iterdir()}
    assert names == {
        'map.pgm',
        'map.yaml',
        'landmarks.ply',
        'settings.yaml',
        'metrics.json',
        'report.html',
        *(
            f'robot{number}_{kind}.tum'
            for number in (1, 2)
            for kind in ('estimated', 'online', 'true', 'odometry')
        ),
    }
    assert report == folder.path / 'report.html'
    metrics = json.loads((folder.path / 'metrics.json').read_text())
    assert (metrics['ratio'], metrics['count'], metrics['nested']) == (None, 3, {'a': 0.5})
    assert load_map(folder.path / 'map.yaml').known().any()
    again = load_settings(
        with_values(AgentConfig(), {'particles': 7}), folder.path / 'settings.yaml'
    )
    assert values_of(again) == values_of(AgentConfig())
    true = load_tum(folder.path / 'robot1_true.tum')
    assert true.poses[0] == pytest.approx(STARTS['robot1'], abs=1e-6)
    odometry = load_tum(folder.path / 'robot1_odometry.tum')
    assert odometry.poses[0] == pytest.approx(STARTS['robot1'], abs=1e-6)


def test_landmarks_are_a_ply_cloud(landmarks, tmp_path):
    folder = RunFolder.create(tmp_path)
    content = folder.write_landmarks(landmarks(3)).read_bytes()
    header, _, body = content.partition(b'end_header\n')
    assert header.startswith(b'ply\nformat binary_little_endian 1.0\n')
    assert b'element vertex 3\n' in header
    table = np.frombuffer(body, '<f4, <f4, <f4, <f4, <u4')
    assert [tuple(row)[:3] for row in table.tolist()] == [(0, 1, 2), (3, 4, 5), (6, 7, 8)]
    assert table['f3'] == pytest.approx(np.full(3, 0.3))
    assert table['f4'].tolist() == [0, 1, 2]
    folder.write_landmarks(landmarks(0))


def test_latest_points_to_the_newest_and_names_never_clash(tmp_path):
    now = datetime(2030, 1, 2, 3, 4, 5, tzinfo=UTC)
    first, second = RunFolder.create(tmp_path, now), RunFolder.create(tmp_path, now)
    assert (first.path.name, second.path.name) == ('2030-01-02_03-04-05', '2030-01-02_03-04-05_2')
    assert (tmp_path / 'latest').resolve() == second.path.resolve()


def test_a_folder_named_latest_is_left_alone(tmp_path):
    (tmp_path / 'latest').mkdir()
    (tmp_path / 'latest' / 'mine').touch()
    RunFolder.create(tmp_path)
    assert (tmp_path / 'latest' / 'mine').exists()


def test_bad_input_is_named(tmp_path):
    (tmp_path / 'file').touch()
    with pytest.raises(EvaluationError, match='file'):
        RunFolder.create(tmp_path / 'file')
    folder = RunFolder.create(tmp_path / 'runs')
    with pytest.raises(EvaluationError, match="'guessed'"):
        folder.write_trajectory('robot1', 'guessed', [], [])


def test_names_with_slashes_stay_inside_the_folder(tmp_path):
    folder = RunFolder.create(tmp_path)
    path = folder.write_trajectory('/fleet/../robot1', 'true', [1.0], [[0, 0, 0]])
    assert path.parent == folder.path


def test_a_write_that_fails_leaves_nothing_half_done(tmp_path):
    folder = RunFolder.create(tmp_path)
    with pytest.raises(EvaluationError):
        folder.write_trajectory('robot1', 'true', [1.0, 2.0], [[0, 0, 0]])
    assert list(folder.path.iterdir()) == []
