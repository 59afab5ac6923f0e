"""Tours of a team through all targets: who takes what, in which order.

The cost of a tour is its travel (m), plus the work expected at its targets, less a bonus for
ending where most is left to see (that is where the next targets will come up). The team pays for
all tours and again for the longest one, so that work is shared evenly. Cheapest insertion makes
the tours, moves of single targets and reversals of stretches improve them.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.geometry import Array

ROUNDS = 60
UNREACHABLE = 1e6


class Tours(NamedTuple):
    """Targets of each vehicle in order, and what the team pays (m)."""

    orders: list[list[int]]
    cost: float


def plan_tours(
    starts: Array,
    between: Array,
    work: Array,
    bonus: Array,
    fixed: NDArray[np.int64],
    longest_weight: float,
) -> Tours:
    """Return tours for the team.

    starts (V, F): travel from each vehicle to each target; between (F, F): among targets; work
    (F,) and bonus (F,) m; fixed (V,): the target a vehicle has to visit first, or -1. Targets that
    a vehicle cannot reach (inf) are taken by others, if any can.
    """
    vehicles, count = starts.shape
    orders = np.full((vehicles, count), -1, np.int64)
    lengths = np.zeros(vehicles, np.int64)
    once = fixed.copy()
    for vehicle in range(vehicles):
        if fixed[vehicle] in fixed[:vehicle]:
            once[vehicle] = -1  # two cannot go there first
    first = np.ascontiguousarray(np.where(np.isfinite(starts), starts, UNREACHABLE))
    pairs = np.ascontiguousarray(np.where(np.isfinite(between), between, UNREACHABLE))
    cost = _make_tours(first, pairs, work, bonus, once, longest_weight, orders, lengths)
    result = []
    for vehicle in range(vehicles):
        order = orders[vehicle, : lengths[vehicle]].tolist()
        result.append([t for t in order if np.isfinite(starts[vehicle, t])])
    return Tours(result, float(cost))


@kernel
def _tour_cost(
    order: NDArray[np.int64], length: int, first: Array, pairs: Array, work: Array, bonus: Array
) -> float:
    if length == 0:
        return 0.0
    cost = first[order[0]] + work[order[0]]
    for i in range(1, length):
        cost += pairs[order[i - 1], order[i]] + work[order[i]]
    return float(cost - bonus[order[length - 1]])


@kernel
def _team_cost(costs: Array, longest_weight: float) -> float:
    return float(costs.sum() + longest_weight * costs.max())


@kernel
def _insertion(
    order: NDArray[np.int64],
    length: int,
    at: int,
    target: int,
    first: Array,
    pairs: Array,
    work: Array,
    bonus: Array,
) -> float:
    """Return by how much a tour gets dearer when a target is inserted at a position."""
    gain = first[target] if at == 0 else pairs[order[at - 1], target]
    gain += work[target]
    if at < length:
        gain += pairs[target, order[at]]
        gain -= first[order[at]] if at == 0 else pairs[order[at - 1], order[at]]
    else:
        gain -= bonus[target]
        if length > 0:
            gain += bonus[order[length - 1]]
    return float(gain)


@kernel
def _best_insertion(
    target: int,
    first: Array,
    pairs: Array,
    work: Array,
    bonus: Array,
    heads: NDArray[np.int64],
    longest_weight: float,
    orders: NDArray[np.int64],
    lengths: NDArray[np.int64],
    costs: Array,
) -> tuple[float, int, int]:
    """Return cost of the team, vehicle and position of the cheapest insertion of a target."""
    best, best_vehicle, best_at = np.inf, -1, -1
    trial = costs.copy()
    for vehicle in range(lengths.size):
        if first[vehicle, target] >= UNREACHABLE:
            continue
        for at in range(heads[vehicle], lengths[vehicle] + 1):
            extra = _insertion(
                orders[vehicle], lengths[vehicle], at, target, first[vehicle], pairs, work, bonus
            )
            trial[vehicle] = costs[vehicle] + extra
            total = _team_cost(trial, longest_weight)
            if total < best:
                best, best_vehicle, best_at = total, vehicle, at
        trial[vehicle] = costs[vehicle]
    return best, best_vehicle, best_at


@kernel
def _insert(order: NDArray[np.int64], length: int, at: int, target: int) -> None:
    for i in range(length, at, -1):
        order[i] = order[i - 1]
    order[at] = target


@kernel
def _remove(order: NDArray[np.int64], length: int, at: int) -> None:
    for i in range(at, length - 1):
        order[i] = order[i + 1]
    order[length - 1] = -1


@kernel
def _reverse_stretches(
    orders: NDArray[np.int64],
    lengths: NDArray[np.int64],
    heads: NDArray[np.int64],
    first: Array,
    pairs: Array,
    work: Array,
    bonus: Array,
    costs: Array,
) -> bool:
    """Reverse stretches of tours while that makes a tour cheaper (2-opt)."""
    changed = False
    for vehicle in range(lengths.size):
        order, length = orders[vehicle], lengths[vehicle]
        for i in range(heads[vehicle], length - 1):
            for j in range(i + 1, length):
                order[i : j + 1] = order[i : j + 1][::-1].copy()
                cost = _tour_cost(order, length, first[vehicle], pairs, work, bonus)
                if cost < costs[vehicle] - 1e-6:
                    costs[vehicle] = cost
                    changed = True
                else:
                    order[i : j + 1] = order[i : j + 1][::-1].copy()
    return changed


@kernel
def _make_tours(
    first: Array,
    pairs: Array,
    work: Array,
    bonus: Array,
    fixed: NDArray[np.int64],
    longest_weight: float,
    orders: NDArray[np.int64],
    lengths: NDArray[np.int64],
) -> float:
    vehicles = first.shape[0]
    heads = np.zeros(vehicles, np.int64)
    costs = np.zeros(vehicles)
    for vehicle in range(vehicles):
        if fixed[vehicle] >= 0:
            orders[vehicle, 0], lengths[vehicle], heads[vehicle] = fixed[vehicle], 1, 1
            costs[vehicle] = _tour_cost(orders[vehicle], 1, first[vehicle], pairs, work, bonus)
    _insert_all(first, pairs, work, bonus, heads, longest_weight, orders, lengths, costs)
    for _ in range(ROUNDS):
        reversed_any = _reverse_stretches(orders, lengths, heads, first, pairs, work, bonus, costs)
        moved_any = _move_targets(
            first, pairs, work, bonus, heads, longest_weight, orders, lengths, costs
        )
        if not (reversed_any or moved_any):
            break
    return _team_cost(costs, longest_weight)


@kernel
def _insert_all(
    first: Array,
    pairs: Array,
    work: Array,
    bonus: Array,
    heads: NDArray[np.int64],
    longest_weight: float,
    orders: NDArray[np.int64],
    lengths: NDArray[np.int64],
    costs: Array,
) -> None:
    """Insert all targets that are in no tour yet, each time the one that is cheapest to add."""
    vehicles, count = first.shape
    waiting = np.ones(count, np.bool_)
    for vehicle in range(vehicles):
        for at in range(lengths[vehicle]):
            waiting[orders[vehicle, at]] = False
    for _ in range(count):
        best, best_target, best_vehicle, best_at = np.inf, -1, -1, -1
        for target in range(count):
            if waiting[target]:
                total, vehicle, at = _best_insertion(
                    target,
                    first,
                    pairs,
                    work,
                    bonus,
                    heads,
                    longest_weight,
                    orders,
                    lengths,
                    costs,
                )
                if total < best:
                    best, best_target, best_vehicle, best_at = total, target, vehicle, at
        if best_target < 0:
            break
        _insert(orders[best_vehicle], lengths[best_vehicle], best_at, best_target)
        lengths[best_vehicle] += 1
        costs[best_vehicle] = _tour_cost(
            orders[best_vehicle], lengths[best_vehicle], first[best_vehicle], pairs, work, bonus
        )
        waiting[best_target] = False


@kernel
def _move_targets(
    first: Array,
    pairs: Array,
    work: Array,
    bonus: Array,
    heads: NDArray[np.int64],
    longest_weight: float,
    orders: NDArray[np.int64],
    lengths: NDArray[np.int64],
    costs: Array,
) -> bool:
    """Move each target once to where the team pays least for it."""
    changed = False
    for vehicle in range(lengths.size):
        at = heads[vehicle]
        while at < lengths[vehicle]:
            before, kept = _team_cost(costs, longest_weight), costs[vehicle]
            target = orders[vehicle, at]
            _remove(orders[vehicle], lengths[vehicle], at)
            lengths[vehicle] -= 1
            costs[vehicle] = _tour_cost(
                orders[vehicle], lengths[vehicle], first[vehicle], pairs, work, bonus
            )
            total, other, where = _best_insertion(
                target, first, pairs, work, bonus, heads, longest_weight, orders, lengths, costs
            )
            better = total < before - 1e-6
            if not better:
                other, where = vehicle, at
            _insert(orders[other], lengths[other], where, target)
            lengths[other] += 1
            costs[other] = _tour_cost(
                orders[other], lengths[other], first[other], pairs, work, bonus
            )
            if not better:
                costs[vehicle] = kept
            changed = changed or better
            at += 1
    return changed
