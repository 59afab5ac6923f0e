"""Metrics of exploration: coverage over time, overlap between vehicles, changes of goals.

Coverage is a fraction of the reachable area; the time to a coverage never reached is infinite.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from explore_slam.errors import EvaluationError
from explore_slam.geometry import Array

# Goals closer together than this (m) count as one: frontier goals shift by a few cells as the map
# grows.
GOAL_TOLERANCE = 0.5


@dataclass
class CoverageCurve:
    """Coverage over time, by the team and by each vehicle alone."""

    stamps: list[float] = field(default_factory=list)
    team: list[float] = field(default_factory=list)
    own: list[tuple[float, ...]] = field(default_factory=list)

    def add(self, stamp: float, team: float, own: Iterable[float]) -> None:
        """Append a sample; stamps increase, coverage of the team is in 0..1 and never falls."""
        shares = tuple(own)
        if self.stamps and (stamp <= self.stamps[-1] or len(shares) != len(self.own[-1])):
            raise EvaluationError(
                f'coverage: sample at {stamp} s of {len(shares)} vehicles after one at '
                f'{self.stamps[-1]} s of {len(self.own[-1])}, expected a later one, same team'
            )
        if not 0.0 <= team <= 1.0 or (self.team and team < self.team[-1]):
            raise EvaluationError(
                f'coverage: {team} for the team at {stamp} s, expected a value in 0..1 '
                'that never falls'
            )
        self.stamps.append(stamp)
        self.team.append(team)
        self.own.append(shares)

    def time_to(self, fraction: float) -> float:
        """Return the time (s) at which the team first reached this coverage, interpolated."""
        team = np.asarray(self.team)
        reached = np.flatnonzero(team >= fraction)
        if reached.size == 0:
            return math.inf
        last = int(reached[0])
        if last == 0 or team[last] == team[last - 1]:
            return self.stamps[last]
        part = (fraction - team[last - 1]) / (team[last] - team[last - 1])
        return float(self.stamps[last - 1] + part * (self.stamps[last] - self.stamps[last - 1]))

    def at(self, stamps: Sequence[float] | Array) -> Array:
        """Return the coverage (N,) of the team at stamps (N,) s; after the end, the last value."""
        if not self.stamps:
            raise EvaluationError('coverage: no samples')
        return np.interp(np.asarray(stamps, dtype=np.float64), self.stamps, self.team)

    def overlap(self) -> float:
        """Return the sum of the coverages of single vehicles minus 1: 0 where nothing overlaps."""
        return sum(self.own[-1]) - 1.0 if self.own else math.nan


@dataclass(frozen=True)
class Spread:
    """Mean, sample standard deviation and extremes of one metric over runs."""

    mean: float
    deviation: float
    low: float
    high: float
    count: int

    @classmethod
    def of(cls, values: Iterable[float]) -> 'Spread':
        """Return the statistics of values; one infinite value makes the mean infinite."""
        numbers = np.array(list(values), dtype=np.float64)
        if numbers.size == 0:
            raise EvaluationError('spread: no values')
        if not np.isfinite(numbers).all():
            return cls(
                math.inf, math.nan, float(numbers.min()), float(numbers.max()), len(numbers)
            )
        deviation = float(numbers.std(ddof=1)) if numbers.size > 1 else 0.0
        return cls(
            float(numbers.mean()),
            deviation,
            float(numbers.min()),
            float(numbers.max()),
            int(numbers.size),
        )

    def text(self, digits: int = 1) -> str:
        """Return 'mean ± deviation', or 'not reached' where the mean is infinite."""
        if not math.isfinite(self.mean):
            return 'not reached'
        return f'{self.mean:.{digits}f} ± {self.deviation:.{digits}f}'


class GoalCounter:
    """Counts the goals of one vehicle, and those that were replaced before it arrived."""

    def __init__(self, tolerance: float = GOAL_TOLERANCE) -> None:
        self.given = 0
        self.changed = 0
        self._tolerance = tolerance
        self._goal: tuple[float, float] | None = None

    def update(self, goal: tuple[float, float] | None, position: tuple[float, float]) -> None:
        """Count the current goal (x, y) m, None for none, of a vehicle at a position (x, y) m."""
        old = self._goal
        if goal is None or (old is not None and math.dist(goal, old) <= self._tolerance):
            return
        self.given += 1
        if old is not None and math.dist(position, old) > self._tolerance:
            self.changed += 1
        self._goal = goal

    def clear(self) -> None:
        """Forget the current goal: the vehicle has arrived or has no goal."""
        self._goal = None
