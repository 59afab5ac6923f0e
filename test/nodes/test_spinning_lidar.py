"""The agent's node with a spinning lidar on a turning vehicle, over topics."""

import math
import time

import numpy as np
import pytest
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from ros_domain import own_domain
from sensor_msgs.msg import LaserScan

from explore_slam import data, messages
from explore_slam.live.processes import NodeProcess, NodeProcesses, one_machine_environment
from explore_slam.messages.sweep_status import sweeps_record
from explore_slam.nodes.ros_types import MESSAGES
from explore_slam.simulation.worlds.walls import distances_from
from explore_slam.studies import sensor_rig
from explore_slam.studies.sensor_rig import FLOOR, LASER, START, Drive, Laser

DOMAIN = own_domain(86)
LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


def start(folder, settings):
    values = {
        'vehicles': ['robot1'],
        'start_poses': list(START),
        'vision': 'none',
        'explore': False,
        'particles': 50,
        'map_period': 0.5,
        'pose_period': 0.05,
        'robot1': {'laser_mount': list(LASER), **settings},
    }
    file = folder / 'agent.yaml'
    file.write_text(yaml.safe_dump({'/**': {'ros__parameters': values}}))
    environment = {**one_machine_environment(), 'ROS_DOMAIN_ID': str(DOMAIN)}
    node = NodeProcess('agent', 'agent_node', ['--ros-args', '--params-file', str(file)])
    return NodeProcesses([node], folder / 'logs', environment)


@pytest.fixture
def node():
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    made = rclpy.create_node('vehicle', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(made)
    yield made
    executor.shutdown()
    made.destroy_node()
    rclpy.shutdown(context=context)


@pytest.mark.parametrize(
    ('stated', 'settings', 'log'),
    [
        (True, {'sweep_direction': 'backward', 'sweep_stamp': 'last'}, ''),
        (False, {}, 'last beam first, stamped at the last beam by time'),
    ],
)
def test_the_map_that_is_published_is_right(tmp_path, monkeypatch, node, stated, settings, log):
    monkeypatch.setattr(sensor_rig, 'TOUR', (2.0 * math.pi, (2.2, 4.0)))
    drive, laser = Drive(0.9), Laser(5.5, backward=True, last=True, stated=stated)
    random = np.random.default_rng(0)
    readings = sensor_rig.odometry(drive, 1.05, random)
    records = sensor_rig.in_order_of_arrival(
        readings, [sensor_rig.scans(drive, laser, random)], [laser]
    )
    heard = {}
    node.create_subscription(OccupancyGrid, 'map', lambda m: heard.update(map=m), LATCHED)
    node.create_subscription(
        PoseWithCovarianceStamped, 'robot1/pose', lambda m: heard.update(pose=m), 10
    )
    node.create_subscription(
        DiagnosticStatus, 'robot1/sweeps', lambda m: heard.update(sweeps=m), LATCHED
    )
    odom = node.create_publisher(Odometry, 'robot1/odom', 10)
    scan = node.create_publisher(LaserScan, 'robot1/scan', 10)

    def wait_for(condition, seconds=90.0):
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, (tmp_path / 'logs' / 'agent.log').read_text()
            rclpy.spin_once(node, executor=node.executor, timeout_sec=0.05)

    with start(tmp_path, settings) as processes:
        wait_for(lambda: odom.get_subscription_count() and scan.get_subscription_count())
        epoch = time.time() - records[0].stamp
        for record in records:
            stamp = epoch + record.stamp
            if isinstance(record, data.LaserScan):
                message = messages.scan_message(MESSAGES, record, 'laser')
                message.header.stamp = messages.time_message(MESSAGES, stamp)
                scan.publish(message)
            else:
                moved = data.OdometryReading(stamp, record.pose)
                odom.publish(messages.odometry_message(MESSAGES, moved, 'odom', 'base_link'))
            wait_for(lambda at=stamp: time.time() > at)  # as fast as a vehicle
        newest = epoch + readings[-1].stamp - 0.3
        wait_for(lambda: 'pose' in heard and messages.seconds(heard['pose'].header.stamp) > newest)
        heard.pop('map', None)
        wait_for(lambda: 'map' in heard)
        wait_for(lambda: stated or 'sweeps' in heard)  # follower and driver learn it
        processes.check()
    cells, resolution, origin = messages.grid_arrays(heard['map'])
    walls = (np.argwhere(cells == 100)[:, ::-1] + 0.5) * resolution + origin
    assert len(walls) > 500
    assert np.mean(distances_from(FLOOR, walls) > 0.1) <= 0.01
    stamp = messages.seconds(heard['pose'].header.stamp) - epoch
    pose = messages.planar_pose(heard['pose'].pose.pose)
    true = drive.at(np.array([stamp]))[0]
    assert math.dist(pose[:2], true[:2]) <= 0.03
    if not stated:
        assert sweeps_record(heard['sweeps'])[''] == (pytest.approx(0.1813, rel=0.01), True, True)
    assert log in (tmp_path / 'logs' / 'agent.log').read_text()
