"""Right of way: no two vehicles in one narrow place at the same time, and no deadlock.

Vehicles have an order of priority. Each path is predicted in time. Where a vehicle would come too
near to one of higher priority, it stops at the last place of its path that is off the other's
path; if it stands on that path already, it retreats to the nearest place that is not. If
retreating is easier for the other one, the two change places in the order and stay so. Of vehicles
that all wait for each other, the first goes.
"""

import math
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Protocol

import numpy as np

from explore_slam.compiled import kernel
from explore_slam.data import VehicleBody
from explore_slam.exploration.sections import TrafficConfig
from explore_slam.geometry import Array
from explore_slam.polyline import arc_lengths, points_at

# Chosen by hand; test_right_of_way drives vehicles through narrow maps with them, and
# `explore_slam benchmark exploration` measures what another value does.
_TIME_STEP = 0.5  # s between predicted positions
_GOAL_TIME = 3.0  # s for which a vehicle is expected to stay at its goal, until it gets another
_RETREAT_ADVANTAGE = 2.0  # m by which a retreat must be shorter to exchange the priorities
_SPACING = 0.1  # m between the positions of a path that are checked for conflicts
_CLOSER = 0.95  # of the present distance of two vehicles that are nearer than the separation
SHORTEST_DRIVE = 0.3  # m; a path that ends earlier, at a stop, is not worth driving
_ROUNDING = 1e-9  # so that the last step of a range is included


class RightOfWay(Enum):
    """What a vehicle may do now."""

    GO = 'go'
    STOP = 'stop'
    RETREAT = 'retreat'


@dataclass
class Grant:
    """The right of way of one vehicle.

    limit: distance (m) along its path at which it must stop.
    yields_to: name of the vehicle that has priority.
    retreat: path (W, 2) m out of the way of that vehicle.
    """

    right: RightOfWay = RightOfWay.GO
    limit: float = math.inf
    yields_to: str = ''
    retreat: Array | None = None


@dataclass
class Traveler:
    """One vehicle in traffic: its position (2,) m and the path (W, 2) m ahead, None if idle.

    urgent: has right of way over all that are not.
    """

    name: str
    position: Array
    path: Array | None
    body: VehicleBody = field(default_factory=VehicleBody)
    urgent: bool = False

    def __post_init__(self) -> None:
        self.points = self.position[None] if self.path is None else self.path
        self.lengths = arc_lengths(self.points)


class Terrain(Protocol):
    """Finds places to retreat to."""

    def retreat(self, one: Traveler, others: list[Traveler]) -> tuple[Array | None, float]:
        """Return the path (W, 2) m to the nearest place off the paths of others, and its cost."""


def separation(config: TrafficConfig, one: VehicleBody, other: VehicleBody) -> float:
    """Return the distance (m) kept between the centres of two vehicles."""
    return max(config.vehicle_separation + one.extra_radius + other.extra_radius, 0.0)


