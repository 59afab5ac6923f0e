"""`colcon build` gives an installed package, and an installed executable starts."""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from ros_domain import default_domain

REPOSITORY = Path(__file__).resolve().parents[1]
EXECUTABLES = {
    'explore_slam', 'agent', 'pioneer_driver', 'path_follower', 'feature_extractor', 'simulator',
    'recorder', 'player',
}  # fmt: skip
COLCON = Path(sys.executable).with_name('colcon')


def run(command, **options):
    return subprocess.run(
        command, capture_output=True, text=True, timeout=240, check=False, **options
    )


# how ROS users build; with links, setup.py runs from a folder that has links to some files only
@pytest.fixture(scope='module', params=[[], ['--symlink-install']], ids=['copies', 'links'])
def installed(request, tmp_path_factory):
    """A workspace of its own with a copy of the tracked files, built."""
    if not COLCON.exists():
        pytest.skip('colcon is not installed: make setup-dev')
    workspace = tmp_path_factory.mktemp('workspace')
    source = workspace / 'src' / 'explore_slam'
    leave_out = shutil.ignore_patterns(
        '.git', '.venv*', 'runs', '*.egg-info', '__pycache__', '.*_cache', 'build', 'results'
    )
    shutil.copytree(REPOSITORY, source, ignore=leave_out)
    path = f'{COLCON.parent}{os.pathsep}{os.environ["PATH"]}'
    environment = {**os.environ, 'PATH': path}
    listed = run([COLCON, 'list'], cwd=workspace, env=environment)
    assert '(ros.ament_python)' in listed.stdout, listed.stdout + listed.stderr
    built = run([COLCON, 'build', *request.param], cwd=workspace, env=environment)
    assert built.returncode == 0, built.stdout + built.stderr
    return workspace / 'install' / 'explore_slam', environment


def test_executables_and_files_lie_where_ros2_looks(installed):
    prefix, _ = installed
    assert {path.name for path in (prefix / 'lib' / 'explore_slam').iterdir()} == EXECUTABLES
    share = prefix / 'share' / 'explore_slam'
    assert (share / 'package.xml').exists()
    for folder, pattern in (('launch', '*.launch.py'), ('config', '*.yaml')):
        wanted = {path.name for path in (REPOSITORY / folder).glob(pattern)}
        assert wanted == {path.name for path in (share / folder).glob(pattern)} != set()
    assert (share / 'config' / 'worlds' / 'office.yaml').exists()
    index = prefix / 'share' / 'ament_index' / 'resource_index' / 'packages' / 'explore_slam'
    assert index.exists()


def test_executables_run_under_the_python_of_the_shell(installed):
    """A colcon of another Python must not write its own interpreter into the scripts."""
    prefix, _ = installed
    for path in (prefix / 'lib' / 'explore_slam').iterdir():
        assert path.read_text().splitlines()[0] == '#!/usr/bin/env python3', path.name


def test_an_installed_executable_starts(installed):
    prefix, environment = installed
    command = f'source {prefix}/share/explore_slam/package.bash; '
    command += f'exec {prefix}/lib/explore_slam/explore_slam --help'
    shown = run(['bash', '-c', command], cwd=prefix, env=environment)
    assert shown.returncode == 0, shown.stderr
    assert 'demo' in shown.stdout


def test_an_installed_node_starts_and_ends_when_asked(installed):
    prefix, environment = installed
    command = f'source {prefix}/share/explore_slam/package.bash; '
    command += f'exec {prefix}/lib/explore_slam/path_follower --ros-args -r __ns:=/robot1'
    heard = []
    context = rclpy.Context()
    context.init(domain_id=default_domain())
    listener = rclpy.create_node('listener', context=context)
    listener.create_subscription(DiagnosticStatus, '/robot1/follower_status', heard.append, 10)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(listener)
    node = subprocess.Popen(
        ['bash', '-c', command], cwd=prefix, env=environment, stderr=subprocess.PIPE, text=True
    )
    try:
        end = time.monotonic() + 60.0
        while not heard:
            assert node.poll() is None, node.stderr.read()
            assert time.monotonic() < end
            executor.spin_once(timeout_sec=0.1)
        node.terminate()
        assert node.wait(timeout=20.0) == 0
    finally:
        node.kill()
        node.stderr.close()
        listener.destroy_node()
        context.try_shutdown()


@pytest.mark.parametrize(
    ('module', 'needed'),
    [
        ('path_follower', set()),
        ('pioneer_driver', set()),
        ('feature_extractor', {'numba'}),
        ('agent_node', {'numba'}),
        ('recorder', {'rosbags'}),
        ('player', {'rosbags'}),
    ],
)
def test_nodes_need_from_pip_what_the_readme_says(module, needed):
    """What apt does not have; see the section On robots of the README."""
    code = f'import sys, explore_slam.nodes.{module}; '
    code += "print(*{'numba', 'rosbags', 'mujoco', 'mcap'}.intersection(sys.modules))"
    done = run([sys.executable, '-c', code], env={**os.environ, 'PYTHONPATH': str(REPOSITORY)})
    assert done.returncode == 0, done.stderr
    assert set(done.stdout.split()) == needed
