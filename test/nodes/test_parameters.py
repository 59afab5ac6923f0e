import difflib
import math
from pathlib import Path

import numpy as np
import pytest
import rclpy
import yaml
from rclpy.parameter import Parameter
from ros_domain import own_domain

from explore_slam.data import FollowerState, OdometryReading, Plan
from explore_slam.errors import ConfigError
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.messages.vehicle_settings import VehicleConfig
from explore_slam.nodes.agent_parameters import AgentNodeConfig
from explore_slam.nodes.driver_parameters import DriverNodeConfig
from explore_slam.nodes.feature_extractor import FeatureExtractorNode
from explore_slam.nodes.path_follower import PathFollowerNode
from explore_slam.nodes.pioneer_driver import PioneerDriverNode
from explore_slam.settings import settings_of, values_of, with_values
from explore_slam.vehicle import PathFollowerConfig

CONFIG = Path(__file__).resolve().parents[2] / 'config' / 'vehicle.yaml'


def test_the_parameter_file_names_settings_that_exist():
    content = yaml.safe_load(CONFIG.read_text())
    trees = {'/**/pioneer_driver': DriverNodeConfig(), '/**/path_follower': PathFollowerConfig()}
    assert content.keys() == trees.keys()
    for name, tree in trees.items():
        with_values(tree, content[name]['ros__parameters'])


def test_the_map_has_a_frame():
    with pytest.raises(ConfigError, match=r"map_frame is '/', expected the name of a frame"):
        AgentNodeConfig(map_frame='/')


@pytest.mark.parametrize(
    ('names', 'values', 'words'),
    [
        (('a', 'b'), (0.0,) * 5, r'start_poses has 5 numbers, expected 6'),
        (('a', 'b'), (0.0,) * 5 + (math.nan,), r'start pose of b .* nan three times'),
        (('a', 'a'), (0.0,) * 6, r"vehicles is \['a', 'a'\], expected one name or more"),
        ((), (), r'vehicles is \[\]'),
    ],
)
def test_start_poses_must_fit_the_names(names, values, words):
    with pytest.raises(ConfigError, match=words):
        AgentNodeConfig(vehicles=names, start_poses=values).poses()
    unknown = (1.0, 2.0, 0.5, math.nan, math.nan, math.nan)
    assert AgentNodeConfig(vehicles=('a', 'b'), start_poses=unknown).poses()['b'] is None
    starts = AgentNodeConfig(vehicles=('a', 'b'), start_poses=(1, 2, 0.5, 3, 4, 0.0)).poses()
    assert starts == {'a': (1.0, 2.0, 0.5), 'b': (3.0, 4.0, 0.0)}


@pytest.mark.parametrize(
    'name', ['', 'a b', '1robot', '/robot1', 'fleet/robot1', 'robot.1', 'tb3-1', 'Röbot']
)
def test_names_of_vehicles_must_be_names_of_ros(name):
    with pytest.raises(ConfigError, match=f'vehicles has the name {name!r}, expected letters'):
        AgentNodeConfig(vehicles=(name,))
    with pytest.raises(ConfigError, match='expected letters'):
        with_values(AgentNodeConfig(), {'vehicles': ['robot1', name]})


def test_frames_take_the_names_of_the_parameters():
    frames = DriverNodeConfig(odom_frame='o', laser_frame='front').frames('robot1')
    assert (frames.odom, frames.laser) == ('robot1/o', 'robot1/front')


def test_names_are_unique_and_all_have_a_meaning():
    for tree in (DriverNodeConfig(), PathFollowerConfig()):
        names = [info.name for info, _ in settings_of(tree)]
        assert len(set(names)) == len(names)
        assert all(info.doc for info, _ in settings_of(tree))


def test_the_odometry_frame_is_kept_in_a_file_per_vehicle_and_port(monkeypatch, tmp_path):
    monkeypatch.setenv('ROS_HOME', str(tmp_path))
    config = with_values(DriverNodeConfig(), {'base_port': 'tcp://10.0.0.7:8101'})
    file = values_of(config.with_odometry_file('robot1'))['odometry_file']
    assert file == f'{tmp_path}/explore_slam/odometry_robot1_tcp_10_0_0_7_8101.json'
    own = with_values(config, {'odometry_file': '/var/lib/odometry.json'})
    assert own.with_odometry_file('robot1') == own
    without = with_values(own, {'keep_odometry': False}).with_odometry_file('robot1')
    assert values_of(without)['odometry_file'] == ''


@pytest.mark.parametrize('tree', [AgentNodeConfig(), DriverNodeConfig(), PathFollowerConfig()])
def test_agent_driver_and_follower_have_the_same_settings_of_the_laser_mount(tree):
    values = {'laser_x': -0.2, 'laser_y': 0.1, 'laser_yaw': 3.0}
    assert values.items() <= values_of(with_values(tree, values)).items()
    with pytest.raises(ConfigError, match='laser_yaw is nan'):
        with_values(tree, {'laser_yaw': float('nan')})


