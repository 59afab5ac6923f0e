"""Velocity commands as Twist and as TwistStamped, on one topic.

A participant of DDS knows one type per topic, and a context of rclpy is one participant. Where
both types are needed at the same time, the second one gets a participant of its own.
"""

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher

from explore_slam.messages.motion import stamped_twist_message, twist_message
from explore_slam.messages.topics import STAMPED_VELOCITY, Topic, VehicleTopic
from explore_slam.nodes.endpoints import qos_profile, relative_name
from explore_slam.nodes.node_support import SILENCE, now_seconds
from explore_slam.nodes.ros_types import MESSAGES, message_class

_LOOK_PERIOD = 0.2  # s between looks at who is on the topic
# s for which subscribers may take another type than is sent: those that take both follow soon
_PATIENCE = 2.0
_SENDING = 1.0  # s after a command during which commands count as being sent
_PLAIN, _STAMPED = VehicleTopic.VELOCITY_COMMAND.message_type, STAMPED_VELOCITY
_TYPES = {'twist': _PLAIN, 'stamped': _STAMPED}

_UNNAMED = '_NODE_NAME_UNKNOWN_'  # rmw's word for a node that is not discovered yet

Take = Callable[[float, float], None]


class _SecondParticipant:
    """A node beside another one, in a context of its own; what it receives comes in a thread."""

    def __init__(self, beside: Node, topic: Topic) -> None:
        self._context = Context()
        self._context.init(domain_id=beside.context.get_domain_id(), initialize_logging=False)
        self.node = Node(
            f'{beside.get_name()}_{topic.value}',
            namespace=beside.get_namespace(),
            context=self._context,
            use_global_arguments=False,  # its topics are named as resolved by the other node
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, name=topic.value, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            return

    def close(self) -> None:
        """Release the participant."""
        self._context.try_shutdown()
        self._thread.join()
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.destroy()


def _short(message_type: str) -> str:
    return message_type.rpartition('/')[2]


def _listed(infos: Iterable[Any]) -> str:
    """Return the nodes of endpoints with their types."""
    return ', '.join(sorted(f'{_node_of(info)} ({_short(info.topic_type)})' for info in infos))


def _node_of(info: Any) -> str:
    """Return the full name of an endpoint's node, which is discovered later than the endpoint."""
    if info.node_name == _UNNAMED:
        return 'a node'
    return f'{info.node_namespace.rstrip("/")}/{info.node_name}'


class VelocityInput:
    """Velocity commands to vehicles, of either type.

    Twist is subscribed to from the beginning, TwistStamped from when somebody publishes it.

    takers: vehicle ('' in nodes that live in its namespace) -> takes m/s, rad/s; called in the
    node's executor or in another thread. topic: also that of commands by hand.
    """

    def __init__(
        self,
        node: Node,
        takers: Mapping[str, Take],
        topic: Topic = VehicleTopic.VELOCITY_COMMAND,
    ) -> None:
        self._node = node
        self._topic = topic
        self._second: _SecondParticipant | None = None
        self._stamped: dict[str, Take] = {}  # full name -> taker, until it is subscribed to
        self._qos = qos_profile(topic.requested)
        for vehicle, take in takers.items():
            name = relative_name(topic, vehicle)
            node.create_subscription(
                message_class(_PLAIN), name, partial(self._on_plain, take), self._qos
            )
            self._stamped[node.resolve_topic_name(name)] = take
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(_LOOK_PERIOD, self._look, clock=steady)

    @staticmethod
    def _on_plain(take: Take, message: Any) -> None:
        take(float(message.linear.x), float(message.angular.z))

    @staticmethod
    def _on_stamped(take: Take, message: Any) -> None:
        take(float(message.twist.linear.x), float(message.twist.angular.z))

    def _look(self) -> None:
        """Subscribe to TwistStamped where it is published."""
        for name, take in list(self._stamped.items()):
            infos = self._node.get_publishers_info_by_topic(name)
            if not any(info.topic_type == _STAMPED for info in infos):
                continue
            if self._second is None:
                self._second = _SecondParticipant(self._node, self._topic)
            callback = partial(self._on_stamped, take)
            self._second.node.create_subscription(
                message_class(_STAMPED), name, callback, self._qos
            )
            del self._stamped[name]
            self._node.get_logger().info(f'{name} is taken as TwistStamped, too: {_listed(infos)}')

    def close(self) -> None:
        """Take no more commands; the subscriptions of the node itself are the node's."""
        self._stamped.clear()
        if self._second is not None:
            self._second.close()
            self._second = None


class VelocityOutput:
    """Publisher of the velocity commands to one vehicle, in whose namespace the node lives.

    kind: twist, stamped, or auto: as the subscribers take them, of both types if there are both;
    while there is none, as before, and Twist at first.
    frame: of the commands (header.frame_id).
    """

    def __init__(self, node: Node, kind: str, frame: str) -> None:
        self._node = node
        self._frame = frame
        self._topic = VehicleTopic.VELOCITY_COMMAND
        self._name = node.resolve_topic_name(relative_name(self._topic))
        self._second: _SecondParticipant | None = None
        self._own: tuple[str, Publisher] | None = None  # type and publisher of the node
        self._other: tuple[str, Publisher] | None = None  # of the second participant
        self._sent = -1e9  # monotonic s
        self._silent_since: float | None = None  # monotonic s; commands without a subscriber
        self._unfit_since: float | None = None  # monotonic s
        self._told = ''  # the newest warning, which is not repeated
        self._kind = kind
        self._publish_as([_TYPES.get(kind, _PLAIN)])
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(_LOOK_PERIOD, self._look, clock=steady)

    @property
    def types(self) -> list[str]:
        """Types in which commands are sent, without their package."""
        return sorted(_short(item[0]) for item in (self._own, self._other) if item is not None)

    def configure(self, kind: str) -> None:
        """Replace the kind."""
        self._kind = kind
        self._look()

    def send(self, linear: float, angular: float) -> None:
        """Command a velocity (m/s, rad/s)."""
        self._sent = time.monotonic()
        for item in (self._own, self._other):
            if item is None:
                continue
            message_type, publisher = item
            if message_type == _STAMPED:
                stamp = now_seconds(self._node)
                publisher.publish(
                    stamped_twist_message(MESSAGES, stamp, self._frame, linear, angular)
                )
            else:
                publisher.publish(twist_message(MESSAGES, linear, angular))

    def wait_for_all_acked(self, timeout: Duration) -> None:
        """Wait until the subscribers have the last command."""
        for item in (self._own, self._other):
            if item is not None:
                item[1].wait_for_all_acked(timeout)

    def close(self) -> None:
        """Release what is not the node's."""
        self._other = None
        if self._second is not None:
            self._second.close()
            self._second = None

    def _look(self) -> None:
        """Publish as the subscribers take it; name those that take something else."""
        infos = self._node.get_subscriptions_info_by_topic(self._name)
        taken = {info.topic_type for info in infos} & {_PLAIN, _STAMPED}
        before = self.types
        if self._kind != 'auto':
            self._publish_as([_TYPES[self._kind]])
        elif taken:
            self._publish_as(sorted(taken))
        if self.types != before:
            text = ' and '.join(self.types)
            self._node.get_logger().info(
                f'{self._name} is sent as {text}: {_listed(infos) or "cmd_vel_type is set"}'
            )
        self._explain(infos)

    def _publish_as(self, wanted: list[str]) -> None:
        """Have a publisher of every type of a list, and no other."""
        if self._other is not None and self._other[0] not in wanted:
            self.close()
        if self._own is not None and self._own[0] not in wanted:
            self._node.destroy_publisher(self._own[1])
            self._own = None
            self.close()  # its type is from now on that of the node
        for message_type in wanted:
            if self._own is None:
                self._own = message_type, self._publisher(self._node, message_type)
            elif message_type != self._own[0] and self._other is None:
                self._second = _SecondParticipant(self._node, self._topic)
                self._other = message_type, self._publisher(self._second.node, message_type)

    def _publisher(self, node: Node, message_type: str) -> Publisher:
        profile = qos_profile(self._topic.offered)
        return node.create_publisher(message_class(message_type), self._name, profile)

    def _explain(self, infos: list[Any]) -> None:
        """Log why the vehicle does not take the commands that are being sent, once per reason."""
        now = time.monotonic()
        fits = any(_short(info.topic_type) in self.types for info in infos)
        if fits:
            self._told, self._silent_since, self._unfit_since = '', None, None
            return
        if now - self._sent > _SENDING:
            self._silent_since = self._unfit_since = None
            return
        text = ''
        if infos:
            since = self._unfit_since = self._unfit_since or now
            if now - since > _PATIENCE:
                text = (
                    f'{self._name} is sent as {" and ".join(self.types)}, which none of its '
                    f'subscribers takes: {_listed(infos)}; set cmd_vel_type to auto, or to what '
                    'the base takes'
                )
        else:
            since = self._silent_since = self._silent_since or now
            if now - since > SILENCE:
                text = f'nobody subscribes to {self._name}: the vehicle does not move'
        if text and text != self._told:
            self._told = text
            self._node.get_logger().warning(text)
