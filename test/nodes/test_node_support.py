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


@pytest.mark.parametrize(
    ('module', 'setting', 'text'),
    [
        ('pioneer_driver', 'laser_angle:=120', 'laser_angle and laser_resolution'),
        ('pioneer_driver', 'command_timeout:=30.0', 'command_timeout'),
        ('path_follower', 'follow_speed:=fast', "follow_speed is 'fast', expected float"),
        ('path_follower', 'laser_x:=11.0', 'laser_x'),
    ],
)
def test_a_parameter_that_cannot_be_is_one_clear_message(module, setting, text):
    result = run('-m', f'explore_slam.nodes.{module}', '--ros-args', '-p', setting)
    assert result.returncode == 1
    assert text in result.stderr
    assert 'Traceback' not in result.stderr
