"""Arguments of the launch files, and the files themselves where ROS's launch is installed."""

import importlib.util
import re
from pathlib import Path

import pytest

from explore_slam.errors import ConfigError
from explore_slam.live import launch_arguments as read

REPOSITORY = Path(__file__).resolve().parents[2]
LAUNCH = REPOSITORY / 'launch'
WORLDS = REPOSITORY / 'config' / 'worlds'


@pytest.mark.parametrize('word', ['true', 'True', 'TRUE', 'yes', 'on', '1', 'false', 'Off', 'no'])
def test_any_yaml_boolean_is_read(word):
    assert read.boolean('rviz', word) == (word.lower() in ('true', 'yes', 'on', '1'))


@pytest.mark.parametrize(
    ('call', 'sentence'),
    [
        (lambda: read.boolean('rviz', 'maybe'), "rviz is 'maybe', expected true or false"),
        (lambda: read.names('vehicles', 'a,a'), "vehicles is 'a,a', expected different names"),
        (lambda: read.names('vehicles', ' '), "vehicles is ' ', expected different names"),
        (lambda: read.numbers('start_poses', '0,x,0', 3), "start_poses is '0,x,0', expected num"),
        (lambda: read.numbers('start_poses', '0,0', 3), 'start_poses has 2 numbers, expected 3'),
        (lambda: read.whole_number('seed', 'x', 0), "seed is 'x', expected a whole number"),
        (lambda: read.whole_number('seed', '-1', 0), 'seed is -1, expected .* from 0 on'),
        (lambda: read.choice('vision', 'off', ('agent', 'none')), 'write none'),
        (lambda: read.existing_file('params_file', '/no/file'), 'does not exist'),
        (
            lambda: read.start_poses_of(WORLDS / 'small.yaml', '9'),
            'vehicles is 9, expected .* 1 to',
        ),
        (lambda: read.start_poses_of(WORLDS / 'none.yaml', '1'), 'cannot be read as a world file'),
        (lambda: read.world_file('offize', WORLDS), "one of .*; did you mean 'office'"),
        (lambda: read.remappings({'scan_topic': '/scan'}, ['a', 'b']), 'would share one topic'),
    ],
)
def test_what_cannot_be_read_is_one_sentence(call, sentence):
    with pytest.raises(ConfigError, match=sentence) as error:
        call()
    assert '\n' not in str(error.value)


def test_topics_are_remapped_in_the_namespace_of_each_vehicle():
    given = {'scan_topic': 'front/scan', 'odom_topic': '', 'color_topic': 'rgb'}
    assert read.remappings(given, ['a', 'b']) == [
        ('a/scan', 'a/front/scan'),
        ('b/scan', 'b/front/scan'),
        ('a/camera/rgb/image_raw', 'a/rgb'),
        ('b/camera/rgb/image_raw', 'b/rgb'),
    ]
    assert read.remappings({'scan_topic': '/scan'}, ['a']) == [('a/scan', '/scan')]
    assert read.remappings({'scan_topic': 'lidar'}) == [('scan', 'lidar')]


def test_misspelt_arguments_are_named_and_foreign_ones_are_not():
    known = ('vehicles', 'world', 'rviz')
    assert read.misspelt(['vehicles:=2', 'vehicle:=2', 'qqq:=1', 'x'], known) == [
        "there is no launch argument 'vehicle'; did you mean 'vehicles'?"
    ]


@pytest.mark.parametrize('path', sorted(LAUNCH.glob('*.launch.py')), ids=lambda path: path.stem)
def test_every_argument_is_described(path):
    text = path.read_text(encoding='utf-8')
    table = text[text.index('ARGUMENTS = {') : text.index('\n}\n')]
    found = re.findall(r"^    '(\w+)': \(", table, re.MULTILINE)
    assert len(found) >= 5
    assert len(re.findall(r"'[^']* [^']*'|\"[^\"]* [^\"]*\"", table)) >= len(found)
    assert re.search(r'return description\(ARGUMENTS, \w+\)\n', text)
    shared = (REPOSITORY / 'explore_slam' / 'live' / 'launch_description.py').read_text('utf-8')
    assert 'DeclareLaunchArgument(name, default_value=default, description=text)' in shared


def entities_of(name, **given):
    """What a launch file starts, as ros2 launch would see it."""
    pytest.importorskip('launch_ros', reason="ROS's launch is not installed")
    from launch import LaunchContext
    from launch.actions import DeclareLaunchArgument, OpaqueFunction

    spec = importlib.util.spec_from_file_location(name, LAUNCH / f'{name}.launch.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    context = LaunchContext(argv=[f'{key}:={value}' for key, value in given.items()])
    context.launch_configurations.update(given)
    found = []
    for entity in module.generate_launch_description().entities:
        if isinstance(entity, DeclareLaunchArgument):
            entity.execute(context)
        elif isinstance(entity, OpaqueFunction):
            found += entity.execute(context) or []
    return found


def test_the_launch_files_start_their_nodes():
    executables = [
        e.node_executable
        for e in entities_of('agent', rviz='True')
        if hasattr(e, 'node_executable')
    ]
    assert executables == ['agent', 'rviz2']
    demo = entities_of('demo', vehicles='3', world='office')
    nodes = [e.node_executable for e in demo if hasattr(e, 'node_executable')]
    assert nodes == ['simulator', 'agent', *['path_follower'] * 3]
    assert any(type(entity).__name__ == 'SetEnvironmentVariable' for entity in demo)
    vehicle = entities_of('vehicle', features='on', follower='no')
    nodes = [e.node_executable for e in vehicle if hasattr(e, 'node_executable')]
    assert nodes == ['pioneer_driver', 'feature_extractor']
    assert len(entities_of('vehicles', vehicles='a,b,c')) == 3


def test_wrong_values_and_names_of_the_launch_files_are_one_sentence():
    with pytest.raises(ConfigError, match='vehicles is 9, expected a whole number from 1 to 5'):
        entities_of('demo', vehicles='9')
    (first, *_) = entities_of('demo', vehicle='1')
    assert type(first).__name__ == 'LogInfo'
