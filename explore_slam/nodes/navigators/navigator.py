"""What the agent needs of a navigator: plans go out, reports come back."""

from collections.abc import Callable
from typing import Protocol

from rclpy.node import Node

from explore_slam.data import FollowerReport, Plan

#: Called with each report of the navigator.
type Report = Callable[[FollowerReport], None]


class Navigator(Protocol):
    """Drives one vehicle along the plans of the agent."""

    def follow(self, stamp: float, plan: Plan | None) -> None:
        """Replace the plan in force at a time (s); None: the vehicle stays where it is.

        May be called from any thread, and may take effect a little later.
        """

    def stop(self, stamp: float) -> None:
        """Stop the vehicle at a time (s), before this returns: the node may end next.

        Called from the executor of the node.
        """


class MakeNavigator(Protocol):
    """Makes the navigator of a vehicle."""

    def __call__(self, node: Node, vehicle: str, map_frame: str, report: Report, /) -> Navigator:
        """Make a navigator.

        node: of the agent, for publishers, subscriptions and action clients. map_frame: frame of
        the plans. report: to be called from the executor of the node.
        """
