"""Targets that failed: left alone for a while, tried again, given up until the map changes."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from explore_slam.exploration.config import BlacklistConfig
from explore_slam.exploration.records import Grid, Point

CHANGED_SHARE = 0.02


@dataclass
class Failure:
    """One place that did not work out: where, how often, until when, how much was free there."""

    place: Point
    attempts: int
    until: float
    free: int


class Blacklist:
    """Remembers failed targets; forgets them on success or when the map there changes."""

    def __init__(self, config: BlacklistConfig) -> None:
        self.config = config
        self._failures: list[Failure] = []

    def __len__(self) -> int:
        return len(self._failures)

    def add(
        self, place: Point, now: float, grid: Grid, free: NDArray[np.bool_], *, final: bool = False
    ) -> None:
        """Note a failure at a place (m); a final one is given up at once, not tried again."""
        entry = self._entry_at(place)
        seen = self._free_around(place, grid, free)
        if entry is None:
            entry = Failure(place, 0, now, seen)
            self._failures.append(entry)
        entry.attempts = self.config.maximum_attempts if final else entry.attempts + 1
        entry.free = seen
        entry.until = now + self.config.blacklist_expiry * 2.0 ** (entry.attempts - 1)

    def clear(self, place: Point) -> None:
        """Forget failures near a place that was reached after all."""
        radius = self.config.blacklist_radius
        self._failures = [f for f in self._failures if math.dist(f.place, place) > radius]

    def refresh(self, grid: Grid, free: NDArray[np.bool_]) -> None:
        """Forget failures where the map has changed since."""
        kept = []
        for failure in self._failures:
            seen = self._free_around(failure.place, grid, free)
            if abs(seen - failure.free) <= self._area(grid) * CHANGED_SHARE:
                kept.append(failure)
        self._failures = kept

    def blocks(self, place: Point, now: float) -> bool:
        """Tell whether a target is to be left alone at present."""
        entry = self._entry_at(place)
        if entry is None:
            return False
        return now < entry.until or entry.attempts >= self.config.maximum_attempts

    def gave_up(self, place: Point) -> bool:
        """Tell whether a target has failed too often."""
        entry = self._entry_at(place)
        return entry is not None and entry.attempts >= self.config.maximum_attempts

    def _entry_at(self, place: Point) -> Failure | None:
        near = [
            f for f in self._failures if math.dist(f.place, place) <= self.config.blacklist_radius
        ]
        return min(near, key=lambda f: (-f.attempts, math.dist(f.place, place)), default=None)

    def _half(self, grid: Grid) -> int:
        return max(2, math.ceil(2.0 * self.config.blacklist_radius / grid.resolution))

    def _area(self, grid: Grid) -> int:
        return (2 * self._half(grid) + 1) ** 2

    def _free_around(self, place: Point, grid: Grid, free: NDArray[np.bool_]) -> int:
        half = self._half(grid)
        row, col = grid.to_cell([place])[0].tolist()
        window = free[max(0, row - half) : row + half + 1, max(0, col - half) : col + half + 1]
        return int(np.count_nonzero(window))
