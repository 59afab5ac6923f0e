"""Keep-out zones: places where a vehicle was blocked though the map shows them as free.

What blocks a vehicle may be invisible to the laser (glass, table tops) or passing by (people), so
a zone expires, and becomes permanent when a vehicle is blocked there again.
"""

import itertools
import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from explore_slam.exploration.records import Point

# Chosen by hand, with vehicles that meet glass, people and each other in tests;
# `explore_slam benchmark exploration` measures what another value does.
_DURATION = 60.0  # s until a zone expires
_SAME_PLACE = 0.5  # m; a blockage this near to an earlier one is at the same place
TRAFFIC_DISTANCE = 1.5  # m; with another vehicle this near, that vehicle is the obstacle
_WALL_LENGTH = 1.0  # m; permanent zones this near to each other are parts of one wall
_WALL_SPACING = 0.3  # m between the zones that fill a wall
_RELEASE_RADIUS = 2.0  # m around a trapped vehicle in which zones are released
_MAXIMUM_RELEASES = 5  # at one place; then the zones are kept
_OTHER_PLACE = 8.0  # m from the last release, after which releases are counted anew


class KeepOutZone(NamedTuple):
    """A place (m) that paths avoid until a time (s); inf is permanent."""

    place: Point
    until: float


class _Release(NamedTuple):
    """How often zones were released for a trapped vehicle, and where (m) last."""

    times: int
    place: Point


class KeepOutZones:
    """All zones in force; remembers the expired ones, and the releases of each vehicle."""

    def __init__(self) -> None:
        self._zones: list[KeepOutZone] = []
        self._expired: list[Point] = []
        self._releases: dict[str, _Release] = {}

    def add(self, place: Point, now: float, others: Iterable[Point]) -> None:
        """Add a zone where a vehicle was blocked, unless another vehicle was in the way.

        others: positions (m) of the other vehicles.
        """
        if any(math.dist(other, place) < TRAFFIC_DISTANCE for other in others):
            return
        earlier = [zone.place for zone in self._zones] + self._expired
        again = any(math.dist(other, place) < _SAME_PLACE for other in earlier)
        self._zones.append(KeepOutZone(place, math.inf if again else now + _DURATION))

    def expire(self, now: float) -> None:
        """Remove the zones whose time (s) is over."""
        self._remove([zone for zone in self._zones if now >= zone.until])

    def release_temporary(self) -> bool:
        """Remove all zones that are not permanent; return whether there were any."""
        temporary = [zone for zone in self._zones if math.isfinite(zone.until)]
        self._remove(temporary)
        return bool(temporary)

    def release_around(self, vehicle: str, place: Point) -> bool:
        """Remove the zones around a trapped vehicle, permanent ones too; return if there were any.

        They may close its only way out. After several releases at one place nothing is removed.
        """
        near = [z for z in self._zones if math.dist(z.place, place) <= _RELEASE_RADIUS]
        times, last = self._releases.get(vehicle, _Release(0, place))
        if math.dist(place, last) > _OTHER_PLACE:
            times = 0
        if not near or times >= _MAXIMUM_RELEASES:
            return False
        self._releases[vehicle] = _Release(times + 1, place)
        self._zones = [zone for zone in self._zones if zone not in near]
        return True

    def places(self) -> list[Point]:
        """Return the places (m) of all zones, with the gaps between permanent ones filled."""
        places = [zone.place for zone in self._zones]
        walls = [zone.place for zone in self._zones if math.isinf(zone.until)]
        for first, second in itertools.combinations(walls, 2):
            length = math.dist(first, second)
            if length <= _WALL_LENGTH:
                fractions = np.arange(_WALL_SPACING, length, _WALL_SPACING) / length
                between = np.array(first) + fractions[:, None] * (np.array(second) - first)
                places += [(x, y) for x, y in between.tolist()]
        return places

    def _remove(self, zones: list[KeepOutZone]) -> None:
        self._expired += [zone.place for zone in zones]
        self._zones = [zone for zone in self._zones if zone not in zones]
