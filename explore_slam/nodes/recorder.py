"""Node `recorder`: records the vehicles' topics into a bag, as received, in a writer thread."""

import argparse
import logging
import queue
import sys
import threading
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from pathlib import Path

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSDurabilityPolicy, QoSReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.utilities import remove_ros_args

from explore_slam.errors import ExploreSlamError
from explore_slam.messages.topics import GlobalTopic, Qos, TopicKind, topic_name, vehicle_topic
from explore_slam.nodes.endpoints import qos_profile
from explore_slam.nodes.node_support import run_node
from explore_slam.nodes.ros_types import message_class
from explore_slam.recording.bag import BagWriter
from explore_slam.recording.ordering import header_stamp
from explore_slam.recording.topic_selection import TopicChoice, topic_choices

DISCOVERY_PERIOD = 0.2  # s between searches for new topics
QUEUE_BYTES = 256 * 2**20  # bytes that may wait for the disk
QUEUE_DEPTH = 50  # messages per subscription


class WriterThread:
    """Writes queued messages to a bag; when the queue is full, new messages are dropped."""

    def __init__(self, writer: BagWriter, limit: int = QUEUE_BYTES) -> None:
        self._writer = writer
        self._limit = limit
        self._held = 0
        self._lock = threading.Lock()
        self._items: queue.SimpleQueue[tuple[str, int, bytes] | None] = queue.SimpleQueue()
        self.dropped: dict[str, int] = {}
        self.error: Exception | None = None
        self._thread = threading.Thread(target=self._work, name='bag writer', daemon=True)
        self._thread.start()

    def put(self, topic: str, log_time: int, data: bytes) -> None:
        """Queue a message."""
        with self._lock:
            if self._held + len(data) > self._limit:
                self.dropped[topic] = self.dropped.get(topic, 0) + 1
                return
            self._held += len(data)
        self._items.put((topic, log_time, data))

    def close(self) -> None:
        """Write the queued messages and close the bag."""
        self._items.put(None)
        self._thread.join()
        self._writer.close()

    def _work(self) -> None:
        while (item := self._items.get()) is not None:
            if self.error is None:
                try:
                    self._writer.write(*item)
                except (
                    Exception
                ) as error:  # reported by the node: a full disk must not end it silently
                    self.error = error
            with self._lock:
                self._held -= len(item[2])


