"""nav2 as navigator: an action in the vehicle's namespace, NavigateToPose or FollowPath.

With NavigateToPose nav2 plans its own path, so that a plan whose goal is the one in force changes
nothing. With FollowPath nav2's controller follows the path of the agent, and keeps the right of
way that it was planned with.

What an action says becomes a report: accepted and feedback are driving, succeeded is arrived;
rejected, aborted and silence are blocked, so that the agent chooses another way or vehicle. A
goal that has ended is sent again if a newer plan still wants it, and one whose server has left is
sent to the next server.
"""

import time
import uuid
from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from action_msgs.msg import GoalInfo, GoalStatus
from action_msgs.srv import CancelGoal
from rclpy.action import ActionClient
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from explore_slam.data import FollowerReport, FollowerState, Plan
from explore_slam.errors import ConfigError
from explore_slam.messages import path_message
from explore_slam.messages.base import header, pose_message
from explore_slam.nodes.navigators.navigator import Report
from explore_slam.nodes.ros_types import MESSAGES
from explore_slam.polyline import sample

PERIOD = 0.1  # s between looks at the newest plan and at silence
SILENCE = 10.0  # s of wall time without answer or feedback after which a goal is given up
ABSENCE = 1.0  # s of wall time without server, answer and feedback after which the server has left
OVERTAKING = 0.2  # s by which a cancel may overtake its goal; on loopback 0.01
SAME_GOAL = 0.1  # m and rad; nav2's default goal tolerance is 0.25
PATH_SPACING = 0.05  # m between the poses of a path: nav2's planners make one per cell


class ActionKind(NamedTuple):
    """An action of nav2 and what it takes.

    name: below the vehicle's. type_name: in nav2_msgs.action.
    request(goal, stamp, map_frame, plan): fill in a goal of the action.
    is_in_force(sent, plan): whether a plan needs not be sent after the one that was sent.
    """

    name: str
    type_name: str
    request: Callable[[Any, float, str, Plan], None]
    is_in_force: Callable[[Plan, Plan], bool]


