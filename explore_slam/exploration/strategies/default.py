"""Strategy default: tours of the whole team through all frontiers; each vehicle starts its own.

1. Frontiers that lie together are merged into stops.
2. Stops that are not worth their detour now are left for later.
3. Tours are planned for the team; those of the last cycle are kept unless new ones are much
   cheaper.
4. A vehicle without a tour is sent where most is left to see.
"""

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from explore_slam.exploration.assignment import assign_jointly
from explore_slam.exploration.records import Frontier
from explore_slam.exploration.routes import RouteCache
from explore_slam.exploration.sections import AssignmentConfig
from explore_slam.exploration.strategies.strategy import Situation, StrategyKind
from explore_slam.exploration.tours import TourProblem, Tours, plan_tours
from explore_slam.geometry import Array

# Chosen by hand; `explore_slam benchmark exploration` measures what another value does.
_SAME_STOP = 2.0  # m; a stop that has moved by no more is the same one
_MERGE_FRACTION = 0.15  # of the distance to the nearest vehicle; far stops are merged coarsely
_MAXIMUM_STOPS = 60  # of all tours together; bounds the time for planning
_LARGEST_GAIN = 60.0  # m²; larger unknown areas are no more work than this
_URGENCY_FLOOR = 2.0  # m²; added to the gain of every stop, so that small ones are visited too
_URGENT_GAIN = 20.0  # m²; larger unknown areas are no more urgent than this
_SHORTEST_SIDE_RANGE = 0.1  # m; a vehicle that sees less to the side counts as seeing this
_MINIMUM_DETOUR = 0.1  # m; smaller detours count as this


class Stop(NamedTuple):
    """Frontiers that are visited together, by index; the vehicle drives to the first one."""

    target: int
    members: list[int]


class DefaultStrategy:
    """Plans tours; remembers those of the last cycle and the travel costs between targets."""

    def __init__(self, config: AssignmentConfig, sensor_range: float) -> None:
        self._config = config
        self._sensor_range = sensor_range
        self._caches: dict[float, RouteCache] = {}  # by the envelope (m) of a body
        self._tours: dict[str, Array] = {}  # stops (N, 2) m of each vehicle in order

    def assign(self, situation: Situation) -> list[int]:
        """See Strategy.assign.

        The cost by which new tours must be better doubles with every switch of a target.
        """
        costs, current, frontiers = situation.costs, situation.current, situation.frontiers
        stops = merge_frontiers(frontiers, costs, current, self._config.merge_distance)
        targets = [stop.target for stop in stops]
        points = situation.targets[targets]
        all_gains = np.array([frontier.gain for frontier in frontiers])
        gains = np.array([all_gains[stop.members].sum() for stop in stops])
        fixed = np.array([targets.index(k) if k in targets else -1 for k in current], np.int64)

        problem = self._problem(situation, targets, gains)
        least = self._config.gain_per_detour / situation.slowness
        problem = defer_low_gain_stops(problem, gains, fixed, least)
        prior = self._prior_tours(situation.vehicles, points)
        margin = self._config.tour_hysteresis * 2.0 ** max(situation.switches, default=0)
        tours = improve_or_replace(problem, fixed, prior, margin)

        self._tours = {
            name: points[order]
            for name, order in zip(situation.vehicles, tours.orders, strict=True)
        }
        chosen = [targets[order[0]] if order else -1 for order in tours.orders]
        return self._assign_idle(chosen, situation)

    def _problem(self, situation: Situation, targets: list[int], gains: Array) -> TourProblem:
        """Return costs, work and urgency of the stops, as travel of the fastest vehicle.

        The others take longer for the same way, and a large vehicle may have to go round. Walls
        leave a strip of 1 / work_per_area (m) to be seen on the way through a building; a vehicle
        that sees a narrower one has to drive more.
        """
        config, slowness = self._config, situation.slowness
        every = np.array([frontier.target_cell for frontier in situation.frontiers])
        between: dict[float, Array] = {}
        for name, body in zip(situation.vehicles, situation.kinds, strict=True):
            if body.envelope not in between:
                routes = situation.scene.routes(name)
                cache = self._caches.setdefault(body.envelope, RouteCache())
                alike = [body.envelope == other.envelope for other in situation.kinds]
                between[body.envelope] = cache.between(
                    routes,
                    routes.blocks(every),
                    np.array(targets, np.int64),
                    situation.costs[alike],
                )
        each = np.array([between[body.envelope] for body in situation.kinds])
        strips = 2.0 * np.maximum(situation.side_ranges(self._sensor_range), _SHORTEST_SIDE_RANGE)
        per_area = slowness * np.maximum(config.work_per_area, 1.0 / strips)
        return TourProblem(
            starts=situation.efforts[:, targets],
            between=each * slowness[:, None, None],
            work=per_area[:, None] * np.minimum(gains, _LARGEST_GAIN)[None],
            urgency=urgencies(gains, len(situation.vehicles), config.waiting_weight),
            longest_weight=config.longest_weight,
        )

    def _prior_tours(self, vehicles: tuple[str, ...], points: Array) -> list[list[int]]:
        """Return the tours of the last cycle in terms of the present stops (F, 2) m."""
        prior = []
        taken: set[int] = set()
        for name in vehicles:
            order: list[int] = []
            for stop in self._tours.get(name, ()):
                gaps = np.hypot(*(points - stop).T)
                nearest = int(np.argmin(gaps))
                if gaps[nearest] <= _SAME_STOP and nearest not in taken:
                    taken.add(nearest)
                    order.append(nearest)
            prior.append(order)
        return prior

    def _assign_idle(self, chosen: list[int], situation: Situation) -> list[int]:
        """Assign the remaining frontiers to vehicles without a tour, jointly."""
        idle = [i for i, target in enumerate(chosen) if target < 0]
        free = [j for j in range(len(situation.frontiers)) if j not in chosen]
        if not idle or not free:
            return chosen
        picks = assign_jointly(
            situation.efforts[np.ix_(idle, free)],
            situation.targets[free],
            situation.side_ranges(self._sensor_range)[idle],
            self._config.overlap_weight,
        )
        for vehicle, pick in zip(idle, picks, strict=True):
            if pick >= 0:
                chosen[vehicle] = free[pick]
        return chosen


