"""Progress of vehicles towards their targets, and when a target has failed."""

import math
from dataclasses import dataclass

# Chosen by hand; the tests of the planner show what they decide, and
# `explore_slam benchmark exploration` measures what another value does.
_MINIMUM_APPROACH = 0.1  # m by which the remaining path must shorten to count as progress
_ARRIVALS = 3  # planning cycles at a target, after which it has nothing new to show
_BLOCKAGES = 3  # times that a vehicle is blocked on its way before the target has failed


@dataclass
class Progress:
    """How a vehicle gets on towards its target.

    remaining: shortest remaining path (m) so far.
    since: time (s) of the last progress.
    arrivals: planning cycles for which it has been at the target.
    """

    since: float
    remaining: float = math.inf
    arrivals: int = 0

    def update(self, remaining: float, now: float, *, arrived: bool, waiting: bool) -> None:
        """Record one planning cycle at a time (s); waiting for right of way is not a delay."""
        if remaining < self.remaining - _MINIMUM_APPROACH or waiting:
            self.remaining, self.since = min(remaining, self.remaining), now
        self.arrivals += arrived

    @property
    def exhausted(self) -> bool:
        """Whether the vehicle has been at the target without seeing anything new."""
        return self.arrivals >= _ARRIVALS

    def restart(self) -> 'Progress':
        """Return the progress along a new path to the same target, which may be longer."""
        return Progress(self.since, math.inf, self.arrivals)


class BlockageCounter:
    """Counts how often vehicles were blocked on the way to their targets."""

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}

    def add(self, vehicle: str, *, near_target: bool) -> bool:
        """Count a blockage; return whether the target has failed by it."""
        count = self._counts.get(vehicle, 0) + 1
        failed = near_target or count >= _BLOCKAGES
        self._counts[vehicle] = 0 if failed else count
        return failed

    def reset(self, vehicle: str) -> None:
        """Forget the blockages of a vehicle."""
        self._counts[vehicle] = 0