def test_the_nodes_of_a_vehicle_take_their_sections_of_the_file(tmp_path):
    file = tmp_path / 'vehicle.yaml'
    text = CONFIG.read_text().replace('follow_speed: 0.4', 'follow_speed: 0.3')
    file.write_text(text)
    context = rclpy.Context()
    context.init(domain_id=own_domain(77))
    node = PathFollowerNode(
        namespace='/robot9', context=context, cli_args=['--ros-args', '--params-file', str(file)]
    )
    assert node.active.follower.config.body.follow_speed == 0.3
    result = node.set_parameters([Parameter('follow_speed', value=9.0)])[0]
    assert not result.successful
    assert node.set_parameters([Parameter('follow_speed', value=0.2)])[0].successful
    assert node.active.follower.config.body.follow_speed == 0.2
    node.set_parameters([Parameter('control_frequency', value=10.0)])
    assert node.active.period == pytest.approx(0.1)
    result = node.set_parameters([Parameter('autostart', value=False)])[0]
    assert not result.successful
    assert 'change_state' in result.reason
    node.stop()
    node.destroy_node()
    context.try_shutdown()


SHARED = """
/**:
  ros__parameters:
    vehicles: [robot1, robot2]
    particles: 100
    laser_mount: [0.0, 0.1, 0.0]
    robot_base_frame: robot1/chassis
    robot1:
      vehicle_radius: 0.4
      follow_speed: 0.2
      laser_mount: [-0.2, 0.0, 1.57]
      use_laser: false
      folow_speed: 0.3
    robot2:
      vehicle_radius: 0.3
      vision: none
"""


def test_one_file_serves_the_agent_and_the_nodes_of_a_vehicle(tmp_path, capfd):
    file = tmp_path / 'team.yaml'
    file.write_text(SHARED)
    context = rclpy.Context()
    context.init(domain_id=own_domain(77))
    options = {
        'namespace': '/robot1',
        'context': context,
        'cli_args': ['--ros-args', '--params-file', str(file), '-p', 'autostart:=false'],
    }
    follower = PathFollowerNode(**options)
    try:
        assert follower.config.body.vehicle_radius == 0.4
        assert follower.config.body.follow_speed == 0.2
        assert follower.get_parameter('follow_speed').value == 0.2
        assert follower.get_parameter('laser_mount').value == [-0.2, 0.0, 1.57]
        assert follower.get_parameter('robot_base_frame').value == 'robot1/chassis'
        (answer,) = follower.set_parameters([Parameter('robot_base_frame', value='other')])
        assert (answer.successful, answer.reason) == (False, 'robot_base_frame: set at start only')
        follower.trigger_configure()
        follower.trigger_activate()
        # use_laser is false: one parameter is enough to do without scans
        driving = follower.active.follower
        assert driving.config.obstacle_stop
        driving.set_odometry(OdometryReading(1.0, IDENTITY))
        driving.set_pose(1.0, IDENTITY)
        goal = Pose2(2.0, 0.0, 0.0)
        driving.set_plan(Plan(1.0, 'robot1', goal, np.array([[0.0, 0.0], [2.0, 0.0]])))
        assert driving.command(1.0).state is FollowerState.DRIVING
    finally:
        follower.stop()
        follower.destroy_node()
    driver = PioneerDriverNode(**options)
    try:
        assert tuple(driver.config.driver.laser_mount.pose) == (-0.2, 0.0, 1.57)
        assert values_of(driver.config)['enable_laser'] is False
        assert driver.config.frames('robot1').base == 'robot1/chassis'
    finally:
        driver.stop()
        driver.destroy_node()
        context.try_shutdown()
    log = capfd.readouterr().err
    assert "no parameter 'robot1.folow_speed'; did you mean 'robot1.follow_speed'?" in log
    assert log.count('there is no parameter') == 2  # the misspelt one, by each node
    assert log.count('does not have (the agent may): particles, vehicles') == 2


def test_a_vehicle_in_a_nested_namespace_has_the_name_that_its_agent_knows(tmp_path, capfd):
    file = tmp_path / 'team.yaml'
    file.write_text(SHARED)
    context = rclpy.Context()
    context.init(domain_id=own_domain(77))
    arguments = ['--ros-args', '--params-file', str(file), '-p', 'autostart:=false']
    node = PathFollowerNode(namespace='/fleet/robot1', context=context, cli_args=arguments)
    try:
        assert node.config.body.vehicle_radius == 0.4
        assert "did you mean 'robot1.follow_speed'?" in capfd.readouterr().err
    finally:
        node.stop()
        node.destroy_node()
        context.try_shutdown()


def test_the_feature_extractor_names_misspelt_parameters(tmp_path, capfd):
    file = tmp_path / 'team.yaml'
    file.write_text(SHARED + '    compact_descriptor: false\n')
    context = rclpy.Context()
    context.init(domain_id=own_domain(77))
    arguments = ['--ros-args', '--params-file', str(file)]
    node = FeatureExtractorNode(namespace='/robot1', context=context, cli_args=arguments)
    node.stop()
    node.destroy_node()
    context.try_shutdown()
    log = capfd.readouterr().err
    assert "no parameter 'compact_descriptor'; did you mean 'compact_descriptors'?" in log
    assert "no parameter 'robot1.folow_speed'; did you mean 'robot1.follow_speed'?" in log
    assert log.count('there is no parameter') == 2


def test_the_settings_of_the_agent_do_not_look_like_misspelt_ones_of_a_vehicle():
    own = {**values_of(DriverNodeConfig()), **values_of(PathFollowerConfig())}
    own = [*own, *values_of(VehicleConfig())]
    for name in values_of(AgentNodeConfig()):
        if name not in own:
            assert difflib.get_close_matches(name, own, cutoff=0.85) == [], name