def merge_frontiers(
    frontiers: list[Frontier], costs: Array, current: list[int], merge_distance: float
) -> list[Stop]:
    """Merge frontiers that lie together into stops, those near a vehicle first.

    costs (V, F) m; current (V,): frontiers that stay stops of their own. The farther a frontier is
    from every vehicle, the more coarsely it is merged, since it will be planned again on the way.
    Frontiers that no vehicle can reach are left out.
    """
    away = costs.min(axis=0)
    order = [int(i) for i in np.argsort(away, kind='stable') if np.isfinite(away[i])]
    order = [k for k in current if k >= 0 and np.isfinite(away[k])] + order
    points = np.array([frontier.target for frontier in frontiers])
    radius = np.maximum(merge_distance, _MERGE_FRACTION * away)
    stops: list[Stop] = []
    places = np.empty((len(frontiers), 2))  # of the stops
    for index in dict.fromkeys(order):
        if stops and index not in current:
            away_x, away_y = (places[: len(stops)] - points[index]).T
            gaps = np.hypot(away_x, away_y)
            nearest = int(np.argmin(gaps))
            if gaps[nearest] <= radius[index] or len(stops) >= _MAXIMUM_STOPS:
                stops[nearest].members.append(index)
                continue
        places[len(stops)] = points[index]
        stops.append(Stop(index, [index]))
    return stops


def urgencies(gains: Array, vehicles: int, waiting_weight: float) -> Array:
    """Return the cost of waiting per metre of travel for each stop (F,), by its gain.

    Together they make the weight of the mean travel until a stop is reached, once per vehicle.
    """
    weights = _URGENCY_FLOOR + np.minimum(gains, _URGENT_GAIN)
    urgency: Array = waiting_weight * vehicles * weights / weights.sum()
    return urgency


def defer_low_gain_stops(
    problem: TourProblem, gains: Array, fixed: NDArray[np.int64], gain_per_detour: ArrayLike
) -> TourProblem:
    """Return the problem without the stops that gain too little for their detour now.

    Of the shortest tours through all stops, the stop with the smallest gain per detour is dropped
    until every one gains at least gain_per_detour (m² per m; of all vehicles, or (V,)). Fixed
    stops stay. If none is left, the problem is returned as it is.
    """
    zero = np.zeros(len(gains))
    starts = problem.starts
    least = np.broadcast_to(np.asarray(gain_per_detour, np.float64), len(starts))
    every = np.broadcast_to(problem.between, (len(starts), len(gains), len(gains)))
    worth = np.ones(len(gains), np.bool_)
    shortest = plan_tours(problem._replace(work=zero, urgency=zero), fixed)
    for vehicle, order in enumerate(shortest.orders):
        between = every[vehicle]
        while order:
            steps = [starts[vehicle, order[0]]]
            steps += [between[a, b] for a, b in itertools.pairwise(order)]
            rates = []
            for at, stop in enumerate(order):
                detour = steps[at]
                if at + 1 < len(order):
                    direct = between[order[at - 1]] if at else starts[vehicle]
                    detour += steps[at + 1] - direct[order[at + 1]]
                rates.append(gains[stop] / max(detour, _MINIMUM_DETOUR))
            worst = int(np.argmin(rates))
            if rates[worst] >= least[vehicle] or order[worst] in fixed:
                break
            worth[order.pop(worst)] = False
    if not worth.any():
        return problem
    return problem._replace(starts=np.where(worth[None], starts, np.inf))


def improve_or_replace(
    problem: TourProblem, fixed: NDArray[np.int64], prior: list[list[int]], margin: float
) -> Tours:
    """Return the prior tours, improved, or new ones that are cheaper by more than the margin (m).

    fixed (V,): present target of each vehicle, or -1; only new tours may begin elsewhere.
    """
    improved = plan_tours(problem, fixed, prior)
    new = plan_tours(problem, np.full_like(fixed, -1))
    return new if new.cost < improved.cost - margin else improved


DEFAULT = StrategyKind(DefaultStrategy)
