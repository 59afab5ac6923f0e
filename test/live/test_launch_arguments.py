"""Arguments of the launch files, and the files themselves where ROS's launch is installed."""

import importlib.util
import re
from pathlib import Path

import pytest
import yaml

from explore_slam.errors import ConfigError
from explore_slam.live import launch_arguments as read
from explore_slam.settings import read_parameters

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
        (lambda: read.start_poses_of(WORLDS / 'none.yaml', '1'), 'none.yaml: no such file'),
        (lambda: read.world_file('offize', WORLDS), "one of .*; did you mean 'office'"),
        (lambda: read.remappings({'scan_topic': '/scan'}, ['a', 'b']), 'would share one topic'),
        (lambda: read.remappings({'scan_topic': 'my scan'}), "scan_topic is 'my scan', expected"),
        (lambda: read.remappings({'odom_topic': 'odom/'}, ['a']), "odom_topic is 'odom/', exp"),
        (
            lambda: read.one_each('base_ports', 'tcp://a', ['robot1', 'robot2'], []),
            'base_ports is .*, expected 2 different texts, .*: one for each of robot1, robot2',
        ),
        (lambda: read.ros_name('name', '9bot'), "name is '9bot', expected a name of ROS"),
        (lambda: read.ros_name('namespace', '/a//b'), "namespace is '/a//b', expected a name"),
    ],
)
def test_what_cannot_be_read_is_one_sentence(call, sentence):
    with pytest.raises(ConfigError, match=sentence) as error:
        call()
    assert '\n' not in str(error.value)


@pytest.mark.parametrize(
    ('content', 'sentence'),
    [
        ('starts: [1, 2]', r'starts is \[1, 2\], expected a pose for each vehicle'),
        ('walls: {}', 'starts is None'),
        ('- 1', 'holds list, expected a world'),
        ('\xff', 'cannot be read'),
    ],
)
def test_world_files_without_starts_are_refused(tmp_path, content, sentence):
    path = tmp_path / 'world.yaml'
    path.write_bytes(content.encode('latin-1'))
    with pytest.raises(ConfigError, match=sentence):
        read.start_poses_of(path, '1')


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
    table = text[text.index('\nARGUMENTS = {') : text.index('\n}\n')]
    found = re.findall(r"^    '(\w+)': \(", table, re.MULTILINE)
    assert len(found) >= 5
    assert len(re.findall(r"'[^']* [^']*'|\"[^\"]* [^\"]*\"", table)) >= len(found)
    assert re.search(r'return description\(ARGUMENTS, \w+\)\n', text)
    shared = (REPOSITORY / 'explore_slam' / 'live' / 'launch_description.py').read_text('utf-8')
    assert 'DeclareLaunchArgument(name, default_value=default, description=text)' in shared


def entities_of(name, /, **given):
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
    without = {'vehicles': 'a,b', 'base_ports': 'tcp://h1, tcp://h2:8102', 'use_laser': 'false'}
    for vehicle, port in zip(entities_of('vehicles', **without), ('h1', 'h2:8102'), strict=True):
        given = dict(vehicle.launch_arguments)
        assert given['base_port'] == f'tcp://{port}'
        assert given['laser_port'] == f'/dev/{given["name"]}_laser'


def test_ports_of_several_vehicles_are_listed_or_follow_a_pattern():
    usual = ['/dev/a_base', '/dev/b_base']
    assert read.one_each('base_ports', '', ['a', 'b'], usual) == usual
    given = 'tcp://192.168.1.11, tcp://192.168.1.12:8101'
    assert read.one_each('base_ports', given, ['a', 'b'], usual) == given.split(', ')


def test_a_vehicle_without_laser_needs_one_parameter():
    for executable in ('pioneer_driver', 'path_follower'):
        assert given_to('vehicle', executable, use_laser='false')['use_laser'] is False


def parameters_of(node):
    """What a node gets: the values of its parameter files and arguments, later ones first."""
    from launch import LaunchContext
    from launch_ros.utilities import evaluate_parameters

    values = {}
    for item in evaluate_parameters(LaunchContext(), node._Node__parameters):
        values.update(read_parameters(item) if isinstance(item, Path) else item)
    return values


