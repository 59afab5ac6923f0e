"""Shells that are set up for something else: what is used of them, and what is not."""

import ctypes
import logging
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from explore_slam import environment
from explore_slam.environment import (
    MIDDLEWARE,
    SEARCH_PATHS,
    domain_of,
    is_writable,
    isolated,
    one_machine,
    prepare_libraries,
    prepare_ros,
    ros_log_folder,
    scratch_folder,
)
from explore_slam.errors import MachineError
from explore_slam.live.processes import config_folder

REPOSITORY = Path(__file__).resolve().parents[1]
DOMAIN = 'ROS_DOMAIN_ID'
NOT_A_FOLDER = '/proc/none'  # root, too, can make nothing there
FOREIGN = {
    'RMW_IMPLEMENTATION': 'rmw_cyclonedds_cpp',
    'ROS_DISCOVERY_SERVER': '127.0.0.1:11811',
    'ROS_AUTOMATIC_DISCOVERY_RANGE': 'OFF',
    'ROS_LOCALHOST_ONLY': '1',
    'ROS_SECURITY_ENABLE': 'true',
    'ROS_SECURITY_STRATEGY': 'Enforce',
    'CYCLONEDDS_URI': 'file:///none.xml',
    'FASTRTPS_DEFAULT_PROFILES_FILE': '/none.xml',
    'FASTDDS_BUILTIN_TRANSPORTS': 'TCP',
    DOMAIN: 'seven',  # unusable, so that no domain is shared with another test
    'MUJOCO_GL': 'glfw',
    'HOME': NOT_A_FOLDER,
}
TALK = """
import os
from pathlib import Path
from explore_slam.live.processes import use_one_machine
use_one_machine(Path(os.environ['LOGS']))
import rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node('talker')
heard = []
node.create_subscription(String, 'words', lambda message: heard.append(message.data), 10)
publisher = node.create_publisher(String, 'words', 10)
for _ in range(100):
    publisher.publish(String(data='hello'))
    rclpy.spin_once(node, timeout_sec=0.1)
    if heard:
        break
print(heard[0], rclpy.get_rmw_implementation_identifier(), os.environ['MUJOCO_GL'])
"""


