"""Metrics of exploration: how fast the reachable area is seen, at what path, overlap and contacts.

Shares are of the reachable area; a time that was never reached is infinite.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from explore_slam.errors import EvaluationError
from explore_slam.geometry import Array


@dataclass
class CoverageCurve:
    """Share of the reachable area seen by the team, and by each vehicle alone, over time."""

    stamps: list[float] = field(default_factory=list)
    team: list[float] = field(default_factory=list)
    own: list[tuple[float, ...]] = field(default_factory=list)

    def add(self, stamp: float, team: float, own: Iterable[float]) -> None:
        """Append one sample; stamps rise, the team's share never falls and is in 0..1."""
        shares = tuple(own)
        if self.stamps and (stamp <= self.stamps[-1] or len(shares) != len(self.own[-1])):
            raise EvaluationError(
                f'coverage: sample at {stamp} s of {len(shares)} vehicles after '
                f'{self.stamps[-1]} s of {len(self.own[-1])}, expected rising stamps, same team'
            )
        if not 0.0 <= team <= 1.0 or (self.team and team < self.team[-1]):
            raise EvaluationError(
                f'coverage: share of the team is {team} at {stamp} s, expected one in 0..1 '
                'that does not fall'
            )
        self.stamps.append(stamp)
        self.team.append(team)
        self.own.append(shares)

    def time_to(self, share: float) -> float:
        """Return when (s) the team had first seen this share, between samples by the line."""
        team = np.asarray(self.team)
        reached = np.flatnonzero(team >= share)
        if reached.size == 0:
            return math.inf
        last = int(reached[0])
        if last == 0 or team[last] == team[last - 1]:
            return self.stamps[last]
        part = (share - team[last - 1]) / (team[last] - team[last - 1])
        return float(self.stamps[last - 1] + part * (self.stamps[last] - self.stamps[last - 1]))

    def at(self, stamps: Sequence[float] | Array) -> Array:
        """Return the team's share (N,) at stamps (N,) s; after the end the last one."""
        if not self.stamps:
            raise EvaluationError('coverage: no samples')
        return np.interp(np.asarray(stamps, dtype=np.float64), self.stamps, self.team)

    def overlap(self) -> float:
        """Return the sum of the vehicles' own shares less one: 0 when none was seen twice."""
        return sum(self.own[-1]) - 1.0 if self.own else math.nan


@dataclass(frozen=True)
class Spread:
    """Mean, standard deviation (of the sample) and extremes of one metric over runs."""

    mean: float
    deviation: float
    low: float
    high: float
    count: int

    @classmethod
    def of(cls, values: Iterable[float]) -> 'Spread':
        """Summarise values; any infinite one makes the mean infinite, none at all is an error."""
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
        """Return 'mean ± deviation', or how it failed."""
        if not math.isfinite(self.mean):
            return 'not reached'
        return f'{self.mean:.{digits}f} ± {self.deviation:.{digits}f}'


class GoalCounter:
    """Counts goals given to one vehicle and those taken away before the vehicle was there."""

    def __init__(self, same_within: float = 0.5) -> None:
        self.given = 0
        self.changed = 0
        self._same_within = same_within
        self._goal: tuple[float, float] | None = None

    def see(self, goal: tuple[float, float] | None, place: tuple[float, float]) -> None:
        """Take note of the present goal (m), None for none, and of where the vehicle is (m)."""
        old = self._goal
        if goal is None or (old is not None and math.dist(goal, old) <= self._same_within):
            return
        self.given += 1
        if old is not None and math.dist(place, old) > self._same_within:
            self.changed += 1
        self._goal = goal

    def clear(self) -> None:
        """Forget the present goal: the vehicle arrived or has none any more."""
        self._goal = None
