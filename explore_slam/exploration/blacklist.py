"""Blacklist of targets that failed: retried after a while, given up until the map changes.

A target that one vehicle could not get to is left to the others; a place that was looked at from
close by has failed for all.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from explore_slam.exploration.records import Grid, Point
from explore_slam.exploration.sections import BlacklistConfig

# Chosen by hand; `explore_slam benchmark exploration` measures what another value does
_CHANGED_FRACTION = 0.02  # of the cells around a failure


@dataclass
class _Failure:
    """A place (m) that failed: attempts, time (s) of the next one, free cells around it then.

    vehicle: for which it failed; None: for all.
    """

    place: Point
    vehicle: str | None
    attempts: int
    until: float
    free: int


class Blacklist:
    """Remembers failed targets; forgets them on success, or when the map around them changes."""

    def __init__(self, config: BlacklistConfig) -> None:
        self.config = config
        self._failures: list[_Failure] = []
        self._reported: list[tuple[Point, str | None, bool]] = []

    def __len__(self) -> int:
        return len(self._failures)

    def report(self, place: Point, vehicle: str | None = None, *, final: bool = False) -> None:
        """Report a failed target (m), to be added by the next update; a final one is given up.

        vehicle: for which it failed; None: for all.
        """
        self._reported.append((place, vehicle, final))

    def update(self, now: float, grid: Grid, free: NDArray[np.bool_]) -> None:
        """Forget failures where the map has changed, and add those reported since.

        free: free cells (H, W) of the grid.
        """
        largest = _CHANGED_FRACTION * (2 * self._half_window(grid) + 1) ** 2
        self._failures = [
            failure
            for failure in self._failures
            if abs(self._free_around(failure.place, grid, free) - failure.free) <= largest
        ]
        for place, vehicle, final in self._reported:
            self._add(place, vehicle, now, self._free_around(place, grid, free), final)
        self._reported.clear()

    def clear(self, place: Point) -> None:
        """Forget failures near a place (m) that was reached after all."""
        radius = self.config.blacklist_radius
        self._failures = [f for f in self._failures if math.dist(f.place, place) > radius]

    def blocks(self, place: Point, now: float, vehicle: str | None = None) -> bool:
        """Return whether a target (m) is blacklisted for a vehicle at a time (s).

        By default for any vehicle.
        """
        entry = self._entry_at(place, vehicle)
        if entry is None:
            return False
        return now < entry.until or entry.attempts >= self.config.maximum_attempts

    def gave_up(self, place: Point, vehicle: str | None = None) -> bool:
        """Return whether a target (m) has failed too often for a vehicle; by default for any."""
        entry = self._entry_at(place, vehicle)
        return entry is not None and entry.attempts >= self.config.maximum_attempts

    def _add(self, place: Point, vehicle: str | None, now: float, free: int, final: bool) -> None:
        entry = self._nearest([f for f in self._failures if f.vehicle == vehicle], place)
        if entry is None:
            entry = _Failure(place, vehicle, 0, now, free)
            self._failures.append(entry)
        entry.attempts = self.config.maximum_attempts if final else entry.attempts + 1
        entry.free = free
        entry.until = now + self.config.blacklist_expiry * 2.0 ** (entry.attempts - 1)

    def _entry_at(self, place: Point, vehicle: str | None) -> _Failure | None:
        """Return the failure at a place that counts for a vehicle, or None."""
        if not self._failures:
            return None
        known = [f for f in self._failures if vehicle is None or f.vehicle in (None, vehicle)]
        return self._nearest(known, place)

    def _nearest(self, failures: list[_Failure], place: Point) -> _Failure | None:
        """Return the failure of most attempts, then the nearest, within the radius of a place."""
        near = [f for f in failures if math.dist(f.place, place) <= self.config.blacklist_radius]
        return min(near, key=lambda f: (-f.attempts, math.dist(f.place, place)), default=None)

    def _half_window(self, grid: Grid) -> int:
        """Return half the side (cells) of the window in which changes of the map are counted."""
        return max(2, math.ceil(2.0 * self.config.blacklist_radius / grid.resolution))

    def _free_around(self, place: Point, grid: Grid, free: NDArray[np.bool_]) -> int:
        half = self._half_window(grid)
        row, col = grid.to_cell([place])[0].tolist()
        window = free[max(0, row - half) : row + half + 1, max(0, col - half) : col + half + 1]
        return int(np.count_nonzero(window))
