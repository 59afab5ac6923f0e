"""nav2's controller as navigator: it follows the paths of the agent, by the action FollowPath."""

from rclpy.node import Node

from explore_slam.nodes.navigators.nav2 import FOLLOW_PATH, Nav2Navigator
from explore_slam.nodes.navigators.navigator import Report


def make(node: Node, vehicle: str, map_frame: str, report: Report) -> Nav2Navigator:
    """Make a navigator that sends paths; see MakeNavigator."""
    return Nav2Navigator(node, vehicle, map_frame, report, FOLLOW_PATH)
