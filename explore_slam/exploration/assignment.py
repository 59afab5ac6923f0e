"""Utility of targets (equations 8 and 9 of the paper) and assignment to vehicles (section V-C).

The greedy assignment is that of W. Burgard et al., "Coordinated multi-robot exploration", IEEE
Transactions on Robotics 21(3), 2005.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linear_sum_assignment

from explore_slam.errors import ExplorationError
from explore_slam.geometry import Array

_MAXIMUM_ROUNDS = 20  # of local improvement; a bound that is hardly ever reached
_UNREACHABLE = 1e6  # m; cost in place of infinity, and of a vehicle without a target
_IMPROVEMENT = 1e-9  # m; smaller improvements are rounding


def coverage_probability(distance: ArrayLike, max_range: ArrayLike) -> Array:
    """Return P(d) = 1 - d / max_range below max_range, else 0 (equation 9)."""
    d = np.asarray(distance, np.float64)
    return np.clip(1.0 - d / np.asarray(max_range, np.float64), 0.0, None)


def utilities(targets: ArrayLike, taken: ArrayLike, max_range: ArrayLike) -> Array:
    """Return U (F,) of targets (F, 2) m, given targets (T, 2) m already taken (equation 8).

    max_range: of all vehicles, or (T,) of those that have taken the targets (m).
    """
    points = np.asarray(targets, np.float64).reshape(-1, 2)
    others = np.asarray(taken, np.float64).reshape(-1, 2)
    distances = np.linalg.norm(points[:, None] - others[None], axis=2)
    return 1.0 - coverage_probability(distances, max_range).sum(axis=1)


def assign_targets(
    costs: ArrayLike,
    targets: ArrayLike,
    max_range: ArrayLike,
    travel_weight: float = 1.0,
) -> list[int]:
    """Return the target of each vehicle, -1 for none, by the greedy method of the paper.

    costs (V, F): inf if unreachable. targets (F, 2) m. max_range: of all, or (V,) of each (m).
    The pair with the largest U - travel_weight * V is assigned and the utilities of the other
    targets are lowered, until vehicles or targets run out.
    """
    matrix, points = _checked(costs, targets)
    ranges = np.broadcast_to(np.asarray(max_range, np.float64), len(matrix))
    chosen = [-1] * len(matrix)
    taken: list[int] = []
    takers: list[int] = []
    for _ in range(min(matrix.shape)):
        utility = utilities(points, points[taken], ranges[takers])
        scores = utility[None] - travel_weight * matrix
        scores[[i for i, target in enumerate(chosen) if target >= 0]] = -np.inf
        scores[:, taken] = -np.inf
        best = int(np.argmax(scores))
        vehicle, target = divmod(best, matrix.shape[1])
        if scores[vehicle, target] == -np.inf:
            break
        chosen[vehicle] = target
        taken.append(target)
        takers.append(vehicle)
    return chosen


def _checked(costs: ArrayLike, targets: ArrayLike) -> tuple[Array, Array]:
    """Return costs (V, F) and targets (F, 2); ExplorationError if they do not fit."""
    matrix, points = np.array(costs, np.float64), np.asarray(targets, np.float64).reshape(-1, 2)
    if matrix.ndim != 2 or matrix.shape[1] != len(points) or np.isnan(matrix).any():
        raise ExplorationError(
            f'costs have shape {matrix.shape} or hold NaN, expected (vehicles, {len(points)})'
        )
    return matrix, points


def assign_nearest(costs: ArrayLike) -> list[int]:
    """Return the cheapest target of each vehicle, whatever the others do; -1 for none."""
    matrix = np.asarray(costs, np.float64)
    if matrix.shape[1] == 0:
        return [-1] * len(matrix)
    best = matrix.argmin(axis=1)
    return [int(j) if np.isfinite(matrix[i, j]) else -1 for i, j in enumerate(best)]


def assign_random(costs: ArrayLike, generator: np.random.Generator) -> list[int]:
    """Return a reachable target of each vehicle, drawn uniformly; -1 for none."""
    chosen = []
    for row in np.asarray(costs, np.float64):
        reachable = np.flatnonzero(np.isfinite(row))
        chosen.append(int(generator.choice(reachable)) if reachable.size else -1)
    return chosen


def assign_jointly(
    costs: ArrayLike, targets: ArrayLike, max_range: ArrayLike, overlap_weight: float
) -> list[int]:
    """Return the target of each vehicle, -1 for none, with least travel and overlap of the team.

    The cost of the team is the sum of costs (V, F) m, plus overlap_weight times the coverage
    probability (equation 9) between every two targets, the mean of those of the two vehicles.
    max_range: of all vehicles, or (V,) of each (m). From the assignment of the Hungarian method
    (Kuhn, 1955) and from the greedy one, single vehicles change targets as long as the cost falls;
    the cheaper result is returned.
    """
    matrix, points = _checked(costs, targets)
    if 0 in matrix.shape:
        return [-1] * len(matrix)
    blocked = ~np.isfinite(matrix)
    filled = np.where(blocked, _UNREACHABLE, matrix)
    ranges = np.broadcast_to(np.asarray(max_range, np.float64), len(matrix))
    distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    overlap = overlap_weight * coverage_probability(distances[None], ranges[:, None, None])
    hungarian = np.full(len(matrix), -1, np.int64)
    vehicles, picked = linear_sum_assignment(filled)
    hungarian[vehicles] = np.where(blocked[vehicles, picked], -1, picked)
    weight = 1.0 / max(overlap_weight, 1e-9)
    greedy = np.array(assign_targets(matrix, points, max_range, weight), np.int64)
    results: list[tuple[float, list[int]]] = []
    for chosen in (hungarian, greedy):
        for _ in range(_MAXIMUM_ROUNDS):
            if not _improve(chosen, filled, overlap):
                break
        results.append((_team_cost(chosen, filled, overlap), chosen.tolist()))
    return min(results)[1]


def _team_cost(chosen: NDArray[np.int64], costs: Array, overlap: Array) -> float:
    """Return the cost of the team; a vehicle without a target costs as an unreachable one.

    overlap (V, F, F): of two targets, as each vehicle would cover them.
    """
    given = np.flatnonzero(chosen >= 0)
    targets = chosen[given]
    pairs = overlap[given[:, None], targets[:, None], targets[None]]
    shared = (pairs.sum() - np.trace(pairs)) / 2.0
    idle = (len(chosen) - len(given)) * _UNREACHABLE
    return float(costs[given, targets].sum() + shared + idle)


def _improve(chosen: NDArray[np.int64], costs: Array, overlap: Array) -> bool:
    """Reassign one vehicle at a time to the free target that is cheapest given the others.

    chosen (V,) is changed in place; return whether it was.
    """
    changed = False
    for vehicle in range(len(chosen)):
        if chosen[vehicle] < 0:
            continue
        others = [i for i, t in enumerate(chosen) if i != vehicle and t >= 0]
        theirs = chosen[others]
        shared = 0.5 * (overlap[vehicle][:, theirs] + overlap[others, :, theirs].T)
        total = costs[vehicle] + shared.sum(axis=1)
        total[theirs] = np.inf
        best = int(np.argmin(total))
        if total[best] < total[chosen[vehicle]] - _IMPROVEMENT:
            chosen[vehicle] = best
            changed = True
    return changed
