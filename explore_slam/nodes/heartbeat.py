"""The agent's heartbeat: `<vehicle>/agent_alive`, ten times a second of real time.

A path follower that has once heard it stops within heartbeat_timeout when it ends: poses and plans
come too seldom to tell in time that the agent is gone.
"""

from collections.abc import Iterable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import Empty

TOPIC = 'agent_alive'
PERIOD = 0.1  # s
QOS = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)


class Heartbeat:
    """Publishes the heartbeat for vehicles from the node's executor."""

    def __init__(self, node: Node, vehicles: Iterable[str]) -> None:
        self._publishers = [
            node.create_publisher(Empty, f'{vehicle}/{TOPIC}', QOS) for vehicle in vehicles
        ]
        self._timer = node.create_timer(
            PERIOD, self._beat, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def _beat(self) -> None:
        for publisher in self._publishers:
            publisher.publish(Empty())

    def stop(self) -> None:
        """Fall silent."""
        self._timer.cancel()
