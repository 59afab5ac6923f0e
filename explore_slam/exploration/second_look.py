"""A second look, before the end, at ways that have become blocked.

What blocks a way may go away: a person, a door, another vehicle. Nobody sees it go unless a
vehicle looks again. So before exploration ends, the cheapest way to the frontiers that are out of
reach is planned through what may have gone (KnownWays); a vehicle goes to where that way is
blocked first, looks, and waits for a limited time. What no laser sees, such as glass, is tried
again meanwhile.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.exploration.paths import search_path
from explore_slam.exploration.records import Cell, Frontier, Point
from explore_slam.exploration.regions import set_disc
from explore_slam.exploration.scene import Scene
from explore_slam.exploration.value_iteration import Costs, padded_costs, spread

# Chosen by hand; the tests of the planner show what they decide.
_DOUBT_FACTOR = 20.0  # by which cells of a blocked way cost more than free ones
_DISTANCE = 0.5  # m before the first blocked cell at which a vehicle looks
_SAME_PLACE = 1.0  # m; blocked places this near to each other are one
_WORTH_WAITING = 10.0  # m²; a way is waited for if rooms lie behind it, not for specks
_MOST_CASES = 3  # places at which the team waits; more are as good as a closed building
_LATER_PLACES = 0.25  # of the patience at the first place, at the others
_RETRY = 30.0  # s of waiting after which a blocked place is tried again
_AT_PLACE = 0.6  # m from where a vehicle should look, from which on it does


class Look(NamedTuple):
    """Where a vehicle is to look again.

    cell, place: where it stands for that, place in m. blocked: what it looks at (m).
    frontiers: number of those that lie behind.
    """

    vehicle: str
    cell: Cell
    place: Point
    blocked: Point
    frontiers: int


@dataclass
class _Case:
    """A blocked place (m): when (s) a vehicle was sent there, and has begun to look."""

    place: Point
    sent: float
    begun: float | None = None
    tried: float = -math.inf


class SecondLook:
    """Decides where to look again, and for how long."""

    def __init__(self, patience: float) -> None:
        """Create it; patience: time (s) for which a vehicle waits at a blocked place."""
        self._patience = patience
        self._cases: list[_Case] = []

    def choose(
        self, scene: Scene, blocked: NDArray[np.bool_], frontiers: list[Frontier]
    ) -> Look | None:
        """Return where to look for a way to the frontiers, or None if nothing is left to look at.

        blocked: cells (H, W) that may be passable, see KnownWays.
        """
        doubtful = self._doubtful(scene, blocked)
        padded = padded_costs(doubtful, math.inf)
        starts = [scene.starts[name] for name in scene.explorers]
        rows, cols = (np.array([cell[k] + 1 for cell in starts], np.int64) for k in (0, 1))
        values = spread(padded, rows, cols)
        cells = np.array([frontier.target_cell for frontier in frontiers], np.int64)
        costs = values[cells[:, 0] + 1, cells[:, 1] + 1]
        nearest = int(np.argmin(costs))
        behind = np.array([frontier.gain for frontier in frontiers])[np.isfinite(costs)]
        if behind.sum() < _WORTH_WAITING:
            return None
        goal = frontiers[nearest].target_cell
        look = self._look(scene, padded, goal, len(behind))
        if look is None or (self._case_at(look) is None and len(self._cases) >= _MOST_CASES):
            return None
        return look

    def note(self, look: Look, now: float, position: Point) -> bool:
        """Record where the vehicle of a look is at a time (s); return whether it is to try again.

        It waits from when it is there; one that does not get there is not waited for either.
        """
        case = self._case_at(look)
        if case is None:
            case = _Case(look.blocked, now)
            self._cases.append(case)
        if math.dist(position, look.place) > _AT_PLACE:
            return False
        if case.begun is None:
            case.begun = now
        if now - case.tried < _RETRY:
            return False
        case.tried = now
        return True

    def forget_expired(self, now: float) -> None:
        """Give up, at a time (s), the places where it has been waited for long enough."""
        for case in self._cases:
            late = case.begun is None and now - case.sent > 2.0 * self._patience
            if late:
                case.begun = now - self._patience - 1.0

    def _case_at(self, look: Look) -> _Case | None:
        for case in self._cases:
            if math.dist(case.place, look.blocked) <= _SAME_PLACE:
                return case
        return None

    def _closed(self, now: float) -> Iterable[Point]:
        """Yield the places that have been given up."""
        for index, case in enumerate(self._cases):
            patience = self._patience * (_LATER_PLACES if index else 1.0)
            if case.begun is not None and now - case.begun > patience:
                yield case.place

    def _doubtful(self, scene: Scene, blocked: NDArray[np.bool_]) -> Costs:
        """Return costs (H, W) at which ways that were once free may be planned."""
        costs = scene.reachable_costs().copy()
        typical = float(np.median(costs[np.isfinite(costs)]))
        costs[blocked & ~np.isfinite(costs)] = np.float32(_DOUBT_FACTOR * typical)
        closed = np.zeros(costs.shape, np.bool_)
        for place in self._closed(scene.now):
            set_disc(closed, *scene.cell_of(place), _SAME_PLACE / scene.grid.resolution)
        costs[closed & ~scene.reachable()] = np.inf
        return costs

    def _look(self, scene: Scene, padded: Costs, goal: Cell, frontiers: int) -> Look | None:
        """Return the look at the first blocked cell on the cheapest way of a vehicle to a cell."""
        stride = padded.shape[1]
        end = (goal[0] + 1) * stride + goal[1] + 1
        ways = {}
        for name in scene.explorers:
            row, col = scene.starts[name]
            ways[name] = search_path(padded, (row + 1) * stride + col + 1, end)
        name = min(ways, key=lambda one: ways[one][1])
        rows, cols = np.divmod(ways[name][0], stride)
        outside = ~scene.reach[name][rows - 1, cols - 1]
        if not outside.any():
            return None  # it can be reached after all
        first = int(np.argmax(outside))
        before = max(0, first - max(1, round(_DISTANCE / scene.grid.resolution)))
        cells = np.stack([rows, cols], axis=1)[[before, first]] - 1
        place, seen = scene.grid.to_point(cells).tolist()
        cell = int(cells[0, 0]), int(cells[0, 1])
        return Look(name, cell, (place[0], place[1]), (seen[0], seen[1]), frontiers)
