"""Records the vehicles' topics into a bag: CDR as it comes, written by a thread of its own."""

import argparse
import logging
import queue
import sys
import threading
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.utilities import remove_ros_args

from explore_slam.errors import ExploreSlamError
from explore_slam.messages.topics import vehicle_topic
from explore_slam.nodes.messages import message_class
from explore_slam.nodes.vehicle_support import run_node
from explore_slam.recording.bag import BagWriter
from explore_slam.recording.ordering import header_stamp

DISCOVERY_PERIOD = 0.2
QUEUE_BYTES = 256 * 2**20
QUEUE_DEPTH = 50


class WriterThread:
    """Writes what is put into it to a bag; beyond its memory the newest messages are dropped."""

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
        """Hand a message over."""
        with self._lock:
            if self._held + len(data) > self._limit:
                self.dropped[topic] = self.dropped.get(topic, 0) + 1
                return
            self._held += len(data)
        self._items.put((topic, log_time, data))

    def close(self) -> None:
        """Write what is left, close the bag."""
        self._items.put(None)
        self._thread.join()
        self._writer.close()

    def _work(self) -> None:
        while (item := self._items.get()) is not None:
            if self.error is None:
                try:
                    self._writer.write(*item)
                except Exception as error:  # a full disk must not end the node without a word
                    self.error = error
            with self._lock:
                self._held -= len(item[2])


class Recorder(Node):
    """Subscribes to topics as they appear and records them.

    Without `topics` these are the topics of all vehicles, or of the `vehicles` named. With
    use_sim_time messages are logged at simulated times.
    """

    def __init__(
        self,
        path: Path,
        topics: Collection[str] = (),
        vehicles: Collection[str] = (),
        *,
        use_sim_time: bool = False,
    ) -> None:
        overrides = [Parameter('use_sim_time', value=True)] if use_sim_time else []
        super().__init__('recorder', parameter_overrides=overrides)
        self._topics = {self.resolve_topic_name(topic) for topic in topics}
        self._vehicles = set(vehicles)
        self._writer = BagWriter(path)
        self._thread = WriterThread(self._writer)
        self._subscribed: set[str] = set()
        self._reported = 0
        self.counts: dict[str, int] = {}
        self._discover()
        # by the steady clock: simulated time may not have begun yet
        self.create_timer(
            DISCOVERY_PERIOD, self._discover, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    @property
    def dropped(self) -> dict[str, int]:
        """Messages per topic that were dropped because the disk was too slow."""
        return self._thread.dropped

    def stop(self) -> None:
        """Write what is held and close the bag."""
        self._thread.close()

    def _wanted(self, topic: str) -> bool:
        if self._topics:
            return topic in self._topics
        found = vehicle_topic(topic)
        return found is not None and (not self._vehicles or found.vehicle in self._vehicles)

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
            self.get_logger().warning(f'disk too slow: {lost} messages dropped {self.dropped}')

    def _subscribe(self, topic: str, types: Sequence[str]) -> None:
        publishers = self.get_publishers_info_by_topic(topic)
        if not publishers:
            return
        self._subscribed.add(topic)
        if len(types) != 1:
            self.get_logger().error(f'{topic} has several types {types}: not recorded')
            return
        try:
            kind = message_class(types[0].replace('/msg/', '/'))
            latched = all(
                item.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
                for item in publishers
            )
            self._writer.add_topic(topic, types[0], latched=latched)
        except (ImportError, AttributeError, ExploreSlamError) as error:
            self.get_logger().error(f'{topic} is not recorded: {error}')
            return
        reliable = all(
            item.qos_profile.reliability == ReliabilityPolicy.RELIABLE for item in publishers
        )
        qos = QoSProfile(
            depth=QUEUE_DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=(
                DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
            ),
        )
        self.create_subscription(kind, topic, self._listener(topic), qos, raw=True)
        self.get_logger().info(f'recording {topic} ({types[0]})')

    def _listener(self, topic: str) -> Callable[[bytes], None]:
        def take(data: bytes) -> None:
            # before simulated time begins the clock says 0: the message's own stamp is better
            log_time = self.get_clock().now().nanoseconds or header_stamp(data) or 0
            self.counts[topic] = self.counts.get(topic, 0) + 1
            self._thread.put(topic, log_time, bytes(data))

        return take


def main(arguments: list[str] | None = None) -> int:
    """Record until asked to end: `recorder OUT [--topics ...] [--vehicles ...] [--sim-time]`."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    parser = argparse.ArgumentParser(prog='recorder', description=__doc__)
    add_options(parser)
    parsed = parser.parse_args(remove_ros_args(words))
    return record(parsed, words)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare what can be chosen; the command line shares it."""
    parser.add_argument('out', type=Path, help='bag to write (a new folder)')
    parser.add_argument('--topics', nargs='+', default=(), help='these topics and no others')
    parser.add_argument('--vehicles', nargs='+', default=(), help="these vehicles' topics")
    parser.add_argument('--sim-time', action='store_true', help='log times from /clock')


def record(parsed: argparse.Namespace, ros_arguments: list[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; return the exit code."""
    logging.basicConfig(level=logging.WARNING)
    made: list[Recorder] = []

    def make() -> Recorder:
        node = Recorder(parsed.out, parsed.topics, parsed.vehicles, use_sim_time=parsed.sim_time)
        made.append(node)
        return node

    code = run_node(make, ros_arguments)
    for node in made:
        if not node.counts:
            logging.getLogger(__name__).error(
                '%s is empty: no topic of a vehicle was heard', parsed.out
            )
            code = code or 1
    return code


if __name__ == '__main__':
    sys.exit(main())
