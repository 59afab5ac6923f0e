"""Going back to a known place, where that is worth more than going on.

Frontiers lead a vehicle away from what it has mapped, and they vanish as soon as its laser joins
them with the known map from afar: a loop may then stay open although its end is a few metres off.
What the vehicle maps from there on has the error of its pose. A known place nearby, far along the
way driven and near in the map, ends that (C. Stachniss, D. Hähnel and W. Burgard, "Exploration
with active loop-closing for FastSLAM", IROS 2004). They decide by thresholds; here both sides are
travel: the detour now, against the way that the vehicle would have to come back from its next
target, times the probability that the map is wrong by more than it may be.
"""

import math
from dataclasses import dataclass

import numpy as np

from explore_slam.exploration.records import Cell, Frontier, KnownPlace, Point
from explore_slam.exploration.scene import Scene
from explore_slam.exploration.sections import LoopConfig
from explore_slam.geometry import Array

# Chosen by hand; `explore_slam benchmark exploration --slam` measures what another value does.
_OVERLAP = 6.0  # m into the known part: the way of which the scans are matched to close a loop
_SAME_PLACE = 8.0  # m; known places within the range of the laser show the same
_WORSE = 1.5  # a place tried in vain is tried again when its deviation has grown by this factor
_CLOSED = 0.5  # of the deviation at the beginning; below it the loop has been closed
_SLOWEST = 0.1  # m/s; a vehicle that gets on more slowly gives the place up


@dataclass
class _Visit:
    """A known place that a vehicle drives to, and when (s) it is given up."""

    known: KnownPlace
    until: float


class LoopSeeking:
    """Decides which vehicle goes back to a known place; remembers those that were tried."""

    def __init__(self, config: LoopConfig) -> None:
        self._config = config
        self._visits: dict[str, _Visit] = {}
        self._tried: dict[str, list[KnownPlace]] = {}

    def target(
        self, scene: Scene, name: str, ahead: Frontier | None, frontiers: list[Frontier]
    ) -> tuple[Point, Cell] | None:
        """Return the place (m) and the cell that a vehicle should go back to, None: it goes on.

        ahead: the frontier that it is on its way to; None: the nearest one is what comes next.
        """
        places = scene.vehicles[name].known_places
        visit = self._visits.get(name)
        if visit is not None:
            cell = scene.nearest_passable(name, visit.known.place)
            if cell is not None and self._goes_on(scene, name, visit, cell):
                return visit.known.place, cell
            del self._visits[name]
            self._tried.setdefault(name, []).append(visit.known)
        doubtful = [place for place in places if self._is_worth_a_try(name, place)]
        if not doubtful:
            return None
        found = self._choose(scene, name, doubtful, ahead, frontiers)
        if found is None:
            return None
        self._visits[name], cell = found
        return self._visits[name].known.place, cell

    def _goes_on(self, scene: Scene, name: str, visit: _Visit, cell: Cell) -> bool:
        """Return whether a visit, to a cell now, is neither complete nor given up."""
        arrival = scene.config.paths.arrival_distance
        if math.dist(scene.vehicles[name].pose[:2], visit.known.place) <= 2.0 * arrival:
            return False
        if scene.now > visit.until or not scene.reach[name][cell]:
            return False
        places = scene.vehicles[name].known_places
        near = [p.deviation for p in places if math.dist(p.place, visit.known.place) < _SAME_PLACE]
        return not near or min(near) > _CLOSED * visit.known.deviation

    def _is_worth_a_try(self, name: str, place: KnownPlace) -> bool:
        """Return whether the map is in doubt at a place that was not tried in vain as it is."""
        if place.deviation < self._config.loop_deviation:
            return False
        return all(
            math.dist(place.place, tried.place) > _SAME_PLACE
            or place.deviation > _WORSE * tried.deviation
            for tried in self._tried.get(name, ())
        )

    def _choose(
        self,
        scene: Scene,
        name: str,
        places: list[KnownPlace],
        ahead: Frontier | None,
        frontiers: list[Frontier],
    ) -> tuple[_Visit, Cell] | None:
        """Return the visit to a place that saves travel, and its cell; None if none does."""
        cells = [scene.nearest_passable(name, place.place) for place in places]
        found = [
            (place, cell)
            for place, cell in zip(places, cells, strict=True)
            if cell is not None and scene.reach[name][cell]
        ]
        if not found:
            return None
        every = np.array([cell for _, cell in found], np.int64)
        there = scene.cost_to(name, every)
        to_frontiers = scene.costs_to((name,), frontiers)[0]
        if ahead is None:
            ahead = frontiers[int(np.argmin(to_frontiers))]
        on = scene.cost_to(name, np.array([ahead.target_cell], np.int64))[0]
        routes = scene.routes(name)
        back = routes.values_from(routes.blocks(np.array([ahead.target_cell], np.int64))[0]).at(
            routes.blocks(every)
        )
        deviations = np.array([place.deviation for place, _ in found])
        saved = loop_savings(there, back, float(on), deviations, self._config.map_tolerance)
        saved[there > self._config.loop_reach] = -np.inf
        worth = np.flatnonzero(saved > 0.0)
        if not worth.size:
            return None
        # the nearest place that is worth it, and on into the known part until the scans overlap
        nearest = there[worth].min()
        best = worth[np.argmin(np.abs(there[worth] - nearest - _OVERLAP))]
        known, cell = found[int(best)]
        return _Visit(known, scene.now + float(there[best]) / _SLOWEST), cell


def loop_savings(
    there: Array, back: Array, ahead: float, deviations: Array, tolerance: float
) -> Array:
    """Return the travel (N,) m that going back to known places first is expected to save.

    there (N,) m: ways to them; back (N,) m: from the next target to them; ahead (m): to that
    target. Positions have a standard deviation (N,) m in every direction, so that an error exceeds
    the tolerance (m) with the probability of a Rayleigh distribution. Then the vehicle would have
    to come back from its next target, and to return to it.
    """
    wrong = np.exp(-0.5 * np.square(tolerance / np.maximum(deviations, 1e-9)))
    savings: Array = wrong * 2.0 * back - (there + back - ahead)
    return savings
