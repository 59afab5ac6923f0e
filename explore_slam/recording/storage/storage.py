"""What the files of all formats have in common: topics, counts, and messages by log time."""

import heapq
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import NamedTuple


class RawMessage(NamedTuple):
    """One message as recorded: CDR data, logged at log_time (ns)."""

    topic: str
    type: str
    log_time: int
    data: bytes


class UnusableTopic(NamedTuple):
    """A topic whose messages cannot be used, with its type as recorded and the reason."""

    type: str
    reason: str


class Storage(ABC):
    """One file of a recording.

    topics, counts: message type and number of messages by topic, as found in the file.
    declared: number of messages by topic that the file itself states, where it does.
    unusable: topics whose messages cannot be used, e.g. because they are JSON.
    start, end: first and last log time (ns); 0 without messages.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.topics: dict[str, str] = {}
        self.counts: dict[str, int] = {}
        self.declared: dict[str, int] = {}
        self.unusable: dict[str, UnusableTopic] = {}
        self.start = 0
        self.end = 0
        self._damages: dict[str, set[int]] = {}

    @property
    def damages(self) -> list[str]:
        """What is wrong with the file, a sentence of each kind; reading it may add some."""
        return [
            f'{self.path} {reason.format(_places(places))}'
            for reason, places in self._damages.items()
        ]

    @property
    def message_count(self) -> int:
        """Number of messages on all topics."""
        return sum(self.counts.values())

    @abstractmethod
    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield the messages of some topics, or all, by log time; damaged ones are left out."""

    def close(self) -> None:
        """Close the file."""
        return

    def damage(self, reason: str, place: int = 0) -> None:
        """Note a damage at a byte or row; reason: with `{}` for the places of all alike."""
        self._damages.setdefault(reason, set()).add(place)


def _places(numbers: set[int]) -> str:
    first = min(numbers)
    return f'{first} and {len(numbers) - 1} other places' if len(numbers) > 1 else f'{first}'


class Span(NamedTuple):
    """A part of a file that is read as a whole: a chunk, or records outside of chunks.

    begin, end: bytes in the file, of whole records; first, last: log times (ns); topics in it.
    """

    begin: int
    end: int
    first: int
    last: int
    topics: frozenset[str]


class ChunkedFile(Storage):
    """A file whose messages lie in chunks, which may overlap in time."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._spans: list[Span] = []

    @abstractmethod
    def _between(self, begin: int, end: int) -> Iterator[RawMessage]:
        """Yield the messages of the records between two bytes."""

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield the messages of some topics, or all, by log time."""
        heap: list[tuple[int, int, RawMessage]] = []
        number = 0
        for span in sorted(self._spans, key=lambda span: (span.first, span.begin)):
            if topics is not None and span.topics.isdisjoint(topics):
                continue
            while heap and heap[0][0] < span.first:
                yield heapq.heappop(heap)[2]
            for message in self._between(span.begin, span.end):
                if topics is None or message.topic in topics:
                    heapq.heappush(heap, (message.log_time, number, message))
                    number += 1
        while heap:
            yield heapq.heappop(heap)[2]

    def _add_span(self, begin: int, end: int) -> None:
        """Count the messages between two bytes, and keep where they lie."""
        first, last, topics = 2**63, -(2**63), set()
        for message in self._between(begin, end):
            first, last = min(first, message.log_time), max(last, message.log_time)
            topics.add(message.topic)
            self.counts[message.topic] = self.counts.get(message.topic, 0) + 1
        if topics:
            self._keep_span(Span(begin, end, first, last, frozenset(topics)))

    def _keep_span(self, span: Span) -> None:
        self.start = min(self.start, span.first) if self._spans else span.first
        self.end = max(self.end, span.last) if self._spans else span.last
        self._spans.append(span)