def given_to(name, executable, **given):
    (node, *_) = [
        entity
        for entity in entities_of(name, **given)
        if getattr(entity, 'node_executable', '') == executable
    ]
    return parameters_of(node)


def test_a_parameter_file_of_the_agent_applies_unless_an_argument_is_given(tmp_path):
    pytest.importorskip('launch_ros', reason="ROS's launch is not installed")
    file = tmp_path / 'agent.yaml'
    values = {
        'vehicles': ['left', 'right'],
        'start_poses': [1.0, 2.0, 0.5, 3.0, 4.0, 0.0],
        'vision': 'none',
        'use_laser': False,
        'seed': 9,
        'explore': False,
        'autostart': False,
        'run_directory': '/runs',
        'use_sim_time': True,
    }
    file.write_text(yaml.safe_dump({'/**': {'ros__parameters': values}}))
    found = given_to('agent', 'agent', params_file=str(file))
    assert {name: found[name] for name in values} == values
    found = given_to('agent', 'agent', params_file=str(file), seed='4', explore='true')
    assert (found['seed'], found['explore'], found['vision']) == (4, True, 'none')
    assert given_to('demo', 'agent', params_file=str(file))['seed'] == 9
    (rviz,) = [
        entity
        for entity in entities_of('agent', params_file=str(file), rviz='true')
        if getattr(entity, 'node_executable', '') == 'rviz2'
    ]
    assert parameters_of(rviz)['use_sim_time'] is True
    with pytest.raises(ConfigError, match='start_poses has 3 numbers, expected 6'):
        entities_of('agent', params_file=str(file), start_poses='0,0,0')
    # neither the file nor an argument: the defaults of the node
    file.write_text(yaml.safe_dump({'/**': {'ros__parameters': {'particles': 50}}}))
    assert given_to('agent', 'agent', params_file=str(file)) == {'particles': 50}


def test_a_parameter_file_of_the_driver_applies_unless_an_argument_is_given(tmp_path):
    pytest.importorskip('launch_ros', reason="ROS's launch is not installed")
    file = tmp_path / 'vehicle.yaml'
    values = {
        'base_port': '/dev/ttyUSB7',
        'laser_port': '/dev/ttyUSB8',
        'enable_base': False,
        'enable_laser': False,
        'enable_camera': False,
        'motors_at_start': True,
        'autostart': False,
        'use_sim_time': True,
    }
    file.write_text(yaml.safe_dump({'/**': {'ros__parameters': values}}))
    assert given_to('vehicle', 'pioneer_driver', params_file=str(file)) == values
    found = given_to('vehicle', 'pioneer_driver', params_file=str(file), motors='no')
    assert found == {**values, 'motors_at_start': False}
    found = given_to('vehicle', 'path_follower', params_file=str(file), autostart='true')
    assert (found['use_sim_time'], found['autostart']) == (True, True)


def test_arguments_that_are_not_given_are_no_parameters():
    readers = {
        'seed': ('seed', lambda _, text: int(text)),
        'laser': ('enable_laser', read.boolean),
    }
    assert read.given_parameters({'seed': '', 'laser': ''}, readers) == {}
    assert read.given_parameters({'seed': '', 'laser': 'no'}, readers) == {'enable_laser': False}


def test_wrong_values_and_names_of_the_launch_files_are_one_sentence():
    with pytest.raises(ConfigError, match='vehicles is 9, expected a whole number from 1 to 5'):
        entities_of('demo', vehicles='9')
    with pytest.raises(ConfigError, match="name is 'robot 1', expected a name of ROS"):
        entities_of('vehicle', name='robot 1')
    with pytest.raises(ConfigError, match="namespace is '9', expected a name of ROS"):
        entities_of('agent', namespace='9')
    (first, *_) = entities_of('demo', vehicle='1')
    assert type(first).__name__ == 'LogInfo'
