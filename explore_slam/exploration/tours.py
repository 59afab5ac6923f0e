"""Tours of a team through all targets: who takes what, in which order.

The cost of a tour is its travel (m) plus the work expected at its targets, and the weighted sum
of what every target has to wait for. The team pays for all tours and again for the longest one,
so that work is shared evenly; waiting draws the near targets to the front, so that nothing is left
behind to come back for (as in the problem of the traveling repairmen). Cheapest insertion makes
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
    urgency: Array,
    bonus: Array,
    fixed: NDArray[np.int64],
    longest_weight: float,
    prior: list[list[int]] | None = None,
) -> Tours:
    """Return tours for the team.

    starts (V, F): travel from each vehicle to each target; between (F, F): among targets; work
    (F,) m; urgency (F,): paid per metre until a target is reached; bonus (F,) m: saved where a
    tour ends; fixed (V,): the target a
    vehicle has to visit first, or -1. Targets that a vehicle cannot reach (inf) are taken by
    others, if any can. prior: the tours to begin with; they are only improved upon.
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
    used = {int(target) for target in once if target >= 0}
    for vehicle, order in enumerate(prior or []):
        head = [int(once[vehicle])] if once[vehicle] >= 0 else []
        rest = [t for t in order if t not in used and np.isfinite(starts[vehicle, t])]
        used.update(rest)
        lengths[vehicle] = len(head + rest)
        orders[vehicle, : lengths[vehicle]] = head + rest
    cost = _make_tours(first, pairs, work, urgency, bonus, once, longest_weight, orders, lengths)
    result = []
    for vehicle in range(vehicles):
        order = orders[vehicle, : lengths[vehicle]].tolist()
        result.append([t for t in order if np.isfinite(starts[vehicle, t])])
    return Tours(result, float(cost))


@kernel
def _tour_cost(
    order: NDArray[np.int64],
    length: int,
    first: Array,
    pairs: Array,
    work: Array,
    urgency: Array,
    bonus: Array,
) -> tuple[float, float]:
    """Return the length of a tour with its work, and what waiting costs along it."""
    total, waiting = 0.0, 0.0
    for i in range(length):
        total += first[order[0]] if i == 0 else pairs[order[i - 1], order[i]]
        waiting += urgency[order[i]] * total
        total += work[order[i]]
    if length > 0:
        total -= bonus[order[length - 1]]
    return total, waiting


@kernel
def _team_cost(costs: Array, longest_weight: float) -> float:
    """Return what the team pays; costs (V, 2): length and waiting of each tour."""
    return float(costs.sum() + longest_weight * costs[:, 0].max())


@kernel
def _best_insertion(
    target: int,
    first: Array,
    pairs: Array,
    work: Array,
    urgency: Array,
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
        order, length = orders[vehicle], lengths[vehicle]
        behind = 0.0  # urgency of the targets from the position on
        for i in range(length):
            behind += urgency[order[i]]
        departure = 0.0
        for at in range(length + 1):
            way = first[vehicle, target] if at == 0 else pairs[order[at - 1], target]
            direct = 0.0
            extra = way + work[target]
            if at < length:
                direct = first[vehicle, order[0]] if at == 0 else pairs[order[at - 1], order[at]]
                extra += pairs[target, order[at]] - direct
            if at >= heads[vehicle]:
                waits = urgency[target] * (departure + way) + extra * behind
                if at == length:
                    extra -= bonus[target] - (bonus[order[length - 1]] if length > 0 else 0.0)
                trial[vehicle, 0] = costs[vehicle, 0] + extra
                trial[vehicle, 1] = costs[vehicle, 1] + waits
                total = _team_cost(trial, longest_weight)
                if total < best:
                    best, best_vehicle, best_at = total, vehicle, at
            if at < length:
                departure += direct + work[order[at]]
                behind -= urgency[order[at]]
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
    urgency: Array,
    bonus: Array,
    longest_weight: float,
    costs: Array,
) -> bool:
    """Reverse stretches of tours while that makes the team pay less (2-opt)."""
    changed = False
    trial = costs.copy()
    for vehicle in range(lengths.size):
        order, length = orders[vehicle], lengths[vehicle]
        paid = _team_cost(costs, longest_weight)
        for i in range(heads[vehicle], length - 1):
            for j in range(i + 1, length):
                order[i : j + 1] = order[i : j + 1][::-1].copy()
                trial[vehicle] = _tour_cost(
                    order, length, first[vehicle], pairs, work, urgency, bonus
                )
                cost = _team_cost(trial, longest_weight)
                if cost < paid - 1e-6:
                    costs[vehicle], paid, changed = trial[vehicle], cost, True
                else:
                    order[i : j + 1] = order[i : j + 1][::-1].copy()
        trial[vehicle] = costs[vehicle]
    return changed


@kernel
def _make_tours(
    first: Array,
    pairs: Array,
    work: Array,
    urgency: Array,
    bonus: Array,
    fixed: NDArray[np.int64],
    longest_weight: float,
    orders: NDArray[np.int64],
    lengths: NDArray[np.int64],
) -> float:
    vehicles = first.shape[0]
    heads = np.zeros(vehicles, np.int64)
    costs = np.zeros((vehicles, 2))
    for vehicle in range(vehicles):
        if fixed[vehicle] >= 0:
            heads[vehicle] = 1
            orders[vehicle, 0], lengths[vehicle] = fixed[vehicle], max(1, lengths[vehicle])
        costs[vehicle] = _tour_cost(
            orders[vehicle], lengths[vehicle], first[vehicle], pairs, work, urgency, bonus
        )
    _insert_all(first, pairs, work, urgency, bonus, heads, longest_weight, orders, lengths, costs)
    for _ in range(ROUNDS):
        reversed_any = _reverse_stretches(
            orders, lengths, heads, first, pairs, work, urgency, bonus, longest_weight, costs
        )
        moved_any = _move_targets(
            first, pairs, work, urgency, bonus, heads, longest_weight, orders, lengths, costs
        )
        if not (reversed_any or moved_any):
            break
    return _team_cost(costs, longest_weight)


@kernel
def _insert_all(
    first: Array,
    pairs: Array,
    work: Array,
    urgency: Array,
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
                    urgency,
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
            orders[best_vehicle],
            lengths[best_vehicle],
            first[best_vehicle],
            pairs,
            work,
            urgency,
            bonus,
        )
        waiting[best_target] = False


@kernel
def _move_targets(
    first: Array,
    pairs: Array,
    work: Array,
    urgency: Array,
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
            before, kept = _team_cost(costs, longest_weight), costs[vehicle].copy()
            target = orders[vehicle, at]
            _remove(orders[vehicle], lengths[vehicle], at)
            lengths[vehicle] -= 1
            costs[vehicle] = _tour_cost(
                orders[vehicle], lengths[vehicle], first[vehicle], pairs, work, urgency, bonus
            )
            total, other, where = _best_insertion(
                target,
                first,
                pairs,
                work,
                urgency,
                bonus,
                heads,
                longest_weight,
                orders,
                lengths,
                costs,
            )
            better = total < before - 1e-6
            if not better:
                other, where = vehicle, at
            _insert(orders[other], lengths[other], where, target)
            lengths[other] += 1
            if better:
                costs[other] = _tour_cost(
                    orders[other], lengths[other], first[other], pairs, work, urgency, bonus
                )
            else:
                costs[vehicle] = kept
            changed = changed or better
            at += 1
    return changed
