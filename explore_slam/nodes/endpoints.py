"""Publishers and subscriptions from the topic tables, and the broadcaster of transforms."""

import contextlib
from collections.abc import Callable, Iterable
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.subscription import Subscription

from explore_slam.messages.topics import GlobalTopic, Qos, Topic
from explore_slam.nodes.ros_types import message_class

_TOPIC_CHECK = 50  # transforms of a vehicle between two looks at the topic that its nodes use


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
    callback: Callable[..., None],
    vehicle: str = '',
    qos: Qos | None = None,
) -> Subscription:
    """Create a subscription with the requested quality of service, or with another one.

    callback: takes the message, or the message and rclpy's information about it.
    """
    return node.create_subscription(
        message_class(topic.message_type),
        relative_name(topic, vehicle),
        callback,
        qos_profile(topic.requested if qos is None else qos),
    )


def subscribe_latched_or_not(
    node: Node, topic: Topic, callback: Callable[[Any], None], vehicle: str = ''
) -> None:
    """Subscribe to publishers that are latched and to those that are not, as many tools are.

    A latched message arrives twice at a late subscriber: the callback must not mind.
    """
    quiet = SubscriptionEventCallbacks(use_default_callbacks=False)  # the other one matches
    for latched in (True, False):
        node.create_subscription(
            message_class(topic.message_type),
            relative_name(topic, vehicle),
            callback,
            qos_profile(topic.requested._replace(latched=latched)),
            event_callbacks=quiet if latched else None,
        )


class TransformBroadcaster:
    """Publishes transforms on /tf and /tf_static; does nothing where tf2_msgs is not installed.

    A vehicle whose own nodes use <vehicle>/tf (as nav2 starts several robots) gets its transforms
    there: its frames have no prefix, and on /tf they would mix with those of the others.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._type: Any = None
        self._publishers: dict[str, Publisher] = {}
        self._sent: dict[str, int] = {}
        self._names: dict[str, str] = {}
        with contextlib.suppress(ImportError):
            self._type = message_class(GlobalTopic.TF.message_type)

    def send(self, transform: Any, vehicle: str = '') -> None:
        """Publish a transform that changes; the vehicle's name in nodes of a whole team."""
        if vehicle and self._sent.get(vehicle, 0) % _TOPIC_CHECK == 0:
            own = f'{vehicle}{GlobalTopic.TF.value}'
            namespaced = self._node.count_publishers(own) > (self._names.get(vehicle) == own)
            self._names[vehicle] = own if namespaced else GlobalTopic.TF.value
        self._sent[vehicle] = self._sent.get(vehicle, 0) + 1
        name = self._names.get(vehicle, GlobalTopic.TF.value)
        self._send(name, GlobalTopic.TF.offered, [transform])

    def send_static(self, transforms: Iterable[Any]) -> None:
        """Publish the transforms that never change; one message holds all of a node."""
        topic = GlobalTopic.TF_STATIC
        self._send(topic.value, topic.offered, transforms)

    def _send(self, name: str, qos: Qos, transforms: Iterable[Any]) -> None:
        if self._type is None:
            return
        if name not in self._publishers:
            self._publishers[name] = self._node.create_publisher(
                self._type, name, qos_profile(qos)
            )
        self._publishers[name].publish(self._type(transforms=list(transforms)))
