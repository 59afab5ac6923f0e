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


class _Problem(NamedTuple):
    """What tours are made of, as in plan_tours; of each vehicle (V,) heads targets stay first."""

    first: Array
    pairs: Array
    work: Array
    urgency: Array
    bonus: Array
    heads: NDArray[np.int64]
    longest_weight: float


class _Draft(NamedTuple):
    """Tours in the making: orders (V, F), lengths (V,), costs (V, 2) of length and waiting."""

    orders: NDArray[np.int64]
    lengths: NDArray[np.int64]
    costs: Array


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
    tour ends; fixed (V,): the target a vehicle has to visit first, or -1. Targets that a vehicle
    cannot reach (inf) are taken by others, if any can. prior: the tours to begin with; they are
    only improved upon.
    """
    vehicles, count = starts.shape
    once = fixed.copy()
    for vehicle in range(vehicles):
        if fixed[vehicle] in fixed[:vehicle]:
            once[vehicle] = -1  # two cannot go there first
    first = np.ascontiguousarray(np.where(np.isfinite(starts), starts, UNREACHABLE))
    pairs = np.ascontiguousarray(np.where(np.isfinite(between), between, UNREACHABLE))
    heads = (once >= 0).astype(np.int64)
    orders = np.full((vehicles, count), -1, np.int64)
    lengths = np.zeros(vehicles, np.int64)
    used = {int(target) for target in once if target >= 0}
    for vehicle, order in enumerate(prior or [[]] * vehicles):
        head = [int(once[vehicle])] if once[vehicle] >= 0 else []
        rest = [t for t in order if t not in used and np.isfinite(starts[vehicle, t])]
        used.update(rest)
        lengths[vehicle] = len(head + rest)
        orders[vehicle, : lengths[vehicle]] = head + rest
    problem = _Problem(first, pairs, work, urgency, bonus, heads, longest_weight)
    cost = _make_tours(problem, _Draft(orders, lengths, np.zeros((vehicles, 2))))
    result = []
    for vehicle in range(vehicles):
        order = orders[vehicle, : lengths[vehicle]].tolist()
        result.append([t for t in order if np.isfinite(starts[vehicle, t])])
    return Tours(result, float(cost))


@kernel
def _update_cost(problem: _Problem, draft: _Draft, vehicle: int) -> None:
    """Set the length of a tour with its work, and what waiting costs along it."""
    order, length = draft.orders[vehicle], draft.lengths[vehicle]
    total, waiting = 0.0, 0.0
    for i in range(length):
        total += (
            problem.first[vehicle, order[0]] if i == 0 else problem.pairs[order[i - 1], order[i]]
        )
        waiting += problem.urgency[order[i]] * total
        total += problem.work[order[i]]
    if length > 0:
        total -= problem.bonus[order[length - 1]]
    draft.costs[vehicle, 0], draft.costs[vehicle, 1] = total, waiting


@kernel
def _team_cost(costs: Array, longest_weight: float) -> float:
    """Return what the team pays; costs (V, 2): length and waiting of each tour."""
    return float(costs.sum() + longest_weight * costs[:, 0].max())


@kernel
def _best_insertion(problem: _Problem, draft: _Draft, target: int) -> tuple[float, int, int]:
    """Return cost of the team, vehicle and position of the cheapest insertion of a target."""
    first, pairs, work, urgency, bonus, heads, longest_weight = problem
    orders, lengths, costs = draft
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
def _reverse_stretches(problem: _Problem, draft: _Draft) -> bool:
    """Reverse stretches of tours while that makes the team pay less (2-opt)."""
    changed = False
    for vehicle in range(draft.lengths.size):
        order, length = draft.orders[vehicle], draft.lengths[vehicle]
        paid = _team_cost(draft.costs, problem.longest_weight)
        for i in range(problem.heads[vehicle], length - 1):
            for j in range(i + 1, length):
                before = draft.costs[vehicle].copy()
                order[i : j + 1] = order[i : j + 1][::-1].copy()
                _update_cost(problem, draft, vehicle)
                cost = _team_cost(draft.costs, problem.longest_weight)
                if cost < paid - 1e-6:
                    paid, changed = cost, True
                else:
                    order[i : j + 1] = order[i : j + 1][::-1].copy()
                    draft.costs[vehicle] = before
    return changed


@kernel
def _make_tours(problem: _Problem, draft: _Draft) -> float:
    """Complete and improve tours in place; return what the team pays."""
    for vehicle in range(draft.lengths.size):
        _update_cost(problem, draft, vehicle)
    _insert_all(problem, draft)
    for _ in range(ROUNDS):
        reversed_any = _reverse_stretches(problem, draft)
        moved_any = _move_targets(problem, draft)
        if not (reversed_any or moved_any):
            break
    return _team_cost(draft.costs, problem.longest_weight)


@kernel
def _insert_at(problem: _Problem, draft: _Draft, target: int, vehicle: int, at: int) -> None:
    _insert(draft.orders[vehicle], draft.lengths[vehicle], at, target)
    draft.lengths[vehicle] += 1
    _update_cost(problem, draft, vehicle)


@kernel
def _insert_all(problem: _Problem, draft: _Draft) -> None:
    """Insert all targets that are in no tour yet, each time the one that is cheapest to add."""
    count = problem.work.size
    waiting = np.ones(count, np.bool_)
    for vehicle in range(draft.lengths.size):
        for at in range(draft.lengths[vehicle]):
            waiting[draft.orders[vehicle, at]] = False
    for _ in range(count):
        best, best_target, best_vehicle, best_at = np.inf, -1, -1, -1
        for target in range(count):
            if waiting[target]:
                total, vehicle, at = _best_insertion(problem, draft, target)
                if total < best:
                    best, best_target, best_vehicle, best_at = total, target, vehicle, at
        if best_target < 0:
            break
        _insert_at(problem, draft, best_target, best_vehicle, best_at)
        waiting[best_target] = False


@kernel
def _move_targets(problem: _Problem, draft: _Draft) -> bool:
    """Move each target once to where the team pays least for it."""
    changed = False
    for vehicle in range(draft.lengths.size):
        at = problem.heads[vehicle]
        while at < draft.lengths[vehicle]:
            before = _team_cost(draft.costs, problem.longest_weight)
            target = draft.orders[vehicle, at]
            _remove(draft.orders[vehicle], draft.lengths[vehicle], at)
            draft.lengths[vehicle] -= 1
            _update_cost(problem, draft, vehicle)
            total, other, where = _best_insertion(problem, draft, target)
            if total < before - 1e-6:
                changed = True
            else:
                other, where = vehicle, at
            _insert_at(problem, draft, target, other, where)
            at += 1
    return changed