class Traffic:
    """Grants rights of way, cycle by cycle.

    order: names of the vehicles, highest priority first; it persists between cycles.
    """

    def __init__(self, config: TrafficConfig) -> None:
        self.config = config
        self.order: list[str] = []

    def grant(self, travelers: dict[str, Traveler], terrain: Terrain) -> dict[str, Grant]:
        """Return the right of way of every vehicle."""
        self.order = [n for n in self.order if n in travelers]
        self.order += [n for n in sorted(travelers) if n not in self.order]
        urgent = {name for name, one in travelers.items() if one.urgent}
        for attempt in range(len(travelers) + 1):
            order = sorted(
                self.order,
                key=lambda name: (travelers[name].path is None, name not in urgent),
            )
            now = dict(travelers)
            may_exchange = attempt < len(travelers)
            grants, exchange = self._try(order, now, terrain, may_exchange=may_exchange)
            if exchange is None:
                break
            demoted, promoted = exchange
            urgent.discard(demoted)
            self.order.remove(demoted)
            self.order.insert(self.order.index(promoted) + 1, demoted)
        self._wait_for_others(order, now, grants)
        self._break_deadlocks(order, now, grants)
        return grants

    def _try(
        self, order: list[str], now: dict[str, Traveler], terrain: Terrain, *, may_exchange: bool
    ) -> tuple[dict[str, Grant], tuple[str, str] | None]:
        """Grant rights in this order, or return two vehicles that should exchange priorities.

        Of the two, the first is the one to be demoted. Retreats replace the paths in `now`.
        """
        grants: dict[str, Grant] = {}
        for index, name in enumerate(order):
            grant = Grant()
            for before in order[:index]:
                grant = self._yield_to(now[name], now[before], grants[before], grant)
            if grant.right is RightOfWay.RETREAT:
                path, cost = terrain.retreat(now[name], [now[n] for n in order[:index]])
                other = now[grant.yields_to]
                if may_exchange and other.path is not None and now[name].path is not None:
                    _, other_cost = terrain.retreat(other, [now[name]])
                    parks = self._parks_on(now[name], other) and math.isfinite(cost)
                    # an urgent vehicle gives way only to one that cannot
                    kept = other.urgent and not now[name].urgent and math.isfinite(cost)
                    if other_cost + _RETREAT_ADVANTAGE < cost and not (parks or kept):
                        return grants, (other.name, name)
                if path is None:
                    grant = Grant(RightOfWay.STOP, 0.0, other.name)
                else:
                    grant.retreat = path
                    now[name] = replace(now[name], path=path)
            grants[name] = grant
        return grants, None

    def _parks_on(self, one: Traveler, other: Traveler) -> bool:
        """Return whether the goal of one lies on the path of the other, and would block it."""
        gap = _gaps(one.points[-1:], self._dense(other))[0]
        return bool(gap < separation(self.config, one.body, other.body))

    def threshold(self, one: Traveler, other: Traveler) -> float:
        """Return the allowed distance (m) of two: the separation, or less if they are nearer."""
        present = math.dist(one.position, other.position)
        return min(separation(self.config, one.body, other.body), _CLOSER * present)

    def _yield_to(self, one: Traveler, other: Traveler, granted: Grant, so_far: Grant) -> Grant:
        """Return the right of one vehicle, restricted by another one of higher priority."""
        if so_far.right is RightOfWay.RETREAT or not self._in_conflict(one, other, granted):
            return so_far
        swept = self._dense(other, self._limit(granted))
        at = self._distances(one)
        own = points_at(one.points, one.lengths, at)
        blocked = np.flatnonzero(_gaps(own, swept) < self.threshold(one, other))
        if blocked.size == 0:
            return so_far
        if blocked[0] == 0:
            return Grant(RightOfWay.RETREAT, 0.0, other.name)
        limit = float(at[blocked[0] - 1])
        if limit < so_far.limit:
            return Grant(RightOfWay.STOP, limit, other.name)
        return so_far

    def _reach(self, one: Traveler) -> float:
        """Return the distance (m) that a vehicle drives within the horizon."""
        return self.config.traffic_horizon * one.body.speed

    def _distances(self, one: Traveler) -> Array:
        """Return distances (N,) m along a path within the horizon, from 0 at equal spacing."""
        return np.arange(0.0, min(one.lengths[-1], self._reach(one)) + _ROUNDING, _SPACING)

    def _dense(self, traveler: Traveler, limit: float = math.inf) -> Array:
        """Return the path ahead within the horizon as points (N, 2) m at equal spacing."""
        end = min(traveler.lengths[-1], self._reach(traveler), limit)
        at = np.append(np.arange(0.0, end, _SPACING), end)
        return points_at(traveler.points, traveler.lengths, at)

    def _predict(self, traveler: Traveler, limit: float) -> Array:
        """Return positions (T, 2) m at time steps; NaN after the vehicle has left its goal."""
        times = np.arange(0.0, self.config.traffic_horizon + _ROUNDING, _TIME_STEP)
        end = min(traveler.lengths[-1], limit)
        at = np.minimum(times * traveler.body.speed, end)
        positions = points_at(traveler.points, traveler.lengths, at)
        if traveler.path is not None and limit >= traveler.lengths[-1]:
            positions[times > end / traveler.body.speed + _GOAL_TIME] = np.nan
        return positions

    def _in_conflict(self, one: Traveler, other: Traveler, granted: Grant) -> bool:
        """Return whether one vehicle is predicted to come too near to the other."""
        own = self._predict(one, math.inf)
        others = self._predict(other, self._limit(granted))
        return paths_conflict(
            own,
            others,
            np.gradient(own, axis=0),
            np.gradient(others, axis=0),
            self.threshold(one, other),
            self.config.traffic_margin,
        )

    @staticmethod
    def _limit(grant: Grant) -> float:
        """Return the distance (m) along its path that a vehicle may drive."""
        return grant.limit if grant.right is RightOfWay.STOP else math.inf

    def _wait_for_others(
        self, order: list[str], now: dict[str, Traveler], grants: dict[str, Grant]
    ) -> None:
        """Stop vehicles short of those of lower priority that stand in their way or retreat."""
        for index, name in enumerate(order):
            one = now[name]
            if grants[name].right is RightOfWay.RETREAT or one.path is None:
                continue
            at = self._distances(one)
            own = points_at(one.points, one.lengths, at)
            for other_name in order[index + 1 :]:
                other, right = now[other_name], grants[other_name]
                if right.right is RightOfWay.GO and other.path is not None:
                    continue
                swept = self._dense(other, self._limit(right))
                hits = np.flatnonzero(_gaps(own, swept) < self.threshold(one, other))
                if hits.size:
                    limit = float(at[max(0, hits[0] - 1)])
                    if limit < grants[name].limit:
                        grants[name] = Grant(RightOfWay.STOP, limit, other_name)

    @staticmethod
    def _break_deadlocks(
        order: list[str], now: dict[str, Traveler], grants: dict[str, Grant]
    ) -> None:
        """Let the first go of vehicles that stand and wait for each other in a circle.

        Its follower keeps it from touching the others; if it cannot pass, it gets another target.
        """
        standing = {
            name: grant.yields_to
            for name, grant in grants.items()
            if grant.right is RightOfWay.STOP and grant.limit < SHORTEST_DRIVE
        }
        for name in order:
            if now[name].path is None or name not in standing:
                continue
            seen, waits_for = {name}, standing[name]
            while waits_for in standing and waits_for not in seen:
                seen.add(waits_for)
                waits_for = standing[waits_for]
            if waits_for == name:
                grants[name] = Grant()
                del standing[name]


@kernel
def paths_conflict(
    own: Array,
    others: Array,
    own_velocity: Array,
    other_velocity: Array,
    distance: float,
    margin: float,
) -> bool:
    """Return whether one vehicle comes nearer than a distance (m) to another.

    Positions and velocities (T, 2) at time steps. A vehicle that crosses, or comes the other way,
    has to pass a margin (s) earlier or later; one that drives the same way need not. NaN conflicts
    with nothing.
    """
    count = own.shape[0]
    for i in range(count):
        for j in range(count):
            product = own_velocity[i, 0] * other_velocity[j, 0]
            same_way = product + own_velocity[i, 1] * other_velocity[j, 1] > 0.0
            if abs(i - j) * _TIME_STEP > (0.5 * _TIME_STEP if same_way else margin):
                continue
            dx, dy = own[i, 0] - others[j, 0], own[i, 1] - others[j, 1]
            if math.sqrt(dx * dx + dy * dy) < distance:
                return True
    return False


def _gaps(points: Array, others: Array) -> Array:
    """Return for each point (N, 2) the distance (N,) to the nearest of the others (M, 2)."""
    gaps: Array = np.linalg.norm(points[:, None] - others[None], axis=2).min(axis=1)
    return gaps
