"""Messages in the order of their stamps, with a bounded look-ahead; and what their stamps say."""

import heapq
import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from explore_slam.recording.storage.storage import RawMessage

# Chosen by hand; test_ordering shows what they decide.
WINDOW = 2_000_000_000  # ns; how much later than its stamp a message may be logged
CLOCK_JUMP = 5_000_000_000  # ns; more than the window, so that no late message looks like a jump
CLOCKS_APART = 1.0  # s between stamps and log times, or between topics, that are named
_SAMPLES = 1000  # messages per topic whose stamps are compared with their log times
_UNSTAMPED = 1_000_000_000  # ns; a stamp of zero logged later is none, as in clocks.StampWatch
_LITTLE_ENDIAN, _BIG_ENDIAN = 1, 0  # second byte of the encapsulation header of CDR
_STAMP = {_BIG_ENDIAN: struct.Struct('>iI'), _LITTLE_ENDIAN: struct.Struct('<iI')}
_ENCAPSULATION = 4  # bytes before the content


def header_stamp(data: bytes) -> int | None:
    """Return the stamp (ns) of CDR data whose type starts with a std_msgs/Header."""
    if len(data) < _ENCAPSULATION + 8 or data[1] not in _STAMP:
        return None
    seconds, nanoseconds = _STAMP[data[1]].unpack_from(data, _ENCAPSULATION)
    return int(seconds) * 10**9 + int(nanoseconds)


@dataclass
class StampStatistics:
    """What the stamps of one topic say: numbers of messages, times in ns.

    zero: without a stamp; the log time is used.
    repeated: with the stamp of the message before.
    late: logged more than the window out of order, and omitted.
    backwards, largest_step_back: stamps before that of the message before.
    ahead: stamp minus log time of the first messages that have a stamp.
    """

    count: int = 0
    zero: int = 0
    repeated: int = 0
    late: int = 0
    malformed: int = 0
    backwards: int = 0
    largest_step_back: int = 0
    newest: int = -(2**63)
    ahead: list[int] = field(default_factory=list)

    def add(self, stamp: int, log_time: int) -> None:
        """Count a stamp."""
        self.repeated += stamp == self.newest
        if stamp < self.newest:
            self.backwards += 1
            self.largest_step_back = max(self.largest_step_back, self.newest - stamp)
        self.newest = stamp
        if len(self.ahead) < _SAMPLES:
            self.ahead.append(stamp - log_time)

    @property
    def is_reversed(self) -> bool:
        """Whether most stamps are earlier than those before: no jitter, which goes to and fro."""
        return 2 * self.backwards > self.count

    @property
    def median_ahead(self) -> float:
        """Median of stamp minus log time (s); 0 without any stamp."""
        return float(np.median(self.ahead)) * 1e-9 if self.ahead else 0.0


