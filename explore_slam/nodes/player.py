"""Node `player`: publishes the recorded CDR of a bag in the order of stamps, and /clock."""

import argparse
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import Any

from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock

from explore_slam.errors import RecordingError
from explore_slam.messages.base import NANOSECONDS, seconds, transform_message
from explore_slam.messages.topics import RELIABLE, GlobalTopic, topic_name, vehicle_topic
from explore_slam.nodes.endpoints import publisher, qos_profile
from explore_slam.nodes.ros_types import MESSAGES, message_class
from explore_slam.recording.bag import BagReader
from explore_slam.recording.ordering import StampOrder
from explore_slam.recording.recorded_transforms import static_transforms
from explore_slam.recording.storage.storage import RawMessage
from explore_slam.recording.topic_selection import TopicChoice, vehicle_topics

CLOCK_PERIOD = 0.01  # s
MATCH_TIMEOUT = 5.0  # s to wait for a subscriber
LATE = 0.5  # s; a longer delay is reported
ACKNOWLEDGE_TIMEOUT = 2.0  # s for the last messages to arrive


class Player(Node):
    """Publishes the vehicles' topics of a bag; call `step` as often as possible."""

    def __init__(
        self,
        bag: BagReader,
        *,
        rate: float = 1.0,
        topics: Collection[str] = (),
        vehicles: Collection[str] = (),
        clock: bool = True,
        until: float | None = None,
        choices: Iterable[TopicChoice] = (),
        context: Context | None = None,
    ) -> None:
        if not rate > 0.0:
            raise RecordingError(f'rate is {rate}, expected more than 0')
        super().__init__('player', context=context)
        self._bag = bag
        self._rate = rate
        self._until = None if until is None else round(until * 1e9)
        chosen = self._choose(topics, vehicles, choices)
        self._outputs = {
            recorded: self._publisher(recorded, live) for recorded, live in chosen.items()
        }
        self._static = self._publish_static_transforms() if not topics else []
        self._clock = publisher(self, GlobalTopic.CLOCK) if clock else None
        self._order = StampOrder()
        self._messages: Iterator[tuple[int, RawMessage]] = self._order.sort(bag.messages(chosen))
        self._next = next(self._messages, None)
        self._first = self._next[0] if self._next else 0
        self._anchor: tuple[float, int] | None = None  # wall time (s) of a stamp (ns)
        self._last_clock = -1.0
        self.counts: dict[str, int] = dict.fromkeys(chosen, 0)
        self.fraction_played = 0.0
        self.worst_delay = 0.0

    def _choose(
        self,
        topics: Collection[str],
        vehicles: Collection[str],
        choices: Iterable[TopicChoice],
    ) -> dict[str, str]:
        """Return recorded topic -> live topic: of vehicles, or exactly those that are given."""
        if topics:
            missing = sorted(set(topics) - set(self._bag.topics))
            if missing:
                known = sorted(self._bag.topics)
                raise RecordingError(f'{self._bag.path} does not hold {missing}; it holds {known}')
            return {name: name for name in sorted(topics)}
        found, warnings = vehicle_topics(self._bag.topics, vehicles, choices, self._bag.rates)
        for warning in (*self._bag.warnings, *warnings):
            self.get_logger().warning(warning)
        return {topic.name: topic_name(topic.vehicle, topic.kind) for topic in found}

    def _publisher(self, recorded: str, live: str) -> Publisher:
        found = vehicle_topic(live)
        qos = RELIABLE if found is None else found.kind.offered
        return self.create_publisher(
            message_class(self._bag.topics[recorded]), live, qos_profile(qos)
        )

    def _publish_static_transforms(self) -> list[Publisher]:
        """Publish the mounts of the sensors, latched; return the publishers, which keep them."""
        made = []
        for topic, transforms in static_transforms(self._bag).items():
            try:
                kind = message_class(GlobalTopic.TF_STATIC.message_type)
            except ImportError:
                self.get_logger().warning(f'tf2_msgs is not installed: {topic} is not played')
                break
            output = self.create_publisher(kind, topic, qos_profile(GlobalTopic.TF_STATIC.offered))
            output.publish(kind(transforms=[_ros_transform(item) for item in transforms]))
            made.append(output)
        return made

    @property
    def done(self) -> bool:
        """Whether everything has been published."""
        return self._next is None

    @property
    def unmatched(self) -> list[str]:
        """Topics without subscribers."""
        return [
            topic
            for topic, output in self._outputs.items()
            if output.get_subscription_count() == 0
        ]

    def stop(self) -> None:
        """Do nothing: no vehicle depends on a player."""

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
                self._advance_clock(now)
                return min(due - now, CLOCK_PERIOD)
            self.worst_delay = max(self.worst_delay, now - due)
            self._publish_clock(stamp, now)
            self._outputs[message.topic].publish(message.data)
            self.counts[message.topic] += 1
            self.fraction_played = (message.log_time - self._bag.start) / max(
                self._bag.end - self._bag.start, 1
            )
            self._next = next(self._messages, None)
            now = time.monotonic()
        return 0.0

    def flush(self, timeout: float = ACKNOWLEDGE_TIMEOUT) -> None:
        """Wait until the subscribers have received everything, at most for the timeout (s)."""
        deadline = time.monotonic() + timeout
        for output in self._outputs.values():
            remaining = max(deadline - time.monotonic(), 0.0)
            output.wait_for_all_acked(Duration(seconds=remaining))

    def _advance_clock(self, now: float) -> None:
        """Publish simulated time between messages."""
        if self._anchor is not None and now - self._last_clock >= CLOCK_PERIOD:
            played = (now - self._anchor[0]) * self._rate
            self._publish_clock(self._anchor[1] + round(played * 1e9), now)

    def _publish_clock(self, stamp: int, now: float) -> None:
        if self._clock is None or now - self._last_clock < CLOCK_PERIOD:
            return
        self._last_clock = now
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(stamp, NANOSECONDS)
        self._clock.publish(message)


