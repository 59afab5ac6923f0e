import os
import signal
import subprocess
import sys

import pytest

RAISES = """
import sys
from rclpy.node import Node
from explore_slam.nodes.node_support import run_node

class Faulty(Node):
    def __init__(self):
        super().__init__('faulty')
        self.create_timer(0.05, self.fail)
    def fail(self):
        raise RuntimeError('a bug')
    def stop(self):
        print('at rest', flush=True)

sys.exit(run_node(Faulty))
"""


IN_C = """
import ctypes, os, signal, time
from explore_slam.nodes import node_support

node_support._end_signals.install()
called_from_c = ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), signal.SIGINT))
with node_support.interruptible():
    print('compiling')
    called_from_c()  # where an exception would be lost
    time.sleep(60.0)
"""


HALF_BUILT = """
import sys
from rclpy.node import Node
from explore_slam.errors import ConfigError
from explore_slam.nodes.node_support import run_node

class HalfBuilt(Node):
    def __init__(self):
        super().__init__('half_built')
        self.create_timer(0.05, self.tick)
        raise ConfigError('a mistake')
    def tick(self):
        pass
    def destroy_node(self):
        raise AssertionError('was not built')
    def __del__(self):
        print('released', flush=True)

code = run_node(HalfBuilt)
print('end', flush=True)
sys.exit(code)
"""

HANGS = """
import sys
import threading
from rclpy.node import Node
from explore_slam.nodes import node_support

class Hanging(Node):
    def __init__(self):
        super().__init__('hanging')
        self.create_timer(0.05, self.fail)
    def fail(self):
        raise RuntimeError('a bug')
    def stop(self):
        threading.Thread(target=self.wait_for_ever).start()
    def wait_for_ever(self):
        threading.Event().wait()

node_support._END_TIMEOUT = 1.0
sys.exit(node_support.run_node(Hanging))
"""


def run(*arguments):
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_an_exception_in_a_callback_stops_the_vehicle_first():
    result = run('-c', RAISES)
    assert result.returncode == 1
    assert 'at rest' in result.stdout
    assert 'stopping the vehicle: RuntimeError: a bug' in result.stderr


def test_a_node_that_could_not_be_built_is_released_before_the_process_ends():
    result = run('-c', HALF_BUILT)
    assert result.returncode == 1
    assert result.stdout.split() == ['released', 'end']
    assert result.stderr.strip() == 'a mistake'


def test_a_process_that_does_not_end_says_where_it_is_and_ends():
    result = run('-c', HANGS)
    assert result.returncode == 1
    assert 'Timeout (0:00:01)' in result.stderr
    assert 'in wait_for_ever' in result.stderr


def test_a_signal_in_a_callback_from_c_ends_the_process_at_once():
    result = run('-c', IN_C)
    assert (result.returncode, result.stdout, result.stderr) == (0, 'compiling\n', '')


def test_ctrl_c_ends_the_first_start_while_kernels_are_compiled(tmp_path):
    process = subprocess.Popen(
        [sys.executable, '-m', 'explore_slam.nodes.executables', 'agent_node'],
        env={**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path)},
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        line = process.stderr.readline()
        assert 'compiling kernels (once, about a minute) ...' in line
        process.send_signal(signal.SIGINT)
        _, rest = process.communicate(timeout=30)
    finally:
        process.kill()
        process.wait()
    assert rest == ''  # neither the kernels that would have followed nor a traceback
    assert process.returncode == 0


@pytest.mark.parametrize(
    ('module', 'setting', 'text'),
    [
        ('pioneer_driver', 'laser_angle:=120', 'laser_angle and laser_resolution'),
        ('pioneer_driver', 'command_timeout:=30.0', 'command_timeout'),
        ('path_follower', 'follow_speed:=fast', "follow_speed is 'fast', expected a number"),
        ('path_follower', 'laser_x:=11.0', 'laser_x'),
        ('path_follower', "laser_mount:=['a','b','c']", 'laser_mount is'),
        ('path_follower', 'no_value', "Couldn't parse parameter override rule: '-p no_value'"),
    ],
)
def test_a_parameter_that_cannot_be_is_one_clear_message(module, setting, text):
    result = run('-m', 'explore_slam.nodes.executables', module, '--ros-args', '-p', setting)
    assert result.returncode == 1
    assert text in result.stderr
    assert 'Traceback' not in result.stderr


@pytest.mark.parametrize(
    ('arguments', 'text'),
    [
        (['-r', 'scan:=my scan'], "Couldn't parse remap rule: '-r scan:=my scan'"),
        (['--params-file', '/no/file.yaml'], "params file: '--params-file /no/file.yaml'"),
        (['--no-such-option'], '--no-such-option'),
    ],
)
def test_arguments_of_ros_that_cannot_be_read_are_one_message(arguments, text):
    result = run('-m', 'explore_slam.nodes.executables', 'path_follower', '--ros-args', *arguments)
    assert result.returncode == 1
    (line,) = [line for line in result.stderr.splitlines() if 'ROS cannot start' in line]
    assert text in line
    assert 'Traceback' not in result.stderr
