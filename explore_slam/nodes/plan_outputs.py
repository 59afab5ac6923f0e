"""The plans of the team on their way to the navigators of the vehicles."""

from collections.abc import Callable, Mapping
from functools import partial

from rclpy.node import Node

from explore_slam.data import FollowerReport, Plan
from explore_slam.nodes.navigators import maker


class PlanOutputs:
    """The navigator of each vehicle, and the plan that it has been sent last.

    navigators: vehicle -> name of its navigator. map_frame: frame of the plans.
    report: called with (vehicle, report) for every report of a navigator.
    """

    def __init__(
        self,
        node: Node,
        navigators: Mapping[str, str],
        map_frame: str,
        report: Callable[[str, FollowerReport], None],
    ) -> None:
        self._navigators = {
            vehicle: maker(name)(node, vehicle, map_frame, partial(report, vehicle))
            for vehicle, name in navigators.items()
        }
        self._last: dict[str, Plan | None] = {}

    def send(self, stamp: float, plans: Mapping[str, Plan]) -> None:
        """Send the plans that changed; a vehicle without a plan is stopped, once."""
        for vehicle, navigator in self._navigators.items():
            plan = plans.get(vehicle)
            if vehicle not in self._last or plan is not self._last[vehicle]:
                self._last[vehicle] = plan
                navigator.follow(stamp, plan)

    def stop(self, stamp: float) -> None:
        """Stop all vehicles at a time (s), before this returns; from the node's executor."""
        for vehicle, navigator in self._navigators.items():
            self._last[vehicle] = None
            navigator.stop(stamp)
