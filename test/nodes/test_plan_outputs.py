"""Plans on their way to navigators: what is sent when, reports, and how a navigator is added."""

import sys

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Path
from rclpy.executors import SingleThreadedExecutor
from ros_domain import own_domain

from explore_slam.data import FollowerReport, FollowerState, Plan
from explore_slam.errors import ConfigError
from explore_slam.geometry import Pose2
from explore_slam.messages.follower_status import follower_status_message
from explore_slam.nodes.navigators import NAVIGATORS, maker
from explore_slam.nodes.plan_outputs import PlanOutputs
from explore_slam.nodes.ros_types import MESSAGES

DOMAIN = own_domain(96)


@pytest.fixture
def node():
    context = rclpy.Context()
    context.init(domain_id=DOMAIN)
    made = rclpy.create_node('agent', context=context)
    yield made
    made.destroy_node()
    context.try_shutdown()


def plan(vehicle, x):
    return Plan(0.0, vehicle, Pose2(x, 0.0, 0.0), np.array([[0.0, 0.0], [x, 0.0]]))


class Obedient:
    """A navigator that arrives at once."""

    def __init__(self, _node, vehicle, map_frame, report):
        self.sent = []
        self.vehicle, self.map_frame, self.report = vehicle, map_frame, report

    def follow(self, stamp, plan):
        self.sent.append((stamp, plan))
        if plan is not None:
            self.report('arrived')

    def stop(self, stamp):
        self.sent.append((stamp, 'stop'))


def test_another_navigator_is_a_module_and_a_line(node, monkeypatch):
    module = type(sys)('obedient_navigator')
    module.make = Obedient
    monkeypatch.setitem(sys.modules, 'obedient_navigator', module)
    monkeypatch.setitem(NAVIGATORS, 'obedient', 'obedient_navigator')
    reports = []
    names = {'robot1': 'obedient', 'robot2': 'obedient'}
    outputs = PlanOutputs(node, names, 'map', lambda *report: reports.append(report))
    first, second = plan('robot1', 1.0), plan('robot1', 2.0)
    for stamp, plans in enumerate(
        ({'robot1': first}, {'robot1': first}, {'robot1': second}, {}, {})
    ):
        outputs.send(float(stamp), plans)
    navigator = outputs._navigators['robot1']
    assert navigator.sent == [(0.0, first), (2.0, second), (3.0, None)]
    assert outputs._navigators['robot2'].sent == [(0.0, None)]
    outputs.stop(5.0)
    outputs.send(6.0, {'robot1': second})
    outputs.stop(7.0)
    outputs.send(8.0, {'robot1': second})  # after a stop it is news again
    assert navigator.sent[3:] == [(5.0, 'stop'), (6.0, second), (7.0, 'stop'), (8.0, second)]
    assert outputs._navigators['robot2'].sent[1:] == [(5.0, 'stop'), (7.0, 'stop')]
    assert reports == [('robot1', 'arrived')] * 4
    assert navigator.map_frame == 'map'


def test_the_follower_gets_paths_and_its_status_is_reported(node):
    heard, reports = [], []
    names = {'robot1': 'follower', 'robot2': 'follower'}
    outputs = PlanOutputs(node, names, 'map', lambda *report: reports.append(report))
    other = rclpy.create_node('follower', namespace='/robot1', context=node.context)
    other.create_subscription(Path, 'plan', heard.append, 10)
    status = other.create_publisher(DiagnosticStatus, 'follower_status', 10)
    executor = SingleThreadedExecutor(context=node.context)
    for part in (node, other):
        executor.add_node(part)

    def spin_until(condition):
        for _ in range(400):
            if condition():
                return
            executor.spin_once(timeout_sec=0.05)
        raise AssertionError(condition)

    spin_until(lambda: status.get_subscription_count() > 0)
    outputs.send(1.0, {'robot1': plan('robot1', 3.0)})
    spin_until(lambda: heard)
    assert heard[0].header.frame_id == 'map'
    assert [pose.pose.position.x for pose in heard[0].poses] == [0.0, 3.0]
    outputs.send(2.0, {})
    spin_until(lambda: len(heard) > 1)
    assert heard[1].poses == []
    status.publish(DiagnosticStatus(message='lost in thought'))  # no word of the list: omitted
    report = FollowerReport(FollowerState.BLOCKED, 'obstacle', 12.5)
    status.publish(follower_status_message(MESSAGES, 'robot1', report))
    spin_until(lambda: reports)
    assert reports == [('robot1', report)]
    other.destroy_node()


def test_an_unknown_navigator_is_refused():
    with pytest.raises(ConfigError, match="navigator is 'magic', expected one of"):
        maker('magic')
