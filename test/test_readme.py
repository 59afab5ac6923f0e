"""README and doc are right to the letter: code blocks run, commands parse, links resolve."""

import ast
import itertools
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml
from synthetic import SyntheticVehicle, SyntheticWorld

from explore_slam.battery import BatteryConfig
from explore_slam.cli.main import COMMANDS, build_parser
from explore_slam.geometry import Pose2
from explore_slam.messages.topics import TopicKind
from explore_slam.messages.vehicle_settings import settings_of_vehicles, split_vehicle_values
from explore_slam.nodes.agent_parameters import AgentNodeConfig
from explore_slam.nodes.driver_parameters import DriverNodeConfig
from explore_slam.recording.bag import BagWriter
from explore_slam.recording.events import Event, odometry_event, start_event, write_event
from explore_slam.settings import read_parameters, save_settings, values_of, with_values
from explore_slam.simulation.grid.scenario import load_scenario
from explore_slam.simulation.worlds.loading import load_grid_world
from explore_slam.tags import read_tags
from explore_slam.vehicle import PathFollowerConfig

REPOSITORY = Path(__file__).resolve().parents[1]
DOCUMENTS = [REPOSITORY / 'README.md', REPOSITORY / 'CONTRIBUTING.md']
DOCUMENTS += sorted((REPOSITORY / 'doc').glob('*.md'))
README = DOCUMENTS[0].read_text(encoding='utf-8')
# programs that a test must not run: they change the machine or need hardware
NOT_RUN = {'sudo', 'git', 'pip', 'python3', 'cd', 'cp', 'mkdir', 'dask', 'rosdep', 'udevadm'}
# stand for a package of the reader's own
PLACEHOLDERS = {'your_base', 'your_lidar'}
# of other packages: package, launch file or executable -> launch arguments or parameters
FOREIGN = {
    ('teleop_twist_joy', 'teleop-launch.py'): {'joy_config', 'joy_dev', 'joy_vel'},
    ('teleop_twist_keyboard', 'teleop_twist_keyboard'): {'stamped', 'frame_id'},
}


def blocks(path, language):
    """Code blocks of a document in one language."""
    text = path.read_text(encoding='utf-8')
    return re.findall(rf'^```{language}\n(.*?)^```$', text, re.MULTILINE | re.DOTALL)


def shell_lines(path):
    """Command lines of a document's shell blocks, without comments."""
    for block in blocks(path, 'sh'):
        for line in block.splitlines():
            words = shlex.split(line, comments=True)
            if words:
                yield line, words


LINES = [
    pytest.param(line, words, id=f'{path.name}:{line[:60]}')
    for path in DOCUMENTS
    for line, words in shell_lines(path)
]


def parse_command(words):
    """Parse a command line of explore_slam; a wrong option ends in SystemExit."""
    words = words[: words.index('>')] if '>' in words else words
    wanted = next((word for word in words if word in COMMANDS), None)
    assert wanted, words
    return build_parser(wanted).parse_args(words)


@pytest.mark.parametrize(('line', 'words'), LINES)
def test_shell_lines_name_what_exists(line, words):
    assert subprocess.run(['bash', '-n', '-c', line], check=False).returncode == 0
    program = Path(words[0]).name
    if program == 'explore_slam':
        arguments = parse_command(words[1:])
        for pair in getattr(arguments, 'set', []):
            assert pair.partition('=')[0] in values_of(AgentNodeConfig())
    elif program == 'make':
        done = subprocess.run(
            ['make', '-n', words[1]], cwd=REPOSITORY, capture_output=True, check=False
        )
        assert done.returncode == 0, done.stderr
    elif program == 'python':
        assert (REPOSITORY / words[1]).exists()
    elif program == 'ros2':
        check_ros2(words)
    else:
        assert program in NOT_RUN or '=' in words[0], line


def check_ros2(words):
    """Check that launch files, their arguments, executables and parameters exist."""
    kind, package = words[1], words[2]
    if tuple(words[2:4]) in FOREIGN:
        given = [
            word.partition(':=')[0]
            for before, word in itertools.pairwise(words[3:])
            if ':=' in word and before != '-r'
        ]
        assert set(given) <= FOREIGN[package, words[3]]
    elif kind == 'launch':
        assert package == 'explore_slam'
        text = (REPOSITORY / 'launch' / words[3]).read_text(encoding='utf-8')
        for word in words[4:]:
            assert f"'{word.partition(':=')[0]}'" in text, word
    elif kind == 'run' and package not in PLACEHOLDERS:
        assert package == 'explore_slam'
        setup = (REPOSITORY / 'setup.py').read_text(encoding='utf-8')
        assert f"'{words[3]} = explore_slam.nodes." in setup
    else:
        assert kind in ('run', 'service', 'param', 'topic')