class StampOrder:
    """Yields (stamp in ns, message) with stamps that never decrease.

    A message is held back until another one was logged a window (ns) later. A message that comes
    even later is omitted and counted, except that a clock that jumps back starts a new order.

    offsets: topic -> ns that are added to its stamps.
    statistics: of every topic so far.
    """

    def __init__(
        self,
        window: int = WINDOW,
        offsets: Mapping[str, int] | None = None,
    ) -> None:
        self._window = window
        self._offsets = dict(offsets or {})
        self.statistics: dict[str, StampStatistics] = {}
        self.clock_jumps: list[tuple[float, float]] = []

    @property
    def late(self) -> dict[str, int]:
        """Messages per topic that were omitted because they came too late."""
        return {topic: item.late for topic, item in self.statistics.items() if item.late}

    @property
    def malformed(self) -> dict[str, int]:
        """Messages per topic that are too short for a header."""
        return {topic: item.malformed for topic, item in self.statistics.items() if item.malformed}

    def sort(self, messages: Iterable[RawMessage]) -> Iterator[tuple[int, RawMessage]]:
        """Yield the messages by stamp."""
        heap: list[tuple[int, int, RawMessage]] = []
        newest, last = 0, -(2**63)
        highest: dict[str, int] = {}
        for number, message in enumerate(messages):
            known = self.statistics.setdefault(message.topic, StampStatistics())
            known.count += 1
            stamp = self._stamp(message, known)
            if stamp is None:
                continue
            before = highest.get(message.topic, stamp)
            if stamp < before - CLOCK_JUMP:
                # the messages held back belong to the old time: they go out before the new ones
                self.clock_jumps.append((before * 1e-9, stamp * 1e-9))
                while heap:
                    at, _, held = heapq.heappop(heap)
                    yield at, held
                last, highest = -(2**63), {}
            if stamp < last:
                known.late += 1
                continue
            highest[message.topic] = max(highest.get(message.topic, stamp), stamp)
            newest = max(newest, message.log_time)
            heapq.heappush(heap, (stamp, number, message))
            while heap and heap[0][2].log_time <= newest - self._window:
                last, _, ready = heapq.heappop(heap)
                yield last, ready
        while heap:
            at, _, held = heapq.heappop(heap)
            yield at, held

    def _stamp(self, message: RawMessage, known: StampStatistics) -> int | None:
        """Return the stamp (ns) of a message, or None if it has no header."""
        stamp = header_stamp(message.data)
        if stamp is None:
            known.malformed += 1
            return None
        if stamp == 0 and message.log_time > _UNSTAMPED:
            known.zero += 1
            return message.log_time
        known.add(stamp, message.log_time)
        return stamp + self._offsets.get(message.topic, 0)

    def notes(self) -> list[str]:
        """Return what is wrong with the stamps of the topics, with the amounts."""
        found = []
        for topic, item in sorted(self.statistics.items()):
            if item.malformed:
                found.append(
                    f'{item.malformed} messages on {topic} are too short for their header: omitted'
                )
            if item.zero:
                found.append(
                    f'{item.zero} of {item.count} messages on {topic} have the stamp zero: the '
                    'log time is used'
                )
            if 2 * item.repeated > item.count:
                found.append(
                    f'{item.repeated} of {item.count} messages on {topic} have the stamp of the '
                    'one before'
                )
            if item.late:
                found.append(
                    f'{item.late} messages on {topic} came more than '
                    f'{self._window * 1e-9:.0f} s out of order: omitted'
                )
            if item.is_reversed or (item.backwards > item.late and not self.clock_jumps):
                found.append(
                    f'stamps on {topic} go back {item.backwards} times, by up to '
                    f'{item.largest_step_back * 1e-9:.3f} s'
                )
        if self.clock_jumps:
            before, after = self.clock_jumps[0]
            others = len(self.clock_jumps) - 1
            found.append(
                f'the recorded clock jumps back from {before:.3f} s to {after:.3f} s'
                + (f', the first of {others + 1} jumps' if others else '')
            )
        return found + self._clocks()

    def _clocks(self) -> list[str]:
        """Return which topics have stamps of another clock than the log or than the others."""
        ahead = {
            topic: item.median_ahead + 1e-9 * self._offsets.get(topic, 0)
            for topic, item in sorted(self.statistics.items())
            if item.ahead
        }
        ahead |= {
            topic: 0.0 for topic, item in self.statistics.items() if 2 * item.zero > item.count
        }
        if not ahead:
            return []
        common = float(np.median(list(ahead.values())))
        if max(ahead.values()) - min(ahead.values()) <= CLOCKS_APART:
            # one clock, which need not be that of the recorder: simulated time, an old recording
            return []
        reference = min(ahead, key=lambda topic: abs(ahead[topic] - common))
        return [
            f'stamps on {topic} are {abs(value - ahead[reference]):.3f} s '
            f'{"ahead of" if value > ahead[reference] else "behind"} those on {reference}, by '
            'the log times; set its time offset if the clocks differ'
            for topic, value in ahead.items()
            if abs(value - ahead[reference]) > CLOCKS_APART
        ]
