"""One agent for three robots of different makers: turned, inverted and offset lidars.

Mounts from /tf_static, from a namespaced tf_static and from a parameter; foreign frames; a clock
that is off. Real nodes and real topics; map and poses are right to 5 cm.
"""

import importlib.util
import math

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from foreign_robots import HALF_HEIGHT, HALF_WIDTH, LATCHED, Robot, Robots
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from ros_domain import own_domain

from explore_slam import messages
from explore_slam.geometry import Pose2, yaw_from_quaternion
from explore_slam.live.processes import NodeProcess, NodeProcesses, one_machine_environment

DOMAIN = own_domain(95)
NAMES = ('robot1', 'robot2', 'robot3')
SUBSCRIPTIONS = {
    'map': (OccupancyGrid, LATCHED),
    **{f'{name}/pose': (PoseWithCovarianceStamped, 10) for name in NAMES},
}
TF2 = importlib.util.find_spec('tf2_msgs') is not None


def robots():
    return [
        # a TurtleBot: base_footprint, a lidar at +90 degrees
        Robot(
            'robot1', Pose2(-2.0, -1.0, 0.0), (-0.04, 0.0, 0.2, 0.0, 0.0, math.pi / 2),
            'robot1/odom', 'robot1/base_footprint', 'robot1/rplidar_link',
        ),
        # a base whose lidar hangs upside down at the back and turns clockwise; frames without
        # prefix on a namespaced tf_static, as nav2 starts several robots
        Robot(
            'robot2', Pose2(2.0, 1.0, math.pi), (-0.15, 0.1, 0.5, math.pi, 0.0, math.pi),
            'odom', 'base_link', 'lidar', 'robot2/tf_static', increment=-1.0,
        ),
        # a robot without transforms, the scans 30 s ahead of its odometry
        Robot(
            'robot3', Pose2(2.0, -1.5, 1.0), (0.2, -0.1, 0.2, 0.0, 0.0, -0.5),
            'r3_odom', 'r3_base', 'laser', transforms='', scan_ahead=30.0, turn=0.3,
        ),
    ]  # fmt: skip


def start(folder, settings):
    file = folder / 'agent.yaml'
    values = {
        'vehicles': list(NAMES),
        'start_poses': [float(v) for robot in robots() for v in robot.start],
        'vision': 'none',
        'explore': False,
        'particles': 50,
        'map_period': 0.5,
        'pose_period': 0.05,
        **settings,
    }
    file.write_text(yaml.safe_dump({'/**': {'ros__parameters': values}}))
    environment = {**one_machine_environment(), 'ROS_DOMAIN_ID': str(DOMAIN)}
    node = NodeProcess('agent', 'agent_node', ['--ros-args', '--params-file', str(file)])
    return NodeProcesses([node], folder / 'logs', environment)


def parameters_of(robot):
    x, y, _, _, _, yaw = robot.mount
    return {'laser_mount': [x, y, yaw]}


@pytest.fixture(scope='module')
def driven(tmp_path_factory):
    """Robots that have driven for a while, their agent still running."""
    if not TF2:
        pytest.skip('tf2_msgs is not installed: python tools/build_messages.py tf2_msgs')
    folder = tmp_path_factory.mktemp('agent')
    team = Robots(robots(), DOMAIN, SUBSCRIPTIONS)
    team.publish_transforms()
    team.listen_to_tf(('/tf', 'robot2/tf'))
    third = {**parameters_of(team.robots['robot3']), 'scan_time_offset': -30.0}
    # a parameter that contradicts the transforms
    settings = {'robot1': {'laser_mount': [0.1, 0.0, 0.0]}, 'robot3': third}
    with start(folder, settings) as processes:
        team.wait_for(lambda: all(out.get_subscription_count() for out in team.out.values()))
        # a driver in robot2's namespace that publishes odom -> base_link there
        from tf2_msgs.msg import TFMessage

        team.static.append(team.node.create_publisher(TFMessage, 'robot2/tf', 10))
        team.spin(1.0)
        team.drive(200)
        team.settle()
        team.spin(1.0)
        yield team, folder, processes
    team.close()


def log_of(folder):
    return (folder / 'logs' / 'agent.log').read_text()


def test_poses_are_right_to_5_cm(driven):
    team, folder, processes = driven
    processes.check()
    for name, robot in team.robots.items():
        pose = messages.planar_pose(team.heard[f'{name}/pose'].pose.pose)
        error = math.hypot(pose.x - robot.pose.x, pose.y - robot.pose.y)
        assert error < 0.05, (name, pose, robot.pose, log_of(folder))