@pytest.mark.parametrize('path', DOCUMENTS, ids=lambda path: path.name)
def test_links_lead_to_files(path):
    for target in re.findall(r'\]\(([^)#]+)', path.read_text(encoding='utf-8')):
        if not target.startswith('http'):
            assert (path.parent / target).exists(), f'{path.name}: {target}'


def test_commands_beside_the_figures_exist():
    rows = re.findall(r'^\|.*\| `([^`]+)`.* \|$', README[README.index('## Figures') :], re.M)
    assert len(rows) > 10
    for command in rows:
        words = shlex.split(command.replace('[', '').replace(']', ''))
        if words[0] == 'python':
            assert (REPOSITORY / words[1]).exists(), command
        elif words[0] == 'explore_slam':
            parse_command(words[1:])
        else:
            assert words[0] == 'make', command


def environment(**more):
    return {**os.environ, 'PYTHONPATH': str(REPOSITORY), **more}


def run_python(code, folder, typed=''):
    done = subprocess.run(
        [sys.executable, '-c', code],
        cwd=folder,
        env=environment(),
        input=typed,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_library_example_runs(tmp_path):
    (code,) = blocks(DOCUMENTS[0], 'python')
    assert run_python(code, tmp_path) == ('2 new landmarks; robot1 is 0.50 m ahead of its start\n')


def test_the_emulator_example_runs(tmp_path):
    (code,) = blocks(REPOSITORY / 'doc' / 'hardware.md', 'python')
    assert 'a Pioneer answers at' in run_python(code, tmp_path, typed='\n')


def test_every_python_block_is_run_above():
    counts = {path.name: len(blocks(path, 'python')) for path in DOCUMENTS}
    assert {name for name, count in counts.items() if count} == {'README.md', 'hardware.md'}
    for path in DOCUMENTS:
        for code in blocks(path, 'python'):
            ast.parse(code)


def test_every_scenario_is_one(tmp_path):
    found = [text for path in DOCUMENTS for text in blocks(path, 'yaml')]
    texts = [text for text in found if 'events:' in text]
    assert len(texts) == 1
    (tmp_path / 'scenario.yaml').write_text(texts[0])
    world = load_grid_world(REPOSITORY / 'config' / 'worlds' / 'office.yaml')
    scenario = load_scenario(tmp_path / 'scenario.yaml', world, ('robot1', 'robot2'))
    assert len(scenario.events) > 3


def test_every_list_of_tags_is_one(tmp_path):
    found = [text for path in DOCUMENTS for text in blocks(path, 'yaml')]
    texts = [text for text in found if 'family:' in text]
    assert len(texts) == 1
    (tmp_path / 'tags.yaml').write_text(texts[0])
    table, problems = read_tags(tmp_path / 'tags.yaml')
    assert not problems
    assert set(table.poses) == {7, 8}


def test_every_parameter_file_is_one(tmp_path):
    found = [text for path in DOCUMENTS for text in blocks(path, 'yaml')]
    texts = [text for text in found if 'ros__parameters' in text]
    assert len(texts) == 3
    made = []
    for text in texts:
        (tmp_path / 'agent.yaml').write_text(text)
        own, team = split_vehicle_values(read_parameters(tmp_path / 'agent.yaml'))
        config = with_values(AgentNodeConfig(), team)
        made.append(settings_of_vehicles(own, config.vehicles))
        assert list(config.poses()) == list(made[-1])
    differing, sensors, batteries = made
    assert [vehicle.vision for vehicle in differing.values()] == ['none', 'agent']
    assert differing['robot2'].laser_mount == pytest.approx((-0.1, 0.0, 3.1416))
    names = [topic.name for topic in sensors['robot1'].laser_topics]
    assert names == ['front/scan', 'rear/scan', 'velodyne_points']
    assert sensors['robot1'].laser_pose('rear/scan').x == -0.25
    assert [one.battery.battery_low for one in batteries.values()] == [11.5, 0.2]


@pytest.fixture
def workspace(tmp_path):
    """What a reader has after `make demo ARGS=--record`: the command, a run folder, a bag."""
    script = tmp_path / '.venv' / 'bin' / 'explore_slam'
    script.parent.mkdir(parents=True)
    script.write_text(f'#!/bin/sh\nexec {sys.executable} -m explore_slam.cli.main "$@"\n')
    script.chmod(0o755)
    folder = tmp_path / 'runs' / 'first'
    folder.mkdir(parents=True)
    (tmp_path / 'runs' / 'latest').symlink_to('first')
    save_settings(AgentNodeConfig(), folder / 'settings.yaml')
    vehicle = SyntheticVehicle(SyntheticWorld(), Pose2(0.0, -1.6, 0.0))
    with BagWriter(folder / 'bag') as bag:
        write_event(bag, start_event('robot1', 0.0, vehicle.start))
        for step in range(60):
            reading = vehicle.advance()
            write_event(bag, odometry_event('robot1', reading.stamp, reading.pose))
            if step % 5 == 0:
                seen = vehicle.landmarks()
                write_event(bag, Event(seen.stamp, 'robot1', TopicKind.LANDMARKS, seen))
    return tmp_path


def shell(script, folder):
    done = subprocess.run(
        ['bash', '-e', '-c', script],
        cwd=folder,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_recordings_block_runs_when_pasted(workspace):
    (block,) = (block for block in blocks(DOCUMENTS[0], 'sh') if 'RUN=' in block)
    lines = block.splitlines()
    # the others need other processes or a data set; tests of their own run them
    assert [line.split()[1] for line in lines[4:]] == [
        'play',
        'record',
        'import',
        'benchmark',
        'benchmark',
        'benchmark',
        'benchmark',
        'benchmark',
        'benchmark',
    ]
    printed = shell('\n'.join(lines[:4]), workspace)
    runs = [path for path in (workspace / 'runs').iterdir() if not path.is_symlink()]
    assert len(runs) == 3  # the first one and two replays
    assert printed.count('report:') == 2
    effective = (workspace / 'runs' / 'latest' / 'settings.yaml').read_text()
    assert 'particles: 100\n' in effective


def test_the_settings_block_runs_when_pasted(workspace):
    (block,) = (block for block in blocks(DOCUMENTS[0], 'sh') if 'settings agent' in block)
    shell(block, workspace)
    values = yaml.safe_load((workspace / 'agent.yaml').read_text())['/**']['ros__parameters']
    assert set(values) == set(values_of(AgentNodeConfig()))


def test_the_remapping_example_remaps(tmp_path):
    (line,) = (line for line in README.splitlines() if line.startswith('ros2 run explore_slam'))
    arguments = shlex.split(line)[3:]
    code = f"""
import rclpy
from explore_slam.nodes.agent_node import AgentNode
rclpy.init(args={arguments!r})
node = AgentNode()
print(node.resolve_topic_name('/robot1/scan'))
print(list(node.get_parameter('vehicles').value))
print([topic for topic, _ in node.get_topic_names_and_types() if topic.endswith('/scan')])
node.destroy_node()
rclpy.shutdown()
"""
    printed = run_python(code, tmp_path).splitlines()
    assert printed[-3:] == ['/front/scan', "['robot1']", "['/front/scan']"]


def test_every_topic_of_a_vehicle_is_in_the_table():
    table = README[README.index('### Topics and services') : README.index('## As a library')]
    for kind in TopicKind:
        plain = kind.value.removesuffix('/compressed').removesuffix('/compressedDepth')
        if kind is not TopicKind.GROUND_TRUTH:
            assert f'`<v>/{plain}`' in table, kind


def test_settings_named_for_safety_exist():
    text = (REPOSITORY / 'doc' / 'hardware.md').read_text(encoding='utf-8')
    table = text[text.index('## What stops the vehicle') : text.index('## Without hardware')]
    known = {*values_of(DriverNodeConfig()), *values_of(PathFollowerConfig())}
    known |= values_of(BatteryConfig()).keys()  # of the agent
    services_and_topics = {'enable_motors', 'cmd_vel'}
    named = set(re.findall(r'`(\w+)`', table)) - services_and_topics
    assert len(named) > 8
    assert named <= known


def test_citation_and_changelog_have_the_version_of_the_package():
    version = ElementTree.parse(REPOSITORY / 'package.xml').getroot().findtext('version')
    citation = yaml.safe_load((REPOSITORY / 'CITATION.cff').read_text(encoding='utf-8'))
    assert citation['version'] == version
    changelog = (REPOSITORY / 'CHANGELOG.rst').read_text(encoding='utf-8')
    newest = re.search(r'^(\d+\.\d+\.\d+) \((\d{4}-\d\d-\d\d)\)$', changelog, re.MULTILINE)
    assert newest, 'expected a dated entry, e.g. 0.1.0 (2026-11-28)'
    assert newest[1] == version
    assert citation['date-released'] == newest[2]


def test_hosted_ci_runs_the_two_commands_of_the_readme():
    workflow = yaml.safe_load(
        (REPOSITORY / '.github' / 'workflows' / 'ci.yml').read_text(encoding='utf-8')
    )
    steps = [step.get('run', '') for job in workflow['jobs'].values() for step in job['steps']]
    commands = {' '.join(run.split()[:2]) for run in steps if run}
    assert commands == {
        line.split('#')[0].strip() for line in blocks(DOCUMENTS[0], 'sh')[0].splitlines()
    }
