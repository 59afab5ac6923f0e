"""nav2 as navigator, against an action server of its type: what it says becomes reports."""

import math
import threading
import time

import numpy as np
import pytest
import rclpy
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import SingleThreadedExecutor
from ros_domain import own_domain

from explore_slam.data import FollowerState, Plan
from explore_slam.geometry import Pose2
from explore_slam.messages import planar_pose
from explore_slam.nodes.navigators import maker
from explore_slam.nodes.navigators import nav2 as module

NAV2 = pytest.importorskip(
    'nav2_msgs.action',
    reason='nav2_msgs is not installed: python tools/build_messages.py nav2_msgs',
)
DOMAIN = own_domain(97)


class Server:
    """A bt_navigator that does what a test wants."""

    def __init__(self, context):
        self.node = rclpy.create_node('bt_navigator', namespace='/robot1', context=context)
        self.goals, self.outcome, self.accepts, self.canceled = [], 'succeed', True, 0
        self.release = threading.Event()
        self._server = ActionServer(
            self.node,
            NAV2.NavigateToPose,
            'navigate_to_pose',
            execute_callback=self.execute,
            goal_callback=lambda _: GoalResponse.ACCEPT if self.accepts else GoalResponse.REJECT,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
        )

    def execute(self, handle):
        self.goals.append(handle.request.pose)
        while not self.release.wait(0.02):
            if self.outcome != 'be silent':
                handle.publish_feedback(NAV2.NavigateToPose.Feedback(distance_remaining=1.0))
            if handle.is_cancel_requested:
                self.canceled += 1
                handle.canceled()
                return NAV2.NavigateToPose.Result()
        if self.outcome == 'abort':
            handle.abort()
            return NAV2.NavigateToPose.Result(error_code=103, error_msg='no valid path')
        handle.succeed()
        return NAV2.NavigateToPose.Result()


@pytest.fixture
def robot(monkeypatch):
    """A server in a thread of its own, and a navigator with the reports that it has made."""
    monkeypatch.setattr(module, 'SILENCE', 1.0)
    context = rclpy.Context()
    context.init(domain_id=DOMAIN)
    server = Server(context)
    # the server's executor must go on while a goal is executed
    serving = rclpy.executors.MultiThreadedExecutor(4, context=context)
    serving.add_node(server.node)
    thread = threading.Thread(target=serving.spin, daemon=True)
    thread.start()
    node = rclpy.create_node('agent', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    reports = []
    navigator = maker('nav2')(node, 'robot1', 'map', reports.append)

    def spin_until(condition, seconds=20.0):
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, [(r.state.value, r.reason) for r in reports]
            executor.spin_once(timeout_sec=0.02)

    yield server, navigator, reports, spin_until
    server.release.set()
    serving.shutdown(timeout_sec=5.0)
    thread.join(timeout=5.0)
    node.destroy_node()
    server.node.destroy_node()
    context.try_shutdown()


def plan(x, y=0.0):
    return Plan(1.0, 'robot1', Pose2(x, y, 0.5), np.array([[0.0, 0.0], [x, y]]))


def states(reports):
    return [report.state for report in reports]


def test_a_goal_is_driven_to_and_reached(robot):
    server, navigator, reports, spin_until = robot
    navigator.follow(1.0, plan(2.0, 1.0))
    spin_until(lambda: FollowerState.DRIVING in states(reports) and server.goals)
    assert server.goals[0].header.frame_id == 'map'
    goal = planar_pose(server.goals[0].pose)
    assert math.dist(goal, (2.0, 1.0, 0.5)) < 1e-6
    navigator.follow(2.0, plan(2.02, 1.0))  # the same goal by another way: nav2 plans itself
    server.release.set()
    spin_until(lambda: FollowerState.ARRIVED in states(reports))
    assert len(server.goals) == 1
    assert reports[-1].since > 0.0


def test_aborted_is_blocked_with_the_error(robot):
    server, navigator, reports, spin_until = robot
    server.outcome = 'abort'
    server.release.set()
    navigator.follow(1.0, plan(2.0))
    spin_until(lambda: FollowerState.BLOCKED in states(reports))
    assert reports[-1].reason == 'nav2 aborted the goal, error 103 no valid path'
    server.outcome = 'succeed'
    navigator.follow(2.0, plan(2.0))  # the agent tries the same goal once more
    spin_until(lambda: FollowerState.ARRIVED in states(reports))
    assert len(server.goals) == 2


def test_rejected_is_blocked(robot):
    server, navigator, reports, spin_until = robot
    server.accepts = False
    navigator.follow(1.0, plan(2.0))
    spin_until(lambda: FollowerState.BLOCKED in states(reports))
    assert reports[-1].reason == 'nav2 has rejected the goal'
    server.accepts = True
    server.release.set()
    navigator.follow(2.0, plan(3.0))
    spin_until(lambda: FollowerState.ARRIVED in states(reports))


def test_without_a_plan_the_goal_is_canceled(robot):
    server, navigator, reports, spin_until = robot
    navigator.follow(1.0, plan(2.0))
    spin_until(lambda: FollowerState.DRIVING in states(reports))
    navigator.follow(2.0, None)
    spin_until(lambda: server.canceled == 1)
    assert reports[-1].state is FollowerState.WAITING


def test_silence_of_nav2_is_blocked(robot):
    server, navigator, reports, spin_until = robot
    server.outcome = 'be silent'
    navigator.follow(1.0, plan(2.0))
    spin_until(lambda: FollowerState.BLOCKED in states(reports))
    assert reports[-1].reason == 'nav2 silent for 1 s'
    spin_until(lambda: server.canceled == 1)


def test_without_a_server_the_vehicle_waits():
    context = rclpy.Context()
    context.init(domain_id=DOMAIN)
    node = rclpy.create_node('agent', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    reports = []
    navigator = maker('nav2')(node, 'robot9', 'map', reports.append)
    navigator.follow(1.0, plan(1.0))
    end = time.monotonic() + 20.0
    while not reports and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.05)
    assert reports[0].reason == 'robot9/navigate_to_pose has no server'
    node.destroy_node()
    context.try_shutdown()
