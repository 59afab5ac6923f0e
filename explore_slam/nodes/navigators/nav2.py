"""nav2 as navigator: each target goes out as the action NavigateToPose in the vehicle's namespace.

nav2 plans its own path, so that a plan whose goal is the one in force changes nothing. What the
action says becomes a report: accepted and feedback are driving, succeeded is arrived; rejected,
aborted and silence are blocked, so that the agent chooses another way or another vehicle.
"""

import time
from typing import Any

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from explore_slam.data import FollowerReport, FollowerState, Plan
from explore_slam.errors import ConfigError
from explore_slam.geometry import Pose2
from explore_slam.messages.base import header, pose_message
from explore_slam.nodes.navigators.navigator import Report
from explore_slam.nodes.ros_types import MESSAGES

ACTION = 'navigate_to_pose'
PERIOD = 0.1  # s between looks at the newest plan and at silence
SILENCE = 10.0  # s of wall time without answer or feedback after which a goal is given up
SAME_GOAL = 0.1  # m and rad; nav2's default goal tolerance is 0.25


class Nav2Navigator:
    """Client of NavigateToPose of one vehicle; see Navigator.

    `follow` may be called from any thread: the node's executor sends the goals.
    """

    def __init__(self, node: Node, vehicle: str, map_frame: str, report: Report) -> None:
        try:
            from nav2_msgs.action import NavigateToPose
        except ImportError as error:
            raise ConfigError(
                f'{vehicle}: navigator nav2 needs nav2_msgs, which is not installed'
            ) from error
        self._type = NavigateToPose
        self._node = node
        self._vehicle = vehicle
        self._map_frame = map_frame
        self._report_to = report
        self._client = ActionClient(node, NavigateToPose, f'{vehicle}/{ACTION}')
        self._wanted: tuple[float, Pose2] | None = None  # stamp (s) and goal of the newest plan
        self._sent: Pose2 | None = None
        self._sent_stamp = 0.0
        self._number = 0  # of the goal in force; answers about older ones are ignored
        self._handle: Any = None
        self._busy = False  # a goal was sent and has not ended
        self._heard = 0.0  # monotonic s of the last answer or feedback
        self._state = FollowerReport(FollowerState.WAITING, 'no plan')
        self._timer = node.create_timer(
            PERIOD, self._on_timer, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def follow(self, stamp: float, plan: Plan | None) -> None:
        """Drive to the goal of the plan; None: cancel the goal in force."""
        has_goal = plan is not None and len(plan.waypoints) > 0
        self._wanted = (stamp, plan.goal) if plan is not None and has_goal else None

    # -- in the executor of the node -----------------------------------------------------------

    def _on_timer(self) -> None:
        wanted = self._wanted
        if wanted is None:
            if self._sent is not None:
                self._give_up(FollowerState.WAITING, 'no plan')
        elif self._sent is None or _differ(wanted[1], self._sent) or self._is_retry(wanted[0]):
            self._send(*wanted)
        elif self._busy and time.monotonic() - self._heard > SILENCE:
            sent = self._sent
            self._give_up(FollowerState.BLOCKED, f'nav2 silent for {SILENCE:.0f} s')
            self._sent = sent  # not again before the agent has another plan

    def _is_retry(self, stamp: float) -> bool:
        """Return whether the agent has sent a plan to the same goal after it had failed."""
        failed = self._state.state is FollowerState.BLOCKED and not self._busy
        return failed and stamp > self._sent_stamp

    def _send(self, stamp: float, goal: Pose2) -> None:
        if not self._client.server_is_ready():
            self._report(FollowerState.WAITING, f'{self._vehicle}/{ACTION} has no server')
            return
        self._number += 1
        self._sent, self._handle, self._busy = goal, None, True
        self._sent_stamp = stamp
        self._heard = time.monotonic()
        request = self._type.Goal()
        request.pose.header = header(MESSAGES, stamp, self._map_frame)
        request.pose.pose = pose_message(MESSAGES, goal)
        number = self._number
        self._report(FollowerState.WAITING, 'goal sent')
        future = self._client.send_goal_async(request, lambda _: self._on_feedback(number))
        future.add_done_callback(lambda done: self._on_answer(number, done.result()))

    def _on_answer(self, number: int, handle: Any) -> None:
        if number != self._number:
            if handle.accepted:
                handle.cancel_goal_async()
            return
        self._heard = time.monotonic()
        if not handle.accepted:
            self._busy = False
            self._report(FollowerState.BLOCKED, 'nav2 has rejected the goal')
            return
        self._handle = handle
        self._report(FollowerState.DRIVING, '')
        handle.get_result_async().add_done_callback(
            lambda done: self._on_result(number, done.result())
        )

    def _on_feedback(self, number: int) -> None:
        if number == self._number and self._handle is not None:
            self._heard = time.monotonic()

    def _on_result(self, number: int, answer: Any) -> None:
        if number != self._number:
            return
        self._handle, self._busy = None, False
        if answer.status == GoalStatus.STATUS_SUCCEEDED:
            self._report(FollowerState.ARRIVED, 'goal reached')
        elif answer.status == GoalStatus.STATUS_CANCELED:
            self._report(FollowerState.BLOCKED, 'the goal was canceled by another node')
        else:
            result = answer.result
            text = f'nav2 aborted the goal, error {result.error_code} {result.error_msg}'
            self._report(FollowerState.BLOCKED, text.strip())

    def _give_up(self, state: FollowerState, reason: str) -> None:
        """Cancel the goal in force; what is heard of it from now on does not count."""
        self._number += 1
        self._sent, self._busy = None, False
        if self._handle is not None:
            self._handle.cancel_goal_async()
            self._handle = None
        self._report(state, reason)

    def _report(self, state: FollowerState, reason: str) -> None:
        if (state, reason) != (self._state.state, self._state.reason):
            now = self._node.get_clock().now().nanoseconds * 1e-9
            self._state = FollowerReport(state, reason, now)
            self._report_to(self._state)


def _differ(a: Pose2, b: Pose2) -> bool:
    increment = a.between(b)
    return max(abs(value) for value in increment) > SAME_GOAL


make = Nav2Navigator
