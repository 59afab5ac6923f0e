"""Publishers and subscriptions from the topic tables, and the broadcaster of transforms."""

import contextlib
import time
from collections.abc import Callable, Iterable
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.subscription import Subscription

from explore_slam.messages.topics import GlobalTopic, Qos, Topic
from explore_slam.nodes.ros_types import message_class

_FETCH_POLL = 0.2  # s between looks for latched publishers that are new
_FETCH_TIMEOUT = 10.0  # s for discovery, after which a publisher has nothing to be fetched
_FETCH_REST = 1.0  # s after a message that was fetched, for those that follow it
_FETCH_PATIENCE = 5.0  # s to wait for publishers to go that are not latched, as ros2 topic pub
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
    name: str = '',
) -> Subscription:
    """Create a subscription with the requested quality of service, or with another one.

    name: of the topic, below the vehicle's name or the node's namespace; '': its usual one.
    callback: takes the message, or the message and rclpy's information about it.
    """
    return node.create_subscription(
        message_class(topic.message_type),
        f'{vehicle}/{name}'.lstrip('/') if name else relative_name(topic, vehicle),
        callback,
        qos_profile(topic.requested if qos is None else qos),
    )


class LatchedOrNotSubscription:
    """Subscription to publishers that are latched and to those that are not, as many tools are.

    A subscription that is not latched takes what either publishes from now on. What a latched
    publisher has published before is fetched by a second one, which exists for a while after such
    a publisher has appeared: its quality of service is incompatible with publishers that are not
    latched, which say so on their terminals. A message may arrive twice: the callback must not
    mind.
    """

    def __init__(
        self, node: Node, topic: Topic, callback: Callable[[Any], None], vehicle: str = ''
    ) -> None:
        self._node = node
        self._topic, self._vehicle, self._callback = topic, vehicle, callback
        self._name = node.resolve_topic_name(relative_name(topic, vehicle))
        self._known: set[tuple[int, ...]] = set()  # latched publishers that have been asked
        self._since = 0.0  # monotonic s; when the first one that has not been asked was seen
        self._fetching: Subscription | None = None
        self._until = 0.0  # monotonic s
        subscribe(node, topic, callback, vehicle, topic.requested._replace(latched=False))
        self._look()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(_FETCH_POLL, self._look, clock=steady)

    def _look(self) -> None:
        """Begin to fetch from latched publishers that are new, or end it when its time is over."""
        now = time.monotonic()
        if self._fetching is not None:
            if now >= self._until:
                self._node.destroy_subscription(self._fetching)
                self._fetching = None
            return
        latched, plain = set[tuple[int, ...]](), False
        for info in self._node.get_publishers_info_by_topic(self._name):
            if info.qos_profile.durability is QoSDurabilityPolicy.TRANSIENT_LOCAL:
                latched.add(tuple(info.endpoint_gid))
            else:
                plain = True
        self._known &= latched
        if latched == self._known:
            self._since = now
        elif not plain or now - self._since > _FETCH_PATIENCE:
            self._known = latched
            self._until = now + _FETCH_TIMEOUT
            qos = self._topic.requested._replace(latched=True)
            self._fetching = subscribe(
                self._node, self._topic, self._on_retained, self._vehicle, qos
            )

    def _on_retained(self, message: Any) -> None:
        self._until = min(self._until, time.monotonic() + _FETCH_REST)
        self._callback(message)


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
