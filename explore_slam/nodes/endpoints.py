"""Publishers and subscriptions from the topic tables, and the broadcaster of transforms."""

import contextlib
from collections.abc import Callable, Iterable
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.subscription import Subscription

from explore_slam.messages.topics import GlobalTopic, Qos, Topic
from explore_slam.nodes.ros_types import message_class


def qos_profile(qos: Qos) -> QoSProfile:
    """Return the profile of rclpy."""
    return QoSProfile(
        depth=qos.depth,
        reliability=(
            QoSReliabilityPolicy.RELIABLE if qos.reliable else QoSReliabilityPolicy.BEST_EFFORT
        ),
        durability=(
            QoSDurabilityPolicy.TRANSIENT_LOCAL if qos.latched else QoSDurabilityPolicy.VOLATILE
        ),
    )


def relative_name(topic: Topic, vehicle: str = '') -> str:
    """Return the name of a topic in a node: below a vehicle's name, or in the node's namespace."""
    return f'{vehicle}/{topic.value}' if vehicle else str(topic.value)


def publisher(node: Node, topic: Topic, vehicle: str = '') -> Publisher:
    """Create a publisher; `vehicle` is empty in nodes that live in a vehicle's namespace."""
    return node.create_publisher(
        message_class(topic.message_type),
        relative_name(topic, vehicle),
        qos_profile(topic.offered),
    )


def subscribe(
    node: Node,
    topic: Topic,
    callback: Callable[[Any], None],
    vehicle: str = '',
    qos: Qos | None = None,
) -> Subscription:
    """Create a subscription with the requested quality of service, or with another one."""
    return node.create_subscription(
        message_class(topic.message_type),
        relative_name(topic, vehicle),
        callback,
        qos_profile(topic.requested if qos is None else qos),
    )


class TransformBroadcaster:
    """Publishes transforms on /tf and /tf_static; does nothing where tf2_msgs is not installed."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._type: Any = None
        self._publishers: dict[Topic, Publisher] = {}
        with contextlib.suppress(ImportError):
            self._type = message_class(GlobalTopic.TF.message_type)

    def send(self, transform: Any) -> None:
        """Publish a transform that changes."""
        self._send(GlobalTopic.TF, [transform])

    def send_static(self, transforms: Iterable[Any]) -> None:
        """Publish the transforms that never change; one message holds all of a node."""
        self._send(GlobalTopic.TF_STATIC, transforms)

    def _send(self, topic: Topic, transforms: Iterable[Any]) -> None:
        if self._type is None:
            return
        if topic not in self._publishers:
            self._publishers[topic] = publisher(self._node, topic)
        self._publishers[topic].publish(self._type(transforms=list(transforms)))
