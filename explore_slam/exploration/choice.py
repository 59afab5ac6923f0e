"""Which vehicle goes to which frontier, by the strategy that is set."""

import itertools

import numpy as np
from numpy.typing import NDArray

from explore_slam.exploration.assignment import (
    assign_jointly,
    assign_nearest,
    assign_random,
    assign_targets,
)
from explore_slam.exploration.config import ExplorationConfig
from explore_slam.exploration.records import Frontier
from explore_slam.exploration.routes import RouteCache
from explore_slam.exploration.scene import Scene
from explore_slam.exploration.tours import Tours, plan_tours
from explore_slam.geometry import Array

SAME_NODE = 2.0  # m: a stop of a tour that moved by no more is the same one
MERGE_SHARE = 0.15  # of its distance: so near to each other far frontiers are one stop


class Chooser:
    """Chooses targets; keeps its random generator and the distances between targets."""

    def __init__(self, config: ExplorationConfig) -> None:
        self.config = config
        self._random = np.random.default_rng(config.assignment.exploration_seed)
        self._cache = RouteCache()
        self._tours: dict[str, Array] = {}

    def choose(
        self,
        scene: Scene,
        frontiers: list[Frontier],
        costs: Array,
        kept: list[int],
        changes: list[int],
    ) -> list[int]:
        """Return for each vehicle the index of its frontier, -1 for none.

        costs (V, F) m; kept holds for each vehicle the frontier it is on the way to, or -1;
        changes how often it has changed its mind since it last got anywhere: the more, the better
        another target has to be, so that goals cannot go on flipping.
        """
        config = self.config.assignment
        targets = np.array([f.target for f in frontiers])
        sensor = self.config.frontiers.sensor_range
        if config.strategy == 'random':
            drawn = assign_random(costs, self._random)
            return [k if k >= 0 else d for k, d in zip(kept, drawn, strict=True)]
        if config.strategy == 'default':
            margin = config.tour_hysteresis * 2.0 ** max(changes, default=0)
            return self._by_tours(scene, frontiers, costs, kept, margin)
        biased = costs.copy()
        for i, target in enumerate(kept):
            if target >= 0:
                biased[i, target] -= config.hysteresis * 2.0 ** changes[i]
        if config.strategy == 'nearest':
            return assign_nearest(biased)
        return assign_targets(biased, targets, sensor, config.travel_weight)

    def _by_tours(
        self,
        scene: Scene,
        frontiers: list[Frontier],
        costs: Array,
        kept: list[int],
        margin: float,
    ) -> list[int]:
        """Plan tours of the whole team and take the first target of each.

        Vehicles go on to the targets they have unless all tours together get shorter by more than
        the margin (m).
        """
        config = self.config.assignment
        gains = np.array([f.gain for f in frontiers])
        members, groups = self._nodes(frontiers, costs, kept)
        cells = np.array([frontiers[i].target_cell for i in members])
        routes = scene.routes()
        between = self._cache.between(routes, routes.blocks(cells))
        node_gains = np.array([gains[group].sum() for group in groups])
        work = config.work_per_area * np.minimum(node_gains, config.largest_gain)
        bonus = config.last_bonus * np.minimum(node_gains, config.largest_gain)
        urgency = self._urgency(node_gains, len(costs))
        starts = costs[:, members]
        fixed = np.array([members.index(k) if k in members else -1 for k in kept], np.int64)
        worth = self._worth_their_detour(starts, between, node_gains, fixed)
        starts = np.where(worth[None], starts, np.inf)
        points = np.array([frontiers[i].target for i in members])
        prior = self._prior(tuple(scene.starts), points)
        tours = self._solve(starts, between, work, urgency, bonus, fixed, prior, margin)
        self._tours = {
            name: points[order] for name, order in zip(scene.starts, tours.orders, strict=True)
        }
        chosen = [members[order[0]] if order else -1 for order in tours.orders]
        return self._employ_idle(chosen, frontiers, costs)

    def _urgency(self, gains: Array, vehicles: int) -> Array:
        """Return what waiting for each node (F,) costs per metre, shared out by what they gain."""
        config = self.config.assignment
        weights = config.urgency_floor + np.minimum(gains, config.urgent_gain)
        share: Array = config.waiting_weight * vehicles * weights / weights.sum()
        return share

    def _worth_their_detour(
        self, starts: Array, between: Array, gains: Array, fixed: NDArray[np.int64]
    ) -> NDArray[np.bool_]:
        """Return the nodes (F,) to be visited now: others gain too little for the way they take.

        Of tours through all nodes the least worthwhile node is dropped, again and again, until
        every node gains at least `gain_per_detour`. Where none is left, all are visited.
        """
        rate = self.config.assignment.gain_per_detour
        zero = np.zeros(len(gains))
        worth = np.ones(len(gains), np.bool_)
        weight = self.config.assignment.longest_weight
        tours = plan_tours(starts, between, zero, zero, zero, fixed, weight)
        for vehicle, order in enumerate(tours.orders):
            while order:
                steps = [starts[vehicle, order[0]]]
                steps += [between[a, b] for a, b in itertools.pairwise(order)]
                rates = []
                for at, node in enumerate(order):
                    detour = steps[at]
                    if at + 1 < len(order):
                        direct = between[order[at - 1]] if at else starts[vehicle]
                        detour += steps[at + 1] - direct[order[at + 1]]
                    rates.append(gains[node] / max(detour, 0.1))
                worst = int(np.argmin(rates))
                if rates[worst] >= rate or order[worst] in fixed:
                    break
                worth[order.pop(worst)] = False
        return worth if worth.any() else np.ones(len(gains), np.bool_)

    def _solve(
        self,
        starts: Array,
        between: Array,
        work: Array,
        urgency: Array,
        bonus: Array,
        fixed: NDArray[np.int64],
        prior: list[list[int]],
        margin: float,
    ) -> Tours:
        """Return the tours of the cycle before, improved, or others if these are much better."""
        weight = self.config.assignment.longest_weight
        free = np.full_like(fixed, -1)
        kept = plan_tours(starts, between, work, urgency, bonus, fixed, weight, prior)
        anew = plan_tours(starts, between, work, urgency, bonus, free, weight)
        return anew if anew.cost < kept.cost - margin else kept

    def _prior(self, names: tuple[str, ...], points: Array) -> list[list[int]]:
        """Return the tours of the cycle before in terms of the nodes (F, 2) m there are now."""
        prior = []
        taken: set[int] = set()
        for name in names:
            order: list[int] = []
            for place in self._tours.get(name, ()):
                gaps = np.hypot(*(points - place).T)
                nearest = int(np.argmin(gaps))
                if gaps[nearest] <= SAME_NODE and nearest not in taken:
                    taken.add(nearest)
                    order.append(nearest)
            prior.append(order)
        return prior

    def _nodes(
        self, frontiers: list[Frontier], costs: Array, kept: list[int]
    ) -> tuple[list[int], list[list[int]]]:
        """Merge frontiers that lie together into nodes: the one to go to, and all of its group.

        Nearest first; what is far from every vehicle is merged more coarsely, since the way there
        will be planned again.
        """
        config = self.config.assignment
        away = costs.min(axis=0)
        order = [int(i) for i in np.argsort(away, kind='stable') if np.isfinite(away[i])]
        order = [k for k in dict.fromkeys(kept) if k >= 0 and np.isfinite(away[k])] + order
        points = np.array([f.target for f in frontiers])
        radius = np.maximum(config.merge_distance, MERGE_SHARE * away)
        members: list[int] = []
        groups: list[list[int]] = []
        seen: set[int] = set()
        for index in order:
            if index in seen:
                continue
            seen.add(index)
            if members and index not in kept:
                gaps = np.hypot(*(points[members] - points[index]).T)
                nearest = int(np.argmin(gaps))
                if gaps[nearest] <= radius[index] or len(members) >= config.most_nodes:
                    groups[nearest].append(index)
                    continue
            members.append(index)
            groups.append([index])
        return members, groups

    def _employ_idle(
        self, chosen: list[int], frontiers: list[Frontier], costs: Array
    ) -> list[int]:
        """Send vehicles without a tour along to where most is left to see."""
        idle = [i for i, target in enumerate(chosen) if target < 0]
        if not idle:
            return chosen
        config = self.config
        targets = np.array([f.target for f in frontiers])
        weight = config.assignment.overlap_weight
        taken = [t for t in chosen if t >= 0]
        free = [j for j in range(len(frontiers)) if j not in taken]
        if not free:
            return chosen
        picks = assign_jointly(
            costs[np.ix_(idle, free)], targets[free], config.frontiers.sensor_range, weight
        )
        for vehicle, pick in zip(idle, picks, strict=True):
            if pick >= 0:
                chosen[vehicle] = free[pick]
        return chosen
