"""Vehicles that have a plan and do not move: motors off, a stuck wheel, a follower that is silent.

Such a vehicle is an obstacle, and its goal is for others, until it moves. It keeps the plan in
force, by which it may start. If it never does, it gets another chance after a while, each time
after twice as long.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from explore_slam.exploration.records import VehicleSnapshot
from explore_slam.geometry import Pose2, wrap_angle

# Chosen by hand; the tests of the planner show what they decide.
_MOVED = 0.1  # m from where a vehicle was, which count as motion
_TURNED = 0.2  # rad, likewise
_FIRST_PAUSE = 60.0  # s until a vehicle that has not moved is given a new plan for the first time


@dataclass
class _Rest:
    """Where a vehicle rests, and since when (s) it does although it has a plan.

    until: time (s) up to which it counts as an obstacle; -inf: it does not.
    pauses: how often it did since it moved last.
    """

    pose: Pose2
    since: float
    until: float = -math.inf
    pauses: int = 0


class Standstill:
    """Finds the vehicles that do not move, cycle by cycle."""

    def __init__(self, timeout: float) -> None:
        """Create it; timeout: time (s) with a plan and without motion."""
        self._timeout = timeout
        self._rests: dict[str, _Rest] = {}

    def update(
        self, now: float, vehicles: Mapping[str, VehicleSnapshot], driving: Mapping[str, bool]
    ) -> frozenset[str]:
        """Return the vehicles that do not move, at a time (s).

        driving: whether the plan in force of each vehicle leads anywhere.
        """
        for name, vehicle in vehicles.items():
            rest = self._rests.get(name)
            if rest is None or not vehicle.pose.is_finite() or _moved(rest.pose, vehicle.pose):
                self._rests[name] = _Rest(vehicle.pose, now)
            elif now < rest.until:
                continue
            elif math.isfinite(rest.until):  # another chance
                rest.until, rest.since = -math.inf, now
            elif not driving.get(name, False):
                rest.since = now
            elif now - rest.since >= self._timeout:
                rest.until = now + _FIRST_PAUSE * 2.0**rest.pauses
                rest.pauses += 1
        still = {name for name in vehicles if self._rests[name].until > now}
        return frozenset(still)

    def has_failed(self, name: str) -> bool:
        """Return whether a vehicle has not moved at all since it was found to stand still."""
        rest = self._rests.get(name)
        return rest is not None and rest.pauses > 0


def _moved(one: Pose2, other: Pose2) -> bool:
    if not one.is_finite():
        return True
    turned = abs(wrap_angle(other.theta - one.theta))
    return math.dist(one[:2], other[:2]) > _MOVED or turned > _TURNED