def test_nodes_of_one_machine_talk_in_a_foreign_shell(tmp_path):
    done = subprocess.run(
        [sys.executable, '-c', TALK],
        env={**os.environ, **FOREIGN, 'LOGS': str(tmp_path / 'logs')},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.stdout.split() == ['hello', 'rmw_fastrtps_cpp', 'egl'], done.stderr
    assert any((tmp_path / 'logs').iterdir())  # of ROS


def test_what_is_not_used_is_named_once(caplog, tmp_path):
    given = {**FOREIGN, 'ROS_LOG_DIR': str(tmp_path), 'PATH': '/bin'}
    with caplog.at_level(logging.WARNING):
        used = one_machine(given, config_folder() / 'fastdds_one_machine.xml')
        assert one_machine(used, config_folder() / 'fastdds_one_machine.xml') == used
    (record,) = caplog.records
    for name in sorted(set(FOREIGN) - {'HOME'}):
        assert f'{name}={FOREIGN[name]}' in record.message
        assert used.get(name) != FOREIGN[name]
    assert used['PATH'] == '/bin'
    assert used['ROS_LOG_DIR'] == str(tmp_path)


@pytest.mark.parametrize(
    ('text', 'domain'),
    [
        ('0', 0), ('232', 232), (' 7 ', 7), ('233', None), ('-1', None), ('abc', None),
        ('', None), ('4.5', None), ('٣', None),
    ],
)  # fmt: skip
def test_domains(text, domain):
    assert domain_of({'ROS_DOMAIN_ID': text}) == domain
    used = one_machine({'ROS_DOMAIN_ID': text}, Path('profile.xml'), Path('logs'))
    own = 1 + os.getpid() % 100
    assert used['ROS_DOMAIN_ID'] == str(own if domain is None else domain)


@pytest.mark.parametrize(
    ('name', 'value'),
    [('RMW_IMPLEMENTATION', 'rmw_none_cpp'), ('ROS_DOMAIN_ID', '300'), ('ROS_DOMAIN_ID', 'x')],
)
def test_a_node_says_what_of_its_shell_it_cannot_use(name, value):
    with pytest.raises(MachineError, match=f"{name} is '{value}'"):
        prepare_ros({name: value, 'HOME': str(REPOSITORY)})
    done = subprocess.run(
        [sys.executable, '-m', 'explore_slam.nodes.executables', 'path_follower'],
        env={**os.environ, name: value},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 1
    assert done.stdout == ''
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"path_follower: {name} is '{value}'")


def test_folders_of_a_home_that_cannot_be_written(caplog, tmp_path):
    shell = {'HOME': NOT_A_FOLDER}
    with caplog.at_level(logging.WARNING):
        prepare_ros(shell)
        prepare_libraries(shell)
    assert is_writable(Path(shell['ROS_LOG_DIR']))
    assert is_writable(Path(shell['MPLCONFIGDIR']))
    assert f'{NOT_A_FOLDER}/.ros/log cannot be written' in caplog.text
    assert ros_log_folder({'HOME': NOT_A_FOLDER, 'ROS_LOG_DIR': str(tmp_path)}) is None
    assert ros_log_folder({'ROS_HOME': str(tmp_path)}) is None
    assert (tmp_path / 'log').is_dir()
    usable = {'HOME': str(tmp_path), 'MPLBACKEND': 'a window'}
    prepare_libraries(usable)
    assert usable == {'HOME': str(tmp_path), 'MPLBACKEND': 'agg'}


# Large arrays with small ones between them that stay: what is kept of what the large ones took.
FREED = """
import numpy as np
from explore_slam.environment import return_large_arrays
from explore_slam.studies.endurance_study import resident_memory
if {called}:
    return_large_arrays()
np.ones(2**21)  # freed: from now on, arrays up to 16 MiB come from the heap
before, small, large = resident_memory(), [], []
for _ in range(30):
    large.append(np.ones(2**18))
    small.append(np.ones(2**13))
large.clear()
print(resident_memory() - before - 30 * 2**16 / 2**20)
"""


def test_the_memory_of_large_arrays_goes_back_to_the_system():
    kept = {
        called: float(
            subprocess.run(
                [sys.executable, '-c', FREED.format(called=called)],
                check=True, capture_output=True, text=True, cwd=REPOSITORY,
            ).stdout
        )
        for called in (False, True)
    }  # fmt: skip
    if hasattr(ctypes.CDLL(None), 'mallopt'):
        assert kept[False] > 40.0  # of 60 MiB
    assert kept[True] < 5.0


def test_the_scratch_folder_of_another_user_is_not_used(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    own = scratch_folder()
    assert own == scratch_folder() == tmp_path / f'explore_slam_{os.getuid()}'
    own.chmod(0o777)  # others could put code there
    assert scratch_folder() != own
    own.rmdir()
    own.symlink_to(REPOSITORY)
    assert scratch_folder() not in (own, REPOSITORY)


def test_folders_of_another_ros_are_left_out_of_the_search_paths(tmp_path):
    prefix, other, plain = (tmp_path / name for name in ('venv', 'humble', 'cuda'))
    for folder in (prefix / 'lib', other / 'lib'):
        folder.mkdir(parents=True)
        (folder / 'librcl.so').touch()
    (other / 'share' / 'ament_index').mkdir(parents=True)
    plain.mkdir()
    own = str(Path(environment.__file__).parents[1])
    given = {
        'PYTHONPATH': f'{other}/lib/python3.10/site-packages::{own}',
        'LD_LIBRARY_PATH': f'{other}/lib:{plain}:{prefix}/lib',
        'AMENT_PREFIX_PATH': str(other),
        '_ROS_WHEELS_BOOTSTRAP_COMPLETE': '1',
    }
    used = isolated(given, prefix)
    assert used == {'PYTHONPATH': own, 'LD_LIBRARY_PATH': f'{plain}:{prefix}/lib'}
    again = {**used, '_ROS_WHEELS_BOOTSTRAP_COMPLETE': '1'}
    assert isolated(again, prefix) == again


def test_a_command_does_not_import_another_ros(tmp_path):
    if not (Path(os.__file__).parents[2]).exists() or sys.prefix == sys.base_prefix:
        pytest.skip('ROS does not come from a virtual environment')
    for name in ('numpy', 'rclpy', 'yaml'):
        (tmp_path / f'{name}.py').write_text(f'raise ImportError("{name} of Python 3.10")')
    path = f'{tmp_path}{os.pathsep}{os.environ.get("PYTHONPATH", "")}'
    done = subprocess.run(
        [sys.executable, '-m', 'explore_slam.cli.main', 'settings', 'driver'],
        env={**os.environ, 'PYTHONPATH': path},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert 'ros__parameters' in done.stdout
    (line,) = done.stderr.splitlines()
    assert line.startswith(f'not used, ROS is in {sys.prefix}: PYTHONPATH={tmp_path}')


def test_make_clears_what_the_table_names(tmp_path):
    """Ask make what a command of a recipe sees, of a shell in which all of it is set."""
    names = [*SEARCH_PATHS, *MIDDLEWARE]
    makefile = tmp_path / 'Makefile'
    makefile.write_text('include Makefile\nshow:\n\t@env\n')
    done = subprocess.run(
        ['make', '-f', makefile, 'show', f'VENV={tmp_path}/none'],
        cwd=REPOSITORY,
        env={'PATH': os.environ['PATH'], 'PIP_USER': '1', **dict.fromkeys(names, '/x')},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    seen = dict(line.partition('=')[::2] for line in done.stdout.splitlines())
    assert seen['PIP_USER'] == '0'
    assert seen.keys().isdisjoint(names)


def test_make_names_the_distributions_it_has():
    done = subprocess.run(
        ['make', '-n', 'ROS=humble', 'setup'],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2
    assert "ROS is 'humble', expected one of: jazzy kilted" in done.stderr


def test_a_virtual_environment_that_does_not_work_is_named(tmp_path):
    def why(folder):
        tool = REPOSITORY / 'tools' / 'why_stale'
        return subprocess.run(
            [tool, folder], capture_output=True, text=True, timeout=60, check=True
        ).stdout.strip()

    assert why(tmp_path / 'none') == ''
    venv = tmp_path / 'clone' / '.venv'
    subprocess.run([sys.executable, '-m', 'venv', '--without-pip', venv], check=True, timeout=60)
    (next(venv.glob('lib/python3*/site-packages')) / 'pip.py').touch()
    assert why(venv) == ''
    moved = venv.parent.rename(tmp_path / 'moved') / '.venv'
    assert why(moved) == f'it was made as {venv}'
    moved.parent.rename(venv.parent)
    (venv / 'bin' / 'python').unlink()
    (venv / 'bin' / 'python').symlink_to('/usr/lib/python-that-is-gone')
    assert why(venv) == 'its Python does not run'
