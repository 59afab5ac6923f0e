"""The path follower of this package, or any other node on its topics `plan`, `follower_status`."""

from typing import Any

import numpy as np
from rclpy.node import Node

from explore_slam.data import Plan
from explore_slam.errors import DataError
from explore_slam.messages import path_message
from explore_slam.messages.follower_status import follower_report
from explore_slam.messages.topics import VehicleTopic
from explore_slam.nodes.endpoints import publisher, subscribe
from explore_slam.nodes.navigators.navigator import Report
from explore_slam.nodes.node_support import WARNING_PERIOD
from explore_slam.nodes.ros_types import MESSAGES


class FollowerNavigator:
    """Publishes plans, and passes on the status of the follower; see Navigator."""

    def __init__(self, node: Node, vehicle: str, map_frame: str, report: Report) -> None:
        self._map_frame = map_frame
        self._plan = publisher(node, VehicleTopic.PLAN, vehicle)
        self._node = node
        self._vehicle = vehicle
        self._report = report
        subscribe(node, VehicleTopic.FOLLOWER_STATUS, self._on_status, vehicle)

    def _on_status(self, message: Any) -> None:
        try:
            self._report(follower_report(message))
        except DataError as error:
            self._node.get_logger().warning(
                f'{self._vehicle}: {error}; message omitted',
                throttle_duration_sec=WARNING_PERIOD,
            )

    def follow(self, stamp: float, plan: Plan | None) -> None:
        """Publish the path of the plan; an empty one stops the vehicle."""
        points = np.empty((0, 2)) if plan is None else plan.waypoints
        self._plan.publish(path_message(MESSAGES, stamp, self._map_frame, points))

    def stop(self, stamp: float) -> None:
        """Publish an empty path."""
        self.follow(stamp, None)


make = FollowerNavigator
