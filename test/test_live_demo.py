"""The main job, shortened: two vehicles explore a small world over real DDS, to the end."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from ros_domain import own_domain

COMMAND = [sys.executable, '-m', 'explore_slam.cli.main', 'demo', '--world', 'small']

# a shell that is set up for something else, in a container without a home
FOREIGN = {
    'RMW_IMPLEMENTATION': 'rmw_cyclonedds_cpp',
    'ROS_DISCOVERY_SERVER': '127.0.0.1:11811',
    'ROS_AUTOMATIC_DISCOVERY_RANGE': 'OFF',
    'ROS_LOCALHOST_ONLY': '1',
    'CYCLONEDDS_URI': 'file:///none.xml',
    'FASTRTPS_DEFAULT_PROFILES_FILE': '/none.xml',
    'MPLBACKEND': 'none',
    'MUJOCO_GL': 'glfw',
    'HOME': '/proc/none',
}


def environment(domain):
    return {**os.environ, **FOREIGN, 'ROS_DOMAIN_ID': str(domain)}


@pytest.fixture(scope='module')
def finished(tmp_path_factory):
    """The run folder of a demo that ran to its end, and what it printed."""
    runs = tmp_path_factory.mktemp('runs')
    command = [*COMMAND, '--out', str(runs), '--record', '--wall-time-limit', '300']
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=420,
        env=environment(own_domain(64)),
        check=False,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr
    return runs / 'latest', done.stdout


def test_everything_is_explored_without_collision(finished):
    folder, _ = finished
    metrics = json.loads((folder / 'metrics.json').read_text())
    assert metrics['status'] == 'exploration_complete'
    assert metrics['coverage'] >= 0.98
    assert metrics['collisions'] == {'robot1': 0, 'robot2': 0}


def test_poses_are_right_and_better_than_odometry(finished):
    folder, _ = finished
    metrics = json.loads((folder / 'metrics.json').read_text())
    assert metrics['mean_online_position_rms'] < 0.06
    assert metrics['mean_online_heading_rms'] < metrics['mean_odometry_heading_rms']


def test_the_folder_holds_what_people_need(finished):
    folder, printed = finished
    names = {path.name for path in folder.iterdir()}
    wanted = {'map.pgm', 'map.yaml', 'landmarks.ply', 'settings.yaml', 'metrics.json'}
    wanted |= {f'robot{i}_{kind}.tum' for i in (1, 2) for kind in ('estimated', 'online', 'true')}
    assert wanted | {'report.html', 'bag', 'logs'} <= names
    path = np.loadtxt(folder / 'robot1_online.tum')
    assert path.shape[1] == 8
    assert (np.diff(path[:, 0]) >= 0.0).all()
    assert 'explored' in printed
    assert 'robot2' in printed
    assert 'image to pose' in printed


def test_its_recording_replays_to_the_same_accuracy(finished, tmp_path):
    folder, _ = finished
    command = [sys.executable, '-m', 'explore_slam.cli.main', 'replay', str(folder / 'bag')]
    command += ['--out', str(tmp_path), '--no-progress', '--config', 'config/agent.yaml']
    repository = Path(__file__).resolve().parents[1]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=300, cwd=repository, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    metrics = json.loads((tmp_path / 'latest' / 'metrics.json').read_text())
    assert metrics['mean_online_position_rms'] < 0.06


def _heed_interrupts():
    """As in a terminal, also where the tests run in the background, whose shell ignores them."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def test_ctrl_c_ends_everything_and_leaves_the_folder(tmp_path):
    command = [*COMMAND, '--out', str(tmp_path)]
    demo = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        text=True,
        env=environment(own_domain(65)),
        preexec_fn=_heed_interrupts,  # noqa: PLW1509 -- a single system call
    )
    try:
        deadline = time.monotonic() + 120.0
        for line in demo.stdout:
            assert time.monotonic() < deadline, 'no pose came'
            if 'keyframes/s' in line:
                break
        demo.send_signal(signal.SIGINT)
        rest = demo.stdout.read()
        assert demo.wait(timeout=60.0) == 130
    finally:
        demo.kill()
        demo.stdout.close()
    assert 'interrupted: stopping all nodes' in rest
    assert (tmp_path / 'latest' / 'metrics.json').exists()
    mine = str(tmp_path)
    left = [path for path in Path('/proc').glob('[0-9]*/cmdline') if mine in read(path)]
    assert not left


def read(path):
    try:
        return path.read_text()
    except OSError:
        return ''


def test_mistakes_get_one_line(tmp_path):
    # MuJoCo, imported by other tests, sets it in this process; the demo would name it
    inherited = {k: v for k, v in os.environ.items() if k != 'PYOPENGL_PLATFORM'}
    for arguments, text in (
        (['--world', 'nowhere'], "no world 'nowhere'"),
        (['--vehicles', '9'], 'vehicles is 9, expected 1 to'),
        (['--set', 'particels=3'], "no setting 'particels'; did you mean 'particles'"),
    ):
        done = subprocess.run(
            [*COMMAND, '--out', str(tmp_path), *arguments],
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
            env=inherited,
        )
        assert done.returncode == 1
        assert text in done.stderr
        assert done.stderr.count('\n') == 1, done.stderr
