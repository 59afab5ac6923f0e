"""The bounded queue of the worker that owns the agent; drops are counted."""

import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, eq=False)
class Item:
    """One task: call `take(payload)`. Queue limits and drop counts are per kind and source."""

    kind: str
    source: str
    take: Callable[[Any], None]
    payload: Any
    received: float = field(default_factory=time.monotonic)


class Inbox:
    """A queue in order of arrival with a limit per (kind, source): the oldest item is dropped.

    Kinds without a limit, such as requests of an operator, are never dropped.
    """

    def __init__(self, limits: dict[str, int]) -> None:
        self._limits = limits
        self._items: deque[Item] = deque()
        self._waiting: Counter[tuple[str, str]] = Counter()
        self._ready = threading.Condition()
        self._closed = False
        self.dropped: Counter[tuple[str, str]] = Counter()

    def __len__(self) -> int:
        return len(self._items)

    def put(self, kind: str, source: str, take: Callable[[Any], None], payload: Any) -> None:
        """Append an item; at the limit the oldest of the same kind and source is dropped."""
        key = (kind, source)
        with self._ready:
            limit = self._limits.get(kind)
            if limit is not None and self._waiting[key] >= limit:
                oldest = next(i for i in self._items if (i.kind, i.source) == key)
                self._items.remove(oldest)
                self._waiting[key] -= 1
                self.dropped[key] += 1
            self._items.append(Item(kind, source, take, payload))
            self._waiting[key] += 1
            self._ready.notify()

    def get(self, timeout: float) -> Item | None:
        """Return the next item, None after the timeout (s) or when closed."""
        with self._ready:
            if not self._items and not self._closed:
                self._ready.wait(timeout)
            if not self._items or self._closed:
                return None
            item = self._items.popleft()
            self._waiting[(item.kind, item.source)] -= 1
            return item

    def close(self) -> None:
        """Wake the worker; `get` returns None from now on."""
        with self._ready:
            self._closed = True
            self._ready.notify_all()

    @property
    def closed(self) -> bool:
        """Whether the inbox was closed."""
        return self._closed
