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
    """A bt_navigator or controller_server that does what a test wants."""

    def __init__(self, kind):
        self.context = rclpy.Context()
        self.context.init(domain_id=DOMAIN)
        self.node = rclpy.create_node('server', namespace='/robot1', context=self.context)
        self.goals, self.outcome, self.accepts, self.canceled = [], 'succeed', True, 0
        self.release, self.left = threading.Event(), threading.Event()
        self.type = getattr(NAV2, kind.type_name)
        self.kind = kind
        self._server = ActionServer(
            self.node,
            self.type,
            kind.name,
            execute_callback=self.execute,
            goal_callback=lambda _: GoalResponse.ACCEPT if self.accepts else GoalResponse.REJECT,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
        )
        # the executor must go on while a goal is executed
        self._executor = rclpy.executors.MultiThreadedExecutor(4, context=self.context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._executor.spin, daemon=True)
        self._thread.start()

    def end(self):
        """End the node; goals that are executed are never heard of again."""
        if self.left.is_set():
            return
        self.left.set()
        self._executor.shutdown(timeout_sec=5.0)
        self._thread.join(timeout=5.0)
        self._server.destroy()
        self.node.destroy_node()
        self.context.try_shutdown()

    def execute(self, handle):
        self.goals.append(handle.request)
        while not self.release.wait(0.02):
            if self.left.is_set():
                return self.type.Result()
            if self.outcome != 'be silent':
                handle.publish_feedback(self.type.Feedback())
            if handle.is_cancel_requested:
                self.canceled += 1
                handle.canceled()
                return self.type.Result()
        if self.outcome == 'abort':
            handle.abort()
            return self.type.Result(error_code=103, error_msg='no valid path')
        handle.succeed()
        return self.type.Result()


KINDS = {'nav2': module.NAVIGATE_TO_POSE, 'nav2_path': module.FOLLOW_PATH}


@pytest.fixture(params=KINDS)
def robot(request, monkeypatch):
    """A server in a thread of its own, and a navigator with the reports that it has made."""
    kind = KINDS[request.param]
    if not hasattr(NAV2, kind.type_name):
        pytest.skip(f'nav2_msgs has no {kind.type_name}: python tools/build_messages.py nav2_msgs')
    monkeypatch.setattr(module, 'SILENCE', 1.0)
    context = rclpy.Context()
    context.init(domain_id=DOMAIN)
    server = Server(kind)
    node = rclpy.create_node('agent', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    reports = []
    navigator = maker(request.param)(node, 'robot1', 'map', reports.append)

    def spin_until(condition, seconds=20.0):
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, [(r.state.value, r.reason) for r in reports]
            executor.spin_once(timeout_sec=0.02)

    yield server, navigator, reports, spin_until
    server.release.set()
    server.end()
    node.destroy_node()
    context.try_shutdown()


def plan(x, y=0.0):
    return Plan(1.0, 'robot1', Pose2(x, y, 0.5), np.array([[0.0, 0.0], [x, y]]))


def wait_for(condition, seconds=20.0):
    """Wait for what the server does in its thread."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def states(reports):
    return [report.state for report in reports]


def test_a_goal_is_driven_to_and_reached(robot):
    server, navigator, reports, spin_until = robot
    navigator.follow(1.0, plan(2.0, 1.0))
    spin_until(lambda: FollowerState.DRIVING in states(reports) and server.goals)
    given = server.goals[0]
    if hasattr(given, 'path'):
        assert given.path.header.frame_id == 'map'
        poses = np.array([planar_pose(stamped.pose) for stamped in given.path.poses])
        assert poses[0, :2].tolist() == [0.0, 0.0]
        assert np.hypot(*np.diff(poses[:, :2], axis=0).T).max() < 0.051
        assert poses[:-1, 2] == pytest.approx(math.atan2(1.0, 2.0))
        goal = poses[-1]
    else:
        assert given.pose.header.frame_id == 'map'
        goal = planar_pose(given.pose.pose)
    assert math.dist(goal, (2.0, 1.0, 0.5)) < 1e-6
    server.release.set()
    spin_until(lambda: FollowerState.ARRIVED in states(reports))
    assert len(server.goals) == 1
    assert reports[-1].since > 0.0


def test_another_way_to_the_same_goal_is_news_only_for_who_follows_the_path(robot):
    server, navigator, reports, spin_until = robot
    navigator.follow(1.0, plan(2.0, 1.0))
    spin_until(lambda: FollowerState.DRIVING in states(reports) and server.goals)
    navigator.follow(2.0, plan(2.02, 1.0))
    if hasattr(server.goals[0], 'path'):
        spin_until(lambda: len(server.goals) == 2)
        assert server.goals[1].path.poses[-1].pose.position.x == pytest.approx(2.02)
    server.release.set()
    spin_until(lambda: FollowerState.ARRIVED in states(reports))
    count = 1 + hasattr(server.goals[0], 'path')
    assert len(server.goals) == count
    # nav2 is content, the agent is not: it goes on, and each newer plan is sent once
    for stamp in (3.0, 4.0):
        navigator.follow(stamp, plan(2.02, 1.0))
        count += 1
        spin_until(lambda wanted=count: len(server.goals) == wanted)
        spin_until(lambda: states(reports)[-1] is FollowerState.ARRIVED)
    assert len(server.goals) == count


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


def test_a_stop_cancels_before_it_returns(robot):
    server, navigator, reports, spin_until = robot
    navigator.follow(1.0, plan(2.0))
    spin_until(lambda: FollowerState.DRIVING in states(reports) and server.goals)
    navigator.stop(2.0)
    assert reports[-1].state is FollowerState.WAITING
    wait_for(lambda: server.canceled == 1)  # though the executor of the navigator has ended


def test_a_stop_cancels_a_goal_whose_acceptance_was_not_heard(robot):
    server, navigator, reports, spin_until = robot
    navigator.follow(1.0, plan(2.0))
    spin_until(lambda: reports and reports[-1].reason == 'goal sent')
    navigator.stop(2.0)
    wait_for(lambda: server.canceled == 1)
    assert FollowerState.DRIVING not in states(reports)


def test_a_goal_is_sent_again_to_a_server_that_comes_back(robot, monkeypatch):
    monkeypatch.setattr(module, 'SILENCE', 60.0)
    server, navigator, reports, spin_until = robot
    navigator.follow(1.0, plan(2.0))
    spin_until(lambda: FollowerState.DRIVING in states(reports) and server.goals)
    server.end()
    spin_until(lambda: 'has no server' in reports[-1].reason)
    assert reports[-1].state is FollowerState.WAITING
    again = Server(server.kind)
    spin_until(lambda: reports[-1].state is FollowerState.DRIVING)  # the plan has not changed
    spin_until(lambda: len(again.goals) == 1)
    again.release.set()
    spin_until(lambda: reports[-1].state is FollowerState.ARRIVED)
    again.end()


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