class Recorder(Node):
    """Subscribes to topics as they appear and records them.

    Without `topics` these are the topics of all vehicles, or of the `vehicles` named, those that
    `choices` name by hand, and the transforms, which hold the mounts of the sensors. With
    use_sim_time messages are logged at simulated times.
    """

    def __init__(
        self,
        path: Path,
        topics: Collection[str] = (),
        vehicles: Collection[str] = (),
        *,
        choices: Iterable[TopicChoice] = (),
        use_sim_time: bool = False,
    ) -> None:
        overrides = [Parameter('use_sim_time', value=True)] if use_sim_time else []
        super().__init__('recorder', parameter_overrides=overrides)
        self._topics = {self.resolve_topic_name(topic) for topic in topics}
        self._vehicles = set(vehicles)
        # live topic -> name in the bag, of topics that the user has chosen
        self._chosen = {
            self.resolve_topic_name(name): recorded
            for name, recorded in recorded_names(list(choices)).items()
        }
        self._early: list[tuple[str, bytes]] = []  # received before simulated time begins
        self._writer = BagWriter(path)
        self._thread = WriterThread(self._writer)
        self._subscribed: set[str] = set()
        self._recorded: list[Subscription] = []
        self._reported = 0
        self.counts: dict[str, int] = {}
        self._discover()
        # by the steady clock: simulated time may not have begun yet
        self.create_timer(
            DISCOVERY_PERIOD, self._discover, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    @property
    def dropped(self) -> dict[str, int]:
        """Messages per topic that were dropped because the disk is too slow."""
        return self._thread.dropped

    def stop(self) -> None:
        """Take what has been received, write the queued messages and close the bag."""
        for subscription in self._recorded:
            # nothing spins the node any more: its callbacks are called here
            with subscription.handle:
                while taken := subscription.handle.take_message(subscription.msg_type, True):
                    subscription.callback(taken[0])
        self._thread.close()

    def _wanted(self, topic: str) -> bool:
        if self._topics:
            return topic in self._topics
        if topic in self._chosen or _is_transform(topic):
            return True
        found = vehicle_topic(topic)
        if found is None:
            return False
        # one of several lasers or cameras: '/robot1/front/scan'
        owner = found.vehicle.split('/')[0]
        return not self._vehicles or not self._vehicles.isdisjoint({found.vehicle, owner})

    def _discover(self) -> None:
        if self._thread.error is not None:
            error, self._thread.error = self._thread.error, None
            raise ExploreSlamError(f'{self._writer.path} cannot be written: {error}')
        for topic, types in self.get_topic_names_and_types():
            if topic not in self._subscribed and self._wanted(topic):
                self._subscribe(topic, types)
        lost = sum(self.dropped.values())
        if lost > self._reported:
            self._reported = lost
            self.get_logger().warning(
                f'the disk is too slow: {lost} messages dropped {self.dropped}'
            )

    def _subscribe(self, topic: str, types: Sequence[str]) -> None:
        publishers = self.get_publishers_info_by_topic(topic)
        if not publishers:
            return
        self._subscribed.add(topic)
        if len(types) != 1:
            self.get_logger().error(f'{topic} has several types {types}: not recorded')
            return
        try:
            kind = message_class(types[0])
            latched = all(
                item.qos_profile.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL
                for item in publishers
            )
            name = self._chosen.get(topic, topic)
            self._writer.add_topic(name, types[0], latched=latched)
        except (ImportError, AttributeError, ExploreSlamError) as error:
            self.get_logger().error(f'{topic} is not recorded: {error}')
            return
        reliable = all(
            item.qos_profile.reliability == QoSReliabilityPolicy.RELIABLE for item in publishers
        )
        qos = qos_profile(Qos(QUEUE_DEPTH, reliable, latched))
        self._recorded.append(
            self.create_subscription(kind, topic, self._writer_of(name), qos, raw=True)
        )
        self.get_logger().info(
            f'recording {topic} ({types[0]})' + (f' as {name}' if name != topic else '')
        )

    def _writer_of(self, topic: str) -> Callable[[bytes], None]:
        def take(data: bytes) -> None:
            log_time = self.get_clock().now().nanoseconds
            if not log_time and _is_transform(topic):  # without a header: it waits for the time
                self._early.append((topic, bytes(data)))
                return
            # the clock is 0 before simulated time begins: use the stamp of the message then
            log_time = log_time or header_stamp(data) or 0
            while self._early:
                self._put(*self._early.pop(0), log_time)
            self._put(topic, bytes(data), log_time)

        return take

    def _put(self, topic: str, data: bytes, log_time: int) -> None:
        self.counts[topic] = self.counts.get(topic, 0) + 1
        self._thread.put(topic, log_time, data)


def recorded_names(choices: list[TopicChoice]) -> dict[str, str]:
    """Return topic -> name in the bag, of topics that the user has chosen.

    Of several of one kind, as of two lasers, each keeps its name in the namespace of the vehicle.
    """
    kinds = Counter((item.vehicle, item.kind) for item in choices)
    names = {}
    for item in choices:
        name = topic_name(item.vehicle, item.kind)
        if kinds[item.vehicle, item.kind] > 1 or item.kind is TopicKind.CLOUD:
            below = item.name.removeprefix(f'/{item.vehicle}/').strip('/')
            name = f'/{item.vehicle}/{below}'
        names[item.name] = name
    return names


def _is_transform(topic: str) -> bool:
    return topic.endswith((GlobalTopic.TF.value, GlobalTopic.TF_STATIC.value))


def main(arguments: list[str] | None = None) -> int:
    """Record until SIGINT or SIGTERM: `recorder OUT [--topics T ...] [--vehicles V ...]`."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    parser = argparse.ArgumentParser(prog='recorder', description=__doc__)
    add_options(parser)
    parsed = parser.parse_args(remove_ros_args(words))
    return record(parsed, words)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options, which `explore_slam record` shares."""
    parser.add_argument('out', type=Path, help='bag to write (a new folder)')
    parser.add_argument('--topics', nargs='+', default=(), help='record only these topics')
    parser.add_argument('--vehicles', nargs='+', default=(), help='record only these vehicles')
    parser.add_argument(
        '--topic', action='append', default=[], metavar='VEHICLE.KIND=/TOPIC',
        help='record a topic of another name as that of a vehicle',
    )  # fmt: skip
    parser.add_argument('--sim-time', action='store_true', help='use /clock for the log times')


def record(parsed: argparse.Namespace, ros_arguments: list[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; return the exit code."""
    logging.basicConfig(level=logging.WARNING)
    made: list[Recorder] = []

    def make() -> Recorder:
        node = Recorder(
            parsed.out,
            parsed.topics,
            parsed.vehicles,
            choices=topic_choices(parsed.topic),
            use_sim_time=parsed.sim_time,
        )
        made.append(node)
        return node

    code = run_node(make, ros_arguments)
    for node in made:
        if not node.counts:
            logging.getLogger(__name__).error(
                '%s is empty: no message on any topic of a vehicle', parsed.out
            )
            code = code or 1
    return code
