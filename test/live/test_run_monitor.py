"""The monitor of a live run: what counts as explored while the operator draws areas."""

import time

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import Point32, PolygonStamped
from grid_worlds import drawn_world
from nav_msgs.msg import OccupancyGrid
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from ros_domain import own_domain

from explore_slam.geometry import Pose2
from explore_slam.live.run_monitor import RunMonitor
from explore_slam.messages.maps import grid_message
from explore_slam.nodes.ros_types import MESSAGES
from explore_slam.results.reachable_area import ReachableArea
from explore_slam.results.run_data import RunRecorder

START = {'robot1': Pose2(1.0, 1.0, 0.0)}
LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


def room():
    """A room from 0.5 m to 3.5 m in x and to 2 m in y, whose right half is not known yet."""
    world = drawn_world(['########', '#      #', '#      #', '#      #', '########'])
    return ReachableArea(world, START.values(), radius=0.2)


@pytest.fixture
def net():
    rclpy.init(args=[], domain_id=own_domain(66))
    monitor = RunMonitor(START, RunRecorder('run', START, 10), room())
    operator = rclpy.create_node('operator')
    executor = SingleThreadedExecutor()
    for node in (monitor, operator):
        executor.add_node(node)

    def spin_until(condition):
        end = time.monotonic() + 20.0
        while not condition():
            assert time.monotonic() < end, 'nothing arrived'
            executor.spin_once(timeout_sec=0.02)

    yield monitor, operator, spin_until
    for node in (monitor, operator):
        node.destroy_node()
    rclpy.shutdown()


def polygon(left, right, frame='map'):
    message = PolygonStamped()
    message.header.frame_id = frame
    corners = [(left, 0.0), (right, 0.0), (right, 3.0), (left, 3.0)]
    message.polygon.points = [Point32(x=x, y=y) for x, y in corners]
    return message


def test_what_the_operator_leaves_out_does_not_count_as_unexplored(net):
    monitor, operator, spin_until = net
    maps = operator.create_publisher(OccupancyGrid, 'map_probability', LATCHED)
    areas = {
        name: operator.create_publisher(PolygonStamped, f'explore/{name}', 10)
        for name in ('area', 'keepout')
    }
    spin_until(lambda: all(out.get_subscription_count() for out in areas.values()))
    cells = np.full((50, 80), 0, np.int8)
    cells[:, 40:] = -1  # of 0.05 m: nothing beyond x = 2 m is known

    def coverage(name, message):
        areas[name].publish(message)
        before = monitor.area_left_out
        spin_until(lambda: monitor.area_left_out != before)
        count = len(monitor.recorder._coverage)
        maps.publish(grid_message(MESSAGES, 1.0, 'map', cells, 0.05, (0.0, 0.0)))
        spin_until(lambda: len(monitor.recorder._coverage) > count)
        return monitor.state.coverage

    whole = 3.0 * 1.5
    areas['area'].publish(polygon(0.0, 1.0, 'odom'))  # refused, as by the agent
    assert coverage('keepout', polygon(2.0, 4.0)) == 1.0
    assert monitor.area_left_out == pytest.approx(whole / 2, abs=0.15)
    assert coverage('keepout', PolygonStamped()) == pytest.approx(0.5, abs=0.03)
    assert monitor.area_left_out == 0.0
    assert coverage('area', polygon(1.5, 3.0)) == pytest.approx(1.0 / 3.0, abs=0.05)
    assert coverage('keepout', polygon(0.0, 4.0)) == 1.0  # nothing is left to explore


def test_an_area_without_what_is_left_out_is_a_new_one():
    whole = room()
    size = whole.area

    class Left:
        @staticmethod
        def exclude(points):
            return points[:, 0] < 2.0

    assert whole.without(Left()).area == pytest.approx(0.5 * size, rel=0.05)
    assert whole.area == size
