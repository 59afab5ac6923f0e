"""Messages in the order of their stamps, with a bounded look-ahead."""

import heapq
import struct
from collections.abc import Iterable, Iterator

from explore_slam.recording.salvage import RawMessage

WINDOW = 2_000_000_000  # ns; how much later than its stamp a message may be logged
CLOCK_JUMP = 5_000_000_000  # ns; more than the window, so that no late message looks like a jump
_LITTLE_ENDIAN, _BIG_ENDIAN = 1, 0  # second byte of the encapsulation header of CDR
_STAMP = {_BIG_ENDIAN: struct.Struct('>iI'), _LITTLE_ENDIAN: struct.Struct('<iI')}
_ENCAPSULATION = 4  # bytes before the content


def header_stamp(data: bytes) -> int | None:
    """Return the stamp (ns) of CDR data whose type starts with a std_msgs/Header."""
    if len(data) < _ENCAPSULATION + 8 or data[1] not in _STAMP:
        return None
    seconds, nanoseconds = _STAMP[data[1]].unpack_from(data, _ENCAPSULATION)
    return int(seconds) * 10**9 + int(nanoseconds)


class StampOrder:
    """Yields (stamp in ns, message) with stamps that never decrease.

    A message is held back until another one was logged a window (ns) later. A message that comes
    even later is omitted and counted in `late`, except that a clock that jumps back starts a new
    order.
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
                # the messages held back belong to the old time: they go out before the new ones
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
