"""Tours of a team through all stops: who visits which, in which order.

The length of a tour is its travel (m) plus the work expected at its stops. The team pays for the
length of all tours, again for the longest one, so that work is shared evenly, and for the time
that every stop waits. Waiting draws near stops to the front, so that the team need not come back
for them (the traveling repairman problem). Cheapest insertion builds the tours; moves of single
stops and reversals of segments (2-opt; Croes, 1958) improve them.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.geometry import Array

_MAXIMUM_ROUNDS = 60  # of improvement; a bound that is hardly ever reached
_UNREACHABLE = 1e6  # m; travel cost in place of infinity, so that sums can be compared
_IMPROVEMENT = 1e-6  # m; smaller improvements are rounding


class TourProblem(NamedTuple):
    """Costs of V vehicles and F stops.

    starts (V, F): travel (m) from each vehicle to each stop; inf if unreachable.
    between (V, F, F): travel (m) of each vehicle among stops, or (F, F) of all.
    work (V, F): expected at each stop, as travel (m), by each vehicle, or (F,) by any.
    urgency (F,): cost of waiting, per metre of travel until a stop is reached.
    longest_weight: weight of the longest tour against the sum of all.
    """

    starts: Array
    between: Array
    work: Array
    urgency: Array
    longest_weight: float


class Tours(NamedTuple):
    """Stops of each vehicle in order, and the cost of the team (m)."""

    orders: list[list[int]]
    cost: float


class _Problem(NamedTuple):
    """A TourProblem for the kernels: finite costs, and the number of fixed first stops (V,).

    first, work (V, F), pairs (V, F, F): of each vehicle.
    """

    first: Array
    pairs: Array
    work: Array
    urgency: Array
    heads: NDArray[np.int64]
    longest_weight: float


class _Draft(NamedTuple):
    """Tours in the making: orders (V, F), lengths (V,), costs (V, 2) of length and waiting."""

    orders: NDArray[np.int64]
    lengths: NDArray[np.int64]
    costs: Array


def plan_tours(
    problem: TourProblem, fixed: NDArray[np.int64], prior: list[list[int]] | None = None
) -> Tours:
    """Return tours for the team.

    fixed (V,): the stop that a vehicle must visit first, or -1.
    prior: tours to start from; stops that are missing are inserted, and the tours improved.
    Stops that a vehicle cannot reach are visited by others, if any can reach them.
    """
    starts = problem.starts
    vehicles, count = starts.shape
    pairs = np.broadcast_to(problem.between, (vehicles, count, count))
    work = np.broadcast_to(problem.work, (vehicles, count))
    once = fixed.copy()
    for vehicle in range(vehicles):
        if fixed[vehicle] in fixed[:vehicle]:
            once[vehicle] = -1  # two vehicles cannot visit one stop first
    heads = (once >= 0).astype(np.int64)
    orders = np.full((vehicles, count), -1, np.int64)
    lengths = np.zeros(vehicles, np.int64)
    used = {int(stop) for stop in once if stop >= 0}
    for vehicle, order in enumerate(prior or [[]] * vehicles):
        head = [int(once[vehicle])] if once[vehicle] >= 0 else []
        rest = [t for t in order if t not in used and np.isfinite(starts[vehicle, t])]
        used.update(rest)
        lengths[vehicle] = len(head + rest)
        orders[vehicle, : lengths[vehicle]] = head + rest
    finite = _Problem(
        np.ascontiguousarray(np.where(np.isfinite(starts), starts, _UNREACHABLE)),
        np.ascontiguousarray(np.where(np.isfinite(pairs), pairs, _UNREACHABLE)),
        np.ascontiguousarray(work),
        problem.urgency,
        heads,
        problem.longest_weight,
    )
    cost = _make_tours(finite, _Draft(orders, lengths, np.zeros((vehicles, 2))))
    result = []
    for vehicle in range(vehicles):
        order = orders[vehicle, : lengths[vehicle]].tolist()
        result.append([t for t in order if np.isfinite(starts[vehicle, t])])
    return Tours(result, float(cost))


@kernel
def _update_cost(problem: _Problem, draft: _Draft, vehicle: int) -> None:
    """Set length and waiting cost of a tour."""
    order, length = draft.orders[vehicle], draft.lengths[vehicle]
    total, waiting = 0.0, 0.0
    for i in range(length):
        total += (
            problem.first[vehicle, order[0]]
            if i == 0
            else problem.pairs[vehicle, order[i - 1], order[i]]
        )
        waiting += problem.urgency[order[i]] * total
        total += problem.work[vehicle, order[i]]
    draft.costs[vehicle, 0], draft.costs[vehicle, 1] = total, waiting


@kernel
def _team_cost(costs: Array, longest_weight: float) -> float:
    """Return the cost of the team; costs (V, 2): length and waiting of each tour."""
    return float(costs.sum() + longest_weight * costs[:, 0].max())


@kernel
def _best_insertion(problem: _Problem, draft: _Draft, stop: int) -> tuple[float, int, int]:
    """Return cost of the team, vehicle and position of the cheapest insertion of a stop."""
    first, urgency, heads, longest_weight = (
        problem.first, problem.urgency, problem.heads, problem.longest_weight,
    )  # fmt: skip
    orders, lengths, costs = draft
    best, best_vehicle, best_at = np.inf, -1, -1
    trial = costs.copy()
    for vehicle in range(lengths.size):
        if first[vehicle, stop] >= _UNREACHABLE:
            continue
        order, length = orders[vehicle], lengths[vehicle]
        pairs, work = problem.pairs[vehicle], problem.work[vehicle]
        behind = 0.0  # urgency of the stops from the position on
        for i in range(length):
            behind += urgency[order[i]]
        departure = 0.0
        for at in range(length + 1):
            leg = first[vehicle, stop] if at == 0 else pairs[order[at - 1], stop]
            direct = 0.0
            extra = leg + work[stop]
            if at < length:
                direct = first[vehicle, order[0]] if at == 0 else pairs[order[at - 1], order[at]]
                extra += pairs[stop, order[at]] - direct
            if at >= heads[vehicle]:
                waits = urgency[stop] * (departure + leg) + extra * behind
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
def _insert(order: NDArray[np.int64], length: int, at: int, stop: int) -> None:
    """Insert a stop into the first `length` entries of an order."""
    for i in range(length, at, -1):
        order[i] = order[i - 1]
    order[at] = stop


@kernel
def _remove(order: NDArray[np.int64], length: int, at: int) -> None:
    """Remove an entry from the first `length` entries of an order."""
    for i in range(at, length - 1):
        order[i] = order[i + 1]
    order[length - 1] = -1


@kernel
def _reverse_segments(problem: _Problem, draft: _Draft) -> bool:
    """Reverse segments of tours where that lowers the cost of the team (2-opt)."""
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
                if cost < paid - _IMPROVEMENT:
                    paid, changed = cost, True
                else:
                    order[i : j + 1] = order[i : j + 1][::-1].copy()
                    draft.costs[vehicle] = before
    return changed


@kernel
def _make_tours(problem: _Problem, draft: _Draft) -> float:
    """Complete and improve tours in place; return the cost of the team."""
    for vehicle in range(draft.lengths.size):
        _update_cost(problem, draft, vehicle)
    _insert_all(problem, draft)
    for _ in range(_MAXIMUM_ROUNDS):
        reversed_any = _reverse_segments(problem, draft)
        moved_any = _move_stops(problem, draft)
        if not (reversed_any or moved_any):
            break
    return _team_cost(draft.costs, problem.longest_weight)


@kernel
def _insert_at(problem: _Problem, draft: _Draft, stop: int, vehicle: int, at: int) -> None:
    """Insert a stop into the tour of a vehicle and update its cost."""
    _insert(draft.orders[vehicle], draft.lengths[vehicle], at, stop)
    draft.lengths[vehicle] += 1
    _update_cost(problem, draft, vehicle)


@kernel
def _insert_all(problem: _Problem, draft: _Draft) -> None:
    """Insert all stops that are in no tour yet, the cheapest one first."""
    count = problem.urgency.size
    missing = np.ones(count, np.bool_)
    for vehicle in range(draft.lengths.size):
        for at in range(draft.lengths[vehicle]):
            missing[draft.orders[vehicle, at]] = False
    for _ in range(count):
        best, best_stop, best_vehicle, best_at = np.inf, -1, -1, -1
        for stop in range(count):
            if missing[stop]:
                total, vehicle, at = _best_insertion(problem, draft, stop)
                if total < best:
                    best, best_stop, best_vehicle, best_at = total, stop, vehicle, at
        if best_stop < 0:
            break
        _insert_at(problem, draft, best_stop, best_vehicle, best_at)
        missing[best_stop] = False


@kernel
def _move_stops(problem: _Problem, draft: _Draft) -> bool:
    """Move each stop once to where the cost of the team is lowest."""
    changed = False
    for vehicle in range(draft.lengths.size):
        at = problem.heads[vehicle]
        while at < draft.lengths[vehicle]:
            before = _team_cost(draft.costs, problem.longest_weight)
            stop = draft.orders[vehicle, at]
            _remove(draft.orders[vehicle], draft.lengths[vehicle], at)
            draft.lengths[vehicle] -= 1
            _update_cost(problem, draft, vehicle)
            total, other, where = _best_insertion(problem, draft, stop)
            if total < before - _IMPROVEMENT:
                changed = True
            else:
                other, where = vehicle, at
            _insert_at(problem, draft, stop, other, where)
            at += 1
    return changed