class Nav2Navigator:
    """Client of an action of nav2 of one vehicle; see Navigator.

    `follow` may be called from any thread: the node's executor sends the goals.
    """

    def __init__(
        self, node: Node, vehicle: str, map_frame: str, report: Report, kind: ActionKind
    ) -> None:
        try:
            self._type = getattr(import_module('nav2_msgs.action'), kind.type_name)
        except (ImportError, AttributeError) as error:
            raise ConfigError(
                f'{vehicle}: navigator nav2 needs {kind.type_name} of nav2_msgs, which is not '
                'installed'
            ) from error
        self._kind = kind
        self._node = node
        self._vehicle = vehicle
        self._map_frame = map_frame
        self._report_to = report
        self._action = f'{vehicle}/{kind.name}'
        self._client = ActionClient(node, self._type, self._action)
        # cancels by the identifier of a goal, whose acceptance need not have been heard
        self._canceling = node.create_client(CancelGoal, f'{self._action}/_action/cancel_goal')
        self._wanted: tuple[float, Plan] | None = None  # the newest plan, and its stamp (s)
        self._sent: Plan | None = None
        self._sent_stamp = 0.0
        self._number = 0  # of the goal in force; answers about older ones are ignored
        self._goal_id = GoalInfo().goal_id
        self._accepted = False
        self._busy = False  # a goal was sent and has not ended
        self._heard = 0.0  # monotonic s of the last answer or feedback
        self._state = FollowerReport(FollowerState.WAITING, 'no plan')
        self._timer = node.create_timer(
            PERIOD, self._on_timer, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def follow(self, stamp: float, plan: Plan | None) -> None:
        """Drive as the plan says; None: cancel the goal in force."""
        has_goal = plan is not None and len(plan.waypoints) > 0
        self._wanted = (stamp, plan) if plan is not None and has_goal else None

    def stop(self, stamp: float) -> None:
        """Cancel the goal in force at once.

        A goal whose acceptance was not heard is canceled twice: nobody may be left to hear it, and
        the first request may have overtaken the goal, or the server may not be discovered yet.
        """
        self.follow(stamp, None)
        if self._sent is None:
            return
        goal, unheard = self._goal_id, self._busy and not self._accepted
        self._give_up(FollowerState.WAITING, 'no plan')
        if unheard:
            time.sleep(OVERTAKING)
            self._canceling.wait_for_service(ABSENCE)
            self._cancel(goal)

    # -- in the executor of the node -----------------------------------------------------------

    def _on_timer(self) -> None:
        wanted = self._wanted
        if wanted is None:
            if self._sent is not None:
                self._give_up(FollowerState.WAITING, 'no plan')
        elif self._busy and self._has_no_server():
            # it has forgotten the goal: the next one gets it
            self._give_up(FollowerState.WAITING, f'{self._action} has no server')
        elif self._is_news(*wanted):
            self._send(*wanted)
        elif self._busy and time.monotonic() - self._heard > SILENCE:
            sent = self._sent
            self._give_up(FollowerState.BLOCKED, f'nav2 silent for {SILENCE:.0f} s')
            self._sent = sent  # not again before the agent has another plan

    def _is_news(self, stamp: float, plan: Plan) -> bool:
        """Return whether a plan differs from the one that was sent, or wants it once more.

        nav2 is content at its own tolerance: a vehicle that the agent wants nearer is sent again.
        """
        again = not self._busy and stamp > self._sent_stamp
        return self._sent is None or again or not self._kind.is_in_force(self._sent, plan)

    def _has_no_server(self) -> bool:
        silent = time.monotonic() - self._heard > ABSENCE
        return silent and not self._client.server_is_ready()

    def _send(self, stamp: float, plan: Plan) -> None:
        if not self._client.server_is_ready():
            self._sent = None  # whoever comes next gets it
            self._report(FollowerState.WAITING, f'{self._action} has no server')
            return
        self._number += 1
        self._sent, self._accepted, self._busy = plan, False, True
        self._goal_id = GoalInfo().goal_id
        self._goal_id.uuid = np.frombuffer(uuid.uuid4().bytes, np.uint8)
        self._sent_stamp = stamp
        self._heard = time.monotonic()
        request = self._type.Goal()
        self._kind.request(request, stamp, self._map_frame, plan)
        number = self._number
        self._report(FollowerState.WAITING, 'goal sent')
        future = self._client.send_goal_async(
            request, lambda _: self._on_feedback(number), self._goal_id
        )
        future.add_done_callback(lambda done: self._on_answer(number, done.result()))

    def _on_answer(self, number: int, handle: Any) -> None:
        if number != self._number:
            if handle.accepted:  # given up or replaced before that was heard
                handle.cancel_goal_async()
            return
        self._heard = time.monotonic()
        if not handle.accepted:
            self._busy = False
            self._report(FollowerState.BLOCKED, 'nav2 has rejected the goal')
            return
        self._accepted = True
        self._report(FollowerState.DRIVING, '')
        handle.get_result_async().add_done_callback(
            lambda done: self._on_result(number, done.result())
        )

    def _on_feedback(self, number: int) -> None:
        if number == self._number and self._accepted:
            self._heard = time.monotonic()

    def _on_result(self, number: int, answer: Any) -> None:
        if number != self._number:
            return
        self._busy = False
        if answer.status == GoalStatus.STATUS_SUCCEEDED:
            self._report(FollowerState.ARRIVED, 'goal reached')
        elif answer.status == GoalStatus.STATUS_CANCELED:
            self._report(FollowerState.BLOCKED, 'the goal was canceled by another node')
        else:
            result = answer.result
            text = f'nav2 aborted the goal, error {result.error_code} {result.error_msg}'
            self._report(FollowerState.BLOCKED, text.strip())

    def _give_up(self, state: FollowerState, reason: str) -> None:
        """Cancel the goal in force; its later feedback and result are ignored."""
        self._number += 1
        if self._busy:
            self._cancel(self._goal_id)
        self._sent, self._busy = None, False
        self._report(state, reason)

    def _cancel(self, goal: Any) -> None:
        """Ask the server to cancel a goal (unique_identifier_msgs/UUID), if there is a server."""
        if self._canceling.service_is_ready():
            request = CancelGoal.Request()
            request.goal_info.goal_id = goal
            self._canceling.call_async(request)

    def _report(self, state: FollowerState, reason: str) -> None:
        if (state, reason) != (self._state.state, self._state.reason):
            now = self._node.get_clock().now().nanoseconds * 1e-9
            self._state = FollowerReport(state, reason, now)
            self._report_to(self._state)


def _fill_in_pose(goal: Any, stamp: float, map_frame: str, plan: Plan) -> None:
    goal.pose.header = header(MESSAGES, stamp, map_frame)
    goal.pose.pose = pose_message(MESSAGES, plan.goal)


def _have_same_goal(sent: Plan, plan: Plan) -> bool:
    return max(abs(value) for value in sent.goal.between(plan.goal)) <= SAME_GOAL


NAVIGATE_TO_POSE = ActionKind('navigate_to_pose', 'NavigateToPose', _fill_in_pose, _have_same_goal)


def _fill_in_path(goal: Any, stamp: float, map_frame: str, plan: Plan) -> None:
    points = sample(plan.waypoints, PATH_SPACING)
    steps = np.diff(points, axis=0)
    headings = np.append(np.arctan2(steps[:, 1], steps[:, 0]), plan.goal.theta)
    poses = np.column_stack([points, headings])
    goal.path = path_message(MESSAGES, stamp, map_frame, poses)


def _have_same_path(sent: Plan, plan: Plan) -> bool:
    return _have_same_goal(sent, plan) and np.array_equal(sent.waypoints, plan.waypoints)


FOLLOW_PATH = ActionKind('follow_path', 'FollowPath', _fill_in_path, _have_same_path)


def make(node: Node, vehicle: str, map_frame: str, report: Report) -> Nav2Navigator:
    """Make a navigator that sends goals; see MakeNavigator."""
    return Nav2Navigator(node, vehicle, map_frame, report, NAVIGATE_TO_POSE)
