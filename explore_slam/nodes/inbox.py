"""The bounded queue of the worker that owns the agent; drops are counted."""

import math
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, eq=False)
class Item:
    """One task: call `take(payload)`. Queue limits and drop counts are per kind and source."""

    kind: str
    source: str
    take: Callable[[Any], None]
    payload: Any
    received: float  # time.monotonic()


class Inbox:
    """A queue with a limit per (kind, source), at which the oldest item is dropped.

    Measurements are taken in order of arrival. What must not wait for them goes ahead: kinds
    without a limit, such as requests of an operator, which are never dropped, and prompt ones.

    limits: kind -> items of one source that may wait. prompt: kinds with a limit that go ahead.
    """

    def __init__(self, limits: dict[str, int], prompt: Collection[str] = ()) -> None:
        self._limits = limits
        self._prompt = frozenset(prompt)
        self._ahead: deque[Item] = deque()
        self._measurements: deque[Item] = deque()
        self._waiting: Counter[tuple[str, str]] = Counter()
        self._ready = threading.Condition()
        self._closed = False
        self.dropped: Counter[tuple[str, str]] = Counter()

    def __len__(self) -> int:
        return len(self._ahead) + len(self._measurements)

    def put(self, kind: str, source: str, take: Callable[[Any], None], payload: Any) -> None:
        """Append an item; at the limit the oldest of the same kind and source is dropped."""
        key = (kind, source)
        with self._ready:
            limit = self._limits.get(kind)
            ahead = limit is None or kind in self._prompt
            items = self._ahead if ahead else self._measurements
            if limit is not None and self._waiting[key] >= limit:
                oldest = next(i for i in items if (i.kind, i.source) == key)
                items.remove(oldest)
                self._waiting[key] -= 1
                self.dropped[key] += 1
            items.append(Item(kind, source, take, payload, time.monotonic()))
            self._waiting[key] += 1
            self._ready.notify()

    def get(self, timeout: float) -> Item | None:
        """Return the next item, None after the timeout (s) or when closed."""
        with self._ready:
            if not len(self) and not self._closed:
                self._ready.wait(timeout)
            if not len(self) or self._closed:
                return None
            item = (self._ahead or self._measurements).popleft()
            self._waiting[(item.kind, item.source)] -= 1
            return item

    def take_out(self, source: str | None = None, kind: str | None = None) -> list[Item]:
        """Remove the measurements that wait, of one source or kind, or all; return them."""
        with self._ready:
            taken, left = list[Item](), deque[Item]()
            for item in self._measurements:
                matches = source in (None, item.source) and kind in (None, item.kind)
                (taken if matches else left).append(item)
            self._measurements = left
            self._waiting.subtract((item.kind, item.source) for item in taken)
            return taken

    @property
    def delay(self) -> float:
        """Time (s) for which the oldest measurement has waited; 0 if none waits."""
        with self._ready:
            oldest = self._measurements[0].received if self._measurements else math.inf
        return max(time.monotonic() - oldest, 0.0)

    def waiting(self) -> dict[tuple[str, str], int]:
        """Return the numbers of waiting items by (kind, source)."""
        with self._ready:
            return {key: count for key, count in self._waiting.items() if count}

    def close(self) -> None:
        """Wake the worker; `get` returns None from now on."""
        with self._ready:
            self._closed = True
            self._ready.notify_all()

    @property
    def closed(self) -> bool:
        """Whether the inbox was closed."""
        return self._closed