def test_the_extent_of_the_map_is_right_to_5_cm(driven):
    team, _, _ = driven
    cells, resolution, origin = messages.grid_arrays(team.heard['map'])
    walls = (np.argwhere(cells == 100)[:, ::-1] + 0.5) * resolution + origin
    assert len(walls) > 400
    halves = np.array((HALF_WIDTH, HALF_HEIGHT))
    for axis, half in enumerate(halves):
        between_corners = np.abs(walls[:, 1 - axis]) < halves[1 - axis] - 0.3
        for side in (-half, half):
            near = between_corners & (np.abs(walls[:, axis] - side) < 0.3)
            off = walls[near, axis] - side
            assert abs(np.median(off)) < 0.03
            assert np.mean(np.abs(off) < 0.06) > 0.95
    # no wall stands inside the room: nothing is skewed
    inside = (np.abs(walls) < (HALF_WIDTH - 0.15, HALF_HEIGHT - 0.15)).all(axis=1)
    assert np.count_nonzero(inside) < 5


def test_map_to_odom_completes_the_tree_that_is_there(driven):
    """The frames of the odometry messages, composed with raw odometry, give the true pose."""
    team, _, _ = driven
    expected = {
        'robot1': ('/tf', 'robot1/odom'),
        'robot2': ('robot2/tf', 'odom'),
        'robot3': ('/tf', 'r3_odom'),
    }
    assert {(topic, child) for topic, _, child in team.transforms} == set(expected.values())
    for name, (topic, child) in expected.items():
        stamped = team.transforms[topic, 'map', child]
        q, t = stamped.transform.rotation, stamped.transform.translation
        offset = Pose2(t.x, t.y, yaw_from_quaternion(q.x, q.y, q.z, q.w))
        robot = team.robots[name]
        pose = offset.compose(robot.odometry)
        assert math.dist(pose[:2], robot.pose[:2]) < 0.05, name
        # dated into the future by transform_tolerance, from one of the last poses
        ahead = messages.seconds(stamped.header.stamp) - np.array(team.stamps[f'{name}/pose'][-5:])
        assert np.abs(ahead - 0.5).min() < 0.01


def test_the_log_says_which_mounts_are_used(driven):
    _, folder, _ = driven
    log = log_of(folder)
    assert 'robot1: mount of robot1/rplidar_link: x -0.040 m, y 0.000 m, yaw 90.0°' in log
    assert 'upside down, from /tf_static' in log
    assert 'from robot3.laser_mount' in log
    assert log.count('/tf_static has the laser (robot1/rplidar_link)') == 1
    # a team without cameras is nothing to warn about, and a known offset is no wrong clock
    for word in ('camera', 'landmarks', 'ahead of'):
        assert not [line for line in log.splitlines() if 'WARN' in line and word in line]


def test_clocks_that_are_off_are_named_with_the_amount(tmp_path):
    first, second, third = robots()
    first.scan_ahead = 30.0
    second.stamped = False
    third.scan_ahead = third.odom_ahead = 3600.0
    team = Robots([first, second, third], DOMAIN, {})
    levels = {}

    def on_diagnostics(message):
        levels.update({status.name: (status.level, status.message) for status in message.status})

    team.node.create_subscription(DiagnosticArray, '/diagnostics', on_diagnostics, 10)
    with start(tmp_path, {}) as processes:
        team.wait_for(lambda: all(out.get_subscription_count() for out in team.out.values()))
        expected = (
            'robot1/scan: stamps are 30.0 s ahead of those of odom',
            'robot2/odom: ',
            'messages have the stamp zero; the time of receipt is used',
            'robot3/odom: stamps are 3600.0 s ahead of the clock of this node',
        )
        for _ in range(120):  # up to a minute, for a busy machine
            team.drive(5)
            if all(text in log_of(tmp_path) for text in expected):
                break
        for text in expected:
            assert text in log_of(tmp_path)
        team.wait_for(
            lambda: levels.get('agent: vehicle robot1', (b'',))[0] == DiagnosticStatus.WARN
        )
        assert log_of(tmp_path).count('robot1/scan: stamps are') == 1
        _, text = levels['agent: vehicle robot1']
        assert 'robot1/scan: stamps are 30.0 s ahead of those of odom' in text
        processes.check()
    team.close()