def _ros_transform(item: Any) -> Any:
    """Return a recorded TransformStamped as a message of rclpy."""
    t, q = item.transform.translation, item.transform.rotation
    return transform_message(
        MESSAGES,
        seconds(item.header.stamp),
        item.header.frame_id,
        item.child_frame_id,
        (t.x, t.y, t.z),
        (q.x, q.y, q.z, q.w),
    )


def wait_for_listeners(
    node: Player, stopped: Callable[[], bool], timeout: float = MATCH_TIMEOUT
) -> bool:
    """Wait until a topic has a subscriber; return False after the timeout (s)."""
    deadline = time.monotonic() + timeout
    everything = len(node.counts)
    while time.monotonic() < deadline and not stopped():
        if len(node.unmatched) < everything:
            time.sleep(0.3)  # discovery matches topic by topic: give the others time too
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
    choices: Iterable[TopicChoice] = (),
    progress: Callable[[float], None] | None = None,
) -> dict[str, int]:
    """Play a bag to its end, or until SIGINT or SIGTERM; return the messages per topic."""
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
                bag,
                rate=rate,
                topics=topics,
                vehicles=vehicles,
                clock=clock,
                until=until,
                choices=choices,
            )
            try:
                if not wait_for_listeners(node, lambda: bool(asked)) and not asked:
                    node.get_logger().warning(
                        f'{node.unmatched} have no subscribers; playing nevertheless'
                    )
                while not node.done and not asked:
                    time.sleep(node.step())
                    if progress is not None:
                        progress(node.fraction_played)
                if node.worst_delay > LATE:
                    node.get_logger().warning(
                        f'the machine is too slow: messages were up to {node.worst_delay:.1f} s '
                        'late; use a lower --rate'
                    )
                node.flush()
                return dict(node.counts)
            finally:
                node.destroy_node()
        finally:
            rclpy.try_shutdown()


def main(arguments: list[str] | None = None) -> int:
    """Play a bag: `player BAG [RATE]`."""
    parser = argparse.ArgumentParser(prog='player', description='Play a bag on live topics.')
    parser.add_argument('bag', type=Path, help='rosbag2 folder, or its .mcap or .db3 file')
    parser.add_argument('rate', type=float, nargs='?', default=1.0, help='speed (default 1)')
    parsed = parser.parse_args(arguments)
    play(parsed.bag, rate=parsed.rate)
    return 0
