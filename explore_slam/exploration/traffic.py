"""Right of way: no two vehicles in one narrow place at the same time, and no deadlock.

Vehicles have an order of priority. Each path is rolled out in time; where a vehicle would come too
near to one before it in the order, it stops at the last place of its path that is off that
vehicle's path, and if it already stands on that path it retreats to the nearest place that is not.
If retreating is easier for the other one, the two change places in the order and stay so.
"""

import math
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.exploration.config import TrafficConfig
from explore_slam.geometry import Array
from explore_slam.polyline import arc_lengths, points_at, project

STEP = 0.5  # s between the samples of a path in time
LINGER = 3.0  # s for which a vehicle at its goal is still in the way; then it has another goal
EASIER = 2.0  # m by which a retreat must be shorter to turn the order around


class Right(Enum):
    """What a vehicle may do now."""

    GO = 'go'
    STOP = 'stop'
    RETREAT = 'retreat'


@dataclass
class Grant:
    """The right of one vehicle: how far along its path (m), or the path out of the way of whom."""

    right: Right = Right.GO
    limit: float = math.inf
    winner: str = ''
    retreat: Array | None = None


@dataclass
class Traveler:
    """One vehicle in traffic: where it is and the path (W, 2) m before it, None if it has none."""

    name: str
    place: Array
    path: Array | None

    def __post_init__(self) -> None:
        points = self.place[None] if self.path is None else self.path
        self.points = points
        self.lengths = arc_lengths(points)


def remaining_path(place: Array, waypoints: Array) -> Array:
    """Return the part of a path (W, 2) that is ahead of a place (2,), which becomes its start."""
    if len(waypoints) < 2:
        return np.vstack([place, waypoints])
    nearest, _, _ = project(waypoints, place)
    return np.vstack([place, waypoints[nearest + 1 :]])


class Terrain(Protocol):
    """The map as traffic sees it."""

    def retreat(self, one: Traveler, winners: list[Traveler]) -> tuple[Array | None, float]:
        """Return the path (W, 2) m to the nearest place out of the way of others, and its cost."""


