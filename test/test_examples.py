"""Every example runs, prints what it promises, and imports nothing but the public API."""

import ast
import importlib
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from synthetic import SyntheticVehicle, SyntheticWorld

from explore_slam.geometry import Pose2
from explore_slam.mapping import load_map
from explore_slam.messages.topics import TopicKind
from explore_slam.recording.bag import BagWriter
from explore_slam.recording.events import Event, odometry_event, start_event, write_event

REPOSITORY = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((REPOSITORY / 'examples').glob('*.py'))
EXECUTED = {
    'two_robots.py', 'occupancy_grid.py', 'frontiers_and_plan.py', 'replay_bag.py',
    'drive_path.py',
}  # fmt: skip
# modules of the package's root; packages count where the name imported is in their __all__
ROOT_MODULES = {'explore_slam.data', 'explore_slam.geometry', 'explore_slam.settings'}


def run(name, folder, *arguments, warning=''):
    """Run an example in a folder of its own; return what it printed.

    warning: how the only line that it logs begins. Default: it logs none.
    """
    done = subprocess.run(
        [sys.executable, str(REPOSITORY / 'examples' / name), *map(str, arguments)],
        cwd=folder,
        env={**os.environ, 'PYTHONPATH': str(REPOSITORY), 'MUJOCO_GL': 'egl'},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(done.stderr.splitlines()) == bool(warning), done.stderr
    assert done.stderr.startswith(warning)
    return done.stdout


def number(pattern, text):
    """Return the one number that a pattern finds."""
    found = re.search(pattern, text)
    assert found, text
    return float(found[1])


@pytest.mark.parametrize('path', EXAMPLES, ids=lambda path: path.name)
def test_only_the_public_api_is_used(path):
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        assert not [name for name in modules if name.startswith('explore_slam')], path.name
        if isinstance(node, ast.ImportFrom) and node.module.startswith('explore_slam'):
            names = {alias.name for alias in node.names}
            module = importlib.import_module(node.module)
            if node.module in ROOT_MODULES:
                assert all(hasattr(module, name) for name in names)
            else:
                assert names <= set(module.__all__), f'{path.name}: {node.module}'


def test_every_example_is_executed_below():
    assert {path.name for path in EXAMPLES} == EXECUTED


def test_two_robots(tmp_path):
    printed = run('two_robots.py', tmp_path)
    for robot in ('robot1', 'robot2'):
        estimated = number(rf'{robot}: .* error ([\d.]+) m', printed)
        odometry = number(rf'{robot}: .* .odometry alone ([\d.]+) m', printed)
        assert estimated < 0.05 < odometry
    # one observation in some thousand is too far off to be matched and becomes a landmark
    assert 60 <= number(r'(\d+) landmarks in the common map', printed) <= 63


def test_occupancy_grid(tmp_path):
    printed = run('occupancy_grid.py', tmp_path, '--output', 'room')
    grid = load_map(tmp_path / 'room.yaml')
    assert number(r'([\d.]+) m² free', printed) == pytest.approx(8 * 6 - 0.785, abs=2.5)
    row, col = grid.to_cell([[0.49, 0.0]])[0]  # the near side of the pillar
    assert grid.probability()[row, col] > 0.65
    row, col = grid.to_cell([[2.0, 0.0]])[0]
    assert grid.probability()[row, col] < 0.2


def test_frontiers_and_plan(tmp_path):
    printed = run('frontiers_and_plan.py', tmp_path)
    goals = dict(re.findall(r'(robot\d) drives [\d.]+ m to \(([\d.]+)', printed))
    assert float(goals['robot1']) < 4.0  # one to the left end, the other to the right
    assert float(goals['robot2']) > 8.0


@pytest.fixture
def small_bag(tmp_path):
    """A recording of one vehicle on a circle: odometry, scans and landmarks for 12 s."""
    vehicle = SyntheticVehicle(SyntheticWorld(), Pose2(0.0, -1.6, 0.0))
    with BagWriter(tmp_path / 'bag') as bag:
        write_event(bag, start_event('robot1', 0.0, vehicle.start))
        for step in range(120):
            reading = vehicle.advance()
            write_event(bag, odometry_event('robot1', reading.stamp, reading.pose))
            if step % 2 == 0:
                scan = vehicle.scan()
                write_event(bag, Event(scan.stamp, 'robot1', TopicKind.SCAN, scan))
            if step % 5 == 0:
                seen = vehicle.landmarks()
                write_event(bag, Event(seen.stamp, 'robot1', TopicKind.LANDMARKS, seen))
    return tmp_path / 'bag', vehicle.pose


def test_replay_bag(tmp_path, small_bag):
    bag, end = small_bag
    printed = run('replay_bag.py', tmp_path, bag, warning='robot1: no transform leads from')
    assert number(r'(\d+) messages of robot1/odom', printed) == 120
    ended = re.search(r'ended at \(([-\d.]+), ([-\d.]+),', printed)
    assert float(ended[1]) == pytest.approx(end.x, abs=0.1)
    assert float(ended[2]) == pytest.approx(end.y, abs=0.1)
    assert number(r'map of ([\d.]+) m²', printed) > 40.0  # most of the room of 8 x 8 m


def test_drive_path(tmp_path):
    printed = run('drive_path.py', tmp_path)
    assert printed.splitlines()[-1].startswith('arrived after')
    assert number(r'([\d.]+) m from the goal, 0 collisions', printed) < 0.4
