"""The agent's heartbeat on `<vehicle>/agent_alive`, ten times a second of real time.

A path follower that has received it once stops within heartbeat_timeout after it ends: poses and
plans come too seldom to detect in time that the agent has ended.
"""

from collections.abc import Iterable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_msgs.msg import Empty

from explore_slam.messages.topics import VehicleTopic
from explore_slam.nodes.endpoints import publisher

PERIOD = 0.1  # s


class Heartbeat:
    """Publishes the heartbeat for vehicles from the node's executor."""

    def __init__(self, node: Node, vehicles: Iterable[str]) -> None:
        self._publishers = [
            publisher(node, VehicleTopic.AGENT_ALIVE, vehicle) for vehicle in vehicles
        ]
        self._timer = node.create_timer(
            PERIOD, self._beat, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def _beat(self) -> None:
        for output in self._publishers:
            output.publish(Empty())

    def stop(self) -> None:
        """Stop publishing."""
        self._timer.cancel()