class Traffic:
    """Grants rights of way, cycle by cycle; remembers the order of priority."""

    def __init__(self, config: TrafficConfig) -> None:
        self.config = config
        self.order: list[str] = []

    def grant(self, travelers: dict[str, Traveler], terrain: Terrain) -> dict[str, Grant]:
        """Return the right of every vehicle."""
        self.order = [n for n in self.order if n in travelers]
        self.order += [n for n in sorted(travelers) if n not in self.order]
        for attempt in range(len(travelers) + 1):
            order = sorted(self.order, key=lambda n: travelers[n].path is None)
            now = dict(travelers)
            may_swap = attempt < len(travelers)
            grants, swap = self._try(order, now, terrain, may_swap=may_swap)
            if swap is None:
                break
            winner, loser = swap
            self.order.remove(winner)
            self.order.insert(self.order.index(loser) + 1, winner)
        self._wait_for_others(order, now, grants)
        return grants

    def _try(
        self, order: list[str], now: dict[str, Traveler], terrain: Terrain, *, may_swap: bool
    ) -> tuple[dict[str, Grant], tuple[str, str] | None]:
        """Grant in order; or return who should change places. Paths of retreats enter `now`."""
        grants: dict[str, Grant] = {}
        for index, name in enumerate(order):
            grant = Grant()
            for other in order[:index]:
                grant = self._yield_to(now[name], now[other], grants[other], grant)
            if grant.right is Right.RETREAT:
                path, cost = terrain.retreat(now[name], [now[n] for n in order[:index]])
                winner = now[grant.winner]
                if may_swap and winner.path is not None and now[name].path is not None:
                    _, other_cost = terrain.retreat(winner, [now[name]])
                    parks = self._parks_on(now[name], winner) and math.isfinite(cost)
                    if other_cost + EASIER < cost and not parks:
                        return grants, (grant.winner, name)
                if path is None:
                    grant = Grant(Right.STOP, 0.0, grant.winner)
                else:
                    grant.retreat = path
                    now[name] = Traveler(name, now[name].place, path)
            grants[name] = grant
        return grants, None

    def _parks_on(self, one: Traveler, other: Traveler) -> bool:
        """Tell whether the goal of one lies on the path of the other: it would block it again."""
        gap = _gaps(one.points[-1:], self._dense(other))[0]
        return bool(gap < self.config.vehicle_separation)

    def threshold(self, one: Traveler, other: Traveler) -> float:
        """Return how near the two may come: the separation, or what they have now if less."""
        return min(self.config.vehicle_separation, 0.95 * math.dist(one.place, other.place))

    def _yield_to(self, one: Traveler, other: Traveler, granted: Grant, so_far: Grant) -> Grant:
        """Return the right of one vehicle after regard for another that is before it in order."""
        if so_far.right is Right.RETREAT or self._first_conflict(one, other, granted) is None:
            return so_far
        near = self.threshold(one, other)
        swept = self._dense(other, self._limit(granted))
        at = np.arange(0.0, min(one.lengths[-1], self._reach()) + 1e-9, 0.1)
        own = points_at(one.points, one.lengths, at)
        gaps = _gaps(own, swept)
        blocked = np.flatnonzero(gaps < near)
        if blocked.size == 0:
            return so_far
        if blocked[0] == 0:
            return Grant(Right.RETREAT, 0.0, other.name)
        limit = float(at[blocked[0] - 1])
        if limit < so_far.limit:
            return Grant(Right.STOP, limit, other.name)
        return so_far

    def _reach(self) -> float:
        return self.config.traffic_horizon * self.config.nominal_speed

    def _dense(self, traveler: Traveler, limit: float = math.inf) -> Array:
        """Return the path ahead within the horizon as points (N, 2) 0.1 m apart."""
        end = min(traveler.lengths[-1], self._reach(), limit)
        return points_at(
            traveler.points, traveler.lengths, np.append(np.arange(0.0, end, 0.1), end)
        )

    def _rolled_out(self, traveler: Traveler, limit: float) -> Array:
        """Return places (T, 2) at time steps, NaN once LINGER has passed at the goal."""
        times = np.arange(0.0, self.config.traffic_horizon + 1e-9, STEP)
        end = min(traveler.lengths[-1], limit)
        at = np.minimum(times * self.config.nominal_speed, end)
        places = points_at(traveler.points, traveler.lengths, at)
        if traveler.path is not None and limit >= traveler.lengths[-1]:
            places[times > end / self.config.nominal_speed + LINGER] = np.nan
        return places

    def _first_conflict(self, one: Traveler, other: Traveler, granted: Grant) -> int | None:
        """Return the first time step at which the one comes too near to the other."""
        mine = self._rolled_out(one, math.inf)
        theirs = self._rolled_out(other, self._limit(granted))
        first = first_meeting(
            mine,
            theirs,
            np.gradient(mine, axis=0),
            np.gradient(theirs, axis=0),
            self.threshold(one, other),
            self.config.traffic_margin,
        )
        return first if first >= 0 else None

    @staticmethod
    def _limit(grant: Grant) -> float:
        return grant.limit if grant.right is Right.STOP else math.inf

    def _wait_for_others(
        self, order: list[str], now: dict[str, Traveler], grants: dict[str, Grant]
    ) -> None:
        """Stop vehicles before those later in order that stand in their way or have to get out."""
        for index, name in enumerate(order):
            one = now[name]
            if grants[name].right is Right.RETREAT or one.path is None:
                continue
            at = np.arange(0.0, min(one.lengths[-1], self._reach()) + 1e-9, 0.1)
            own = points_at(one.points, one.lengths, at)
            for other_name in order[index + 1 :]:
                other, right = now[other_name], grants[other_name]
                if right.right is Right.GO and other.path is not None:
                    continue
                way = self._dense(other, self._limit(right))
                hits = np.flatnonzero(_gaps(own, way) < self.threshold(one, other))
                if hits.size:
                    limit = float(at[max(0, hits[0] - 1)])
                    if limit < grants[name].limit:
                        grants[name] = Grant(Right.STOP, limit, other_name)


@kernel
def first_meeting(
    mine: Array, theirs: Array, own_way: Array, their_way: Array, near: float, margin: float
) -> int:
    """Return the first time step at which one comes nearer than `near` (m) to another, or -1.

    Places and headings (T, 2) at time steps; who comes the other way or across has to be a margin
    (s) before or behind, who goes the same way need not. NaN is nowhere.
    """
    count = mine.shape[0]
    for i in range(count):
        for j in range(count):
            same_way = own_way[i, 0] * their_way[j, 0] + own_way[i, 1] * their_way[j, 1] > 0.0
            if abs(i - j) * STEP > (0.5 * STEP if same_way else margin):
                continue
            dx, dy = mine[i, 0] - theirs[j, 0], mine[i, 1] - theirs[j, 1]
            if math.sqrt(dx * dx + dy * dy) < near:
                return i
    return -1


def _gaps(points: Array, others: Array) -> Array:
    """Return for each point (N, 2) the distance (N,) to the nearest of the others (M, 2)."""
    gaps: Array = np.linalg.norm(points[:, None] - others[None], axis=2).min(axis=1)
    return gaps


def stamp_disc(mask: NDArray[np.bool_], row: int, col: int, reach: float) -> None:
    """Set the cells of a disc in a mask (H, W)."""
    half = math.floor(reach)
    low_r, low_c = max(0, row - half), max(0, col - half)
    window = mask[low_r : max(0, row + half + 1), low_c : max(0, col + half + 1)]
    r, c = np.ogrid[low_r : low_r + window.shape[0], low_c : low_c + window.shape[1]]
    window[(r - row) ** 2 + (c - col) ** 2 <= reach * reach] = True
