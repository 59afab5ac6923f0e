"""Bounded queue of measurements in the order of their stamps."""

import heapq
import math
from typing import Protocol


class Stamped(Protocol):
    """A record with the time at which it was measured."""

    @property
    def stamp(self) -> float:
        """Time of measurement (s)."""


class MeasurementQueue[M: Stamped]:
    """Measurements of one vehicle that wait for odometry, oldest first; ties by arrival."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, M]] = []
        self._arrivals = 0

    def __len__(self) -> int:
        return len(self._heap)

    @property
    def first(self) -> float:
        """Stamp (s) of the oldest measurement; inf when empty."""
        return self._heap[0][0] if self._heap else math.inf

    @property
    def oldest(self) -> M:
        """The oldest measurement; IndexError when empty."""
        return self._heap[0][2]

    def push(self, measurement: M, capacity: int) -> bool:
        """Insert a measurement; return whether the oldest was dropped to keep the capacity."""
        self._arrivals += 1
        heapq.heappush(self._heap, (measurement.stamp, self._arrivals, measurement))
        if len(self._heap) <= capacity:
            return False
        heapq.heappop(self._heap)
        return True

    def pop(self) -> M:
        """Remove and return the oldest measurement."""
        return heapq.heappop(self._heap)[2]

    def clear(self) -> None:
        """Remove all measurements."""
        self._heap.clear()
