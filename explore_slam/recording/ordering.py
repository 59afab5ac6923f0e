"""Messages in the order of their stamps, with a bounded look-ahead."""

import heapq
import struct
from collections.abc import Iterable, Iterator

from explore_slam.recording.salvage import RawMessage

WINDOW = 2_000_000_000
CLOCK_JUMP = 5_000_000_000
_STAMP = {0: struct.Struct('>iI'), 1: struct.Struct('<iI')}


def header_stamp(data: bytes) -> int | None:
    """Return the stamp (ns) of CDR data whose type starts with a std_msgs/Header."""
    if len(data) < 12 or data[1] not in _STAMP:
        return None
    seconds, nanoseconds = _STAMP[data[1]].unpack_from(data, 4)
    return int(seconds) * 10**9 + int(nanoseconds)


class StampOrder:
    """Yields (stamp in ns, message), stamps never falling.

    A message waits until another was logged a window (ns) later; one that comes later still than
    its turn is left out and counted, except that a clock that jumped back starts a new order.
    """

    def __init__(self, window: int = WINDOW) -> None:
        self._window = window
        self.late: dict[str, int] = {}
        self.malformed: dict[str, int] = {}
        self.clock_jumps: list[tuple[float, float]] = []

    def sort(self, messages: Iterable[RawMessage]) -> Iterator[tuple[int, RawMessage]]:
        """Yield the messages by stamp."""
        heap: list[tuple[int, int, RawMessage]] = []
        newest, last, highest = 0, -(2**63), -(2**63)
        for number, message in enumerate(messages):
            stamp = header_stamp(message.data)
            if stamp is None:
                self.malformed[message.topic] = self.malformed.get(message.topic, 0) + 1
                continue
            if stamp < highest - CLOCK_JUMP:
                # what was held belongs to the old time and goes out before the new one starts
                self.clock_jumps.append((highest * 1e-9, stamp * 1e-9))
                while heap:
                    at, _, held = heapq.heappop(heap)
                    yield at, held
                last = highest = -(2**63)
            if stamp < last:
                self.late[message.topic] = self.late.get(message.topic, 0) + 1
                continue
            highest, newest = max(highest, stamp), max(newest, message.log_time)
            heapq.heappush(heap, (stamp, number, message))
            while heap and heap[0][2].log_time <= newest - self._window:
                last, _, ready = heapq.heappop(heap)
                yield last, ready
        while heap:
            at, _, held = heapq.heappop(heap)
            yield at, held
