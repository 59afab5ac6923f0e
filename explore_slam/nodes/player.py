"""Plays a bag live over topics: the recorded CDR as it is, in the order of stamps, with /clock."""

import sys
import time
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

from rclpy.context import Context
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from explore_slam.errors import RecordingError
from explore_slam.messages.topics import TopicKind, vehicle_topic, vehicle_topics
from explore_slam.nodes.messages import message_class
from explore_slam.recording.bag import BagReader
from explore_slam.recording.ordering import StampOrder
from explore_slam.recording.salvage import RawMessage

CLOCK_PERIOD = 0.01
MATCH_TIMEOUT = 5.0


class Player(Node):
    """Publishes the vehicles' topics of a bag; `step` is called as often as its caller can."""

    def __init__(
        self,
        bag: BagReader,
        *,
        rate: float = 1.0,
        topics: Collection[str] = (),
        vehicles: Collection[str] = (),
        clock: bool = True,
        until: float | None = None,
        context: Context | None = None,
    ) -> None:
        if not rate > 0.0:
            raise RecordingError(f'rate is {rate}, expected more than 0')
        super().__init__('player', context=context)
        self._bag = bag
        self._rate = rate
        self._until = None if until is None else round(until * 1e9)
        chosen = self._choose(topics, vehicles)
        self._publishers_of = {name: self._publisher(name) for name in chosen}
        self._clock = self.create_publisher(Clock, '/clock', 10) if clock else None
        self._order = StampOrder()
        self._messages: Iterator[tuple[int, RawMessage]] = self._order.sort(bag.messages(chosen))
        self._next = next(self._messages, None)
        self._first = self._next[0] if self._next else 0
        self._anchor: tuple[float, int] | None = None  # wall time (s) and stamp (ns) that belong
        self._last_clock = -1.0
        self.counts: dict[str, int] = dict.fromkeys(chosen, 0)
        self.share = 0.0
        self.worst_delay = 0.0

    def _choose(self, topics: Collection[str], vehicles: Collection[str]) -> list[str]:
        if topics:
            missing = sorted(set(topics) - set(self._bag.topics))
            if missing:
                known = sorted(self._bag.topics)
                raise RecordingError(f'{self._bag.path} does not hold {missing}; it holds {known}')
            return sorted(topics)
        found, warnings = vehicle_topics(self._bag.topics, vehicles)
        for warning in (*self._bag.warnings, *warnings):
            self.get_logger().warning(warning)
        return [topic.name for topic in found]

    def _publisher(self, topic: str) -> Publisher:
        kind = vehicle_topic(topic)
        latched = kind is not None and kind.kind is TopicKind.INITIAL_POSE
        qos = QoSProfile(
            depth=1 if latched else 10,
            reliability=ReliabilityPolicy.RELIABLE,
            durability=(
                DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
            ),
        )
        return self.create_publisher(
            message_class(self._bag.topics[topic].replace('/msg/', '/')), topic, qos
        )

    @property
    def done(self) -> bool:
        """Tell whether everything was published."""
        return self._next is None

    @property
    def unmatched(self) -> list[str]:
        """Topics that nobody listens to."""
        return [
            topic
            for topic, publisher in self._publishers_of.items()
            if publisher.get_subscription_count() == 0
        ]

    def stop(self) -> None:
        """Nothing is held that must be brought to rest."""

    def step(self) -> float:
        """Publish what is due; return the time (s) until the next message."""
        now = time.monotonic()
        if self._anchor is None:
            self._anchor = (now, self._first)
        while self._next is not None:
            stamp, message = self._next
            if self._until is not None and stamp > self._first + self._until:
                self._next = None
                break
            if stamp < self._anchor[1]:  # the recorded clock jumped back
                self._anchor = (now, stamp)
            due = self._anchor[0] + (stamp - self._anchor[1]) * 1e-9 / self._rate
            if due > now:
                self._tell_time(now)
                return min(due - now, CLOCK_PERIOD)
            self.worst_delay = max(self.worst_delay, now - due)
            self._tell_stamp(stamp, now)
            self._publishers_of[message.topic].publish(message.data)
            self.counts[message.topic] += 1
            self.share = (message.log_time - self._bag.start) / max(
                self._bag.end - self._bag.start, 1
            )
            self._next = next(self._messages, None)
            now = time.monotonic()
        return 0.0

    def _tell_time(self, now: float) -> None:
        """Publish simulated time between messages."""
        if self._anchor is not None and now - self._last_clock >= CLOCK_PERIOD:
            played = (now - self._anchor[0]) * self._rate
            self._tell_stamp(self._anchor[1] + round(played * 1e9), now)

    def _tell_stamp(self, stamp: int, now: float) -> None:
        if self._clock is None or now - self._last_clock < CLOCK_PERIOD:
            return
        self._last_clock = now
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(stamp, 10**9)
        self._clock.publish(message)


def wait_for_listeners(
    node: Player, stopped: Callable[[], bool], timeout: float = MATCH_TIMEOUT
) -> bool:
    """Wait until somebody listens to a topic; False after the timeout (s)."""
    deadline = time.monotonic() + timeout
    everything = len(node.counts)
    while time.monotonic() < deadline and not stopped():
        if len(node.unmatched) < everything:
            time.sleep(0.3)  # discovery goes topic by topic: let the others match too
            return True
        time.sleep(0.02)
    return False


def play(
    path: Path,
    *,
    rate: float = 1.0,
    topics: Collection[str] = (),
    vehicles: Collection[str] = (),
    clock: bool = True,
    until: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, int]:
    """Play a bag from begin to end, or until SIGINT or SIGTERM; return messages per topic."""
    import signal

    import rclpy
    from rclpy.signals import SignalHandlerOptions

    asked: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda received, _frame: asked.append(received))
    with BagReader(path) as bag:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        try:
            node = Player(
                bag, rate=rate, topics=topics, vehicles=vehicles, clock=clock, until=until
            )
            try:
                if not wait_for_listeners(node, lambda: bool(asked)) and not asked:
                    node.get_logger().warning(
                        f'nobody listens to {node.unmatched}; playing all the same'
                    )
                while not node.done and not asked:
                    time.sleep(node.step())
                    if progress is not None:
                        progress(node.share)
                if node.worst_delay > 0.5:
                    node.get_logger().warning(
                        f'the machine was too slow: up to {node.worst_delay:.1f} s late; '
                        'a lower --rate helps'
                    )
                time.sleep(0.2)  # let the last messages leave before the publishers go
                return dict(node.counts)
            finally:
                node.destroy_node()
        finally:
            rclpy.try_shutdown()


def main(arguments: list[str] | None = None) -> int:
    """Play a bag: `player BAG [RATE]`."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    play(Path(words[0]), rate=float(words[1]) if len(words) > 1 else 1.0)
    return 0


if __name__ == '__main__':
    sys.exit(main())
