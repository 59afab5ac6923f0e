"""Travel cost by deterministic value iteration (paper, section V-A).

V is 0 at the vehicle and elsewhere the fixed point of
V(x, y) = min over the 8 neighbours n of V(n) + |n - (x, y)| * P(occ(x, y)), over cells with
P(occ) <= occ_max. Cells are updated in the order of their values, from a circular queue of buckets
as wide as the cheapest move. A value is then final when its bucket is processed, and one sweep
reaches the fixed point (R. Dial, "Algorithm 360: shortest-path forest with topological ordering",
1969; E. Denardo and B. Fox, "Shortest-route methods: 1. Reaching, pruning, and buckets", 1979).
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from explore_slam.compiled import kernel
from explore_slam.errors import ExplorationError
from explore_slam.exploration.records import Cell

_MAXIMUM_BUCKETS = 128  # bounds the memory where costs differ widely
_INITIAL_CAPACITY = 1024  # cells per bucket
Costs = NDArray[np.float32]


def travel_cost(
    probability: ArrayLike,
    start: Cell,
    occ_max: float = 0.6,
    resolution: float = 1.0,
    *,
    charged: str = 'entered',
) -> Costs:
    """Return the travel cost V (H, W) from a start cell (row, col) to every cell.

    probability: (H, W), charged per step, times the length of the step. Cells above occ_max, and
    NaN, which stands for unknown, cannot be entered; their cost is inf.
    resolution: side of a cell, the unit of length.
    charged: 'entered' charges the cell that a step leads to, 'left' the cell that it comes from,
    which is the update rule as printed in the paper.
    ExplorationError for an empty grid, and for a start that is outside or impassable.
    """
    cost = check_costs(probability)
    if charged not in ('entered', 'left'):
        raise ExplorationError(f"charged is {charged!r}, expected 'entered' or 'left'")
    if not resolution > 0.0:
        raise ExplorationError(f'resolution is {resolution}, expected more than 0')
    padded = padded_costs(cost, occ_max)
    row, col = check_cell(padded, 'start', start)
    values = spread(
        padded, np.array([row], np.int64), np.array([col], np.int64), charged == 'left'
    )
    scaled: Costs = values[1:-1, 1:-1] * np.float32(resolution)
    return scaled


def check_costs(probability: ArrayLike) -> Costs:
    """Return the array (H, W) as float32; ExplorationError if it is empty or negative."""
    cost = np.asarray(probability, np.float32)
    if cost.ndim != 2 or cost.size == 0:
        raise ExplorationError(f'the grid has shape {cost.shape}, expected (H, W) with cells')
    if cost.size > 2**31 - 1:
        raise ExplorationError(f'the grid has {cost.size} cells, expected fewer than 2**31')
    with np.errstate(invalid='ignore'):
        if (cost < 0.0).any():
            raise ExplorationError('the grid holds negative probabilities or costs')
    return cost


def padded_costs(cost: Costs, limit: float) -> Costs:
    """Return the costs (H + 2, W + 2), inf around and where they are NaN or above the limit."""
    padded = np.full((cost.shape[0] + 2, cost.shape[1] + 2), np.inf, np.float32)
    _copy_passable(cost, limit, padded)
    return padded


@kernel
def _copy_passable(cost: Costs, limit: float, padded: Costs) -> None:
    """Copy the costs up to a limit into the middle of a padded array."""
    for row in range(cost.shape[0]):
        for col in range(cost.shape[1]):
            if cost[row, col] <= limit:
                padded[row + 1, col + 1] = cost[row, col]


def check_cell(padded: Costs, name: str, cell: Cell) -> Cell:
    """Return a cell (row, col) in padded indices; ExplorationError if it is impassable."""
    row, col = int(cell[0]), int(cell[1])
    height, width = padded.shape[0] - 2, padded.shape[1] - 2
    if not (0 <= row < height and 0 <= col < width):
        raise ExplorationError(
            f'{name} cell ({row}, {col}) is outside of the grid of {height} x {width} cells'
        )
    if not math.isfinite(padded[row + 1, col + 1]):
        raise ExplorationError(f'{name} cell ({row}, {col}) is occupied or unknown')
    return row + 1, col + 1


def spread(
    padded: Costs, rows: NDArray[np.int64], cols: NDArray[np.int64], charge_left: bool = False
) -> Costs:
    """Return V (H + 2, W + 2) over padded costs, from source cells in padded indices.

    charge_left: charge the cell that a step comes from instead of the one it leads to.
    """
    low, high = _finite_range(padded.ravel())
    costliest_move = high * math.sqrt(2.0)
    # a bucket is slightly narrower than the cheapest move, so that rounding cannot refill it
    width = max(low * 0.999, costliest_move / (_MAXIMUM_BUCKETS - 3), 1e-12)
    count = int(costliest_move / width) + 3
    values = np.full(padded.shape, np.inf, np.float32)
    sources = rows * padded.shape[1] + cols
    final = width < low
    _sweep(
        padded.ravel(), values.ravel(), padded.shape[1], sources, width, count, final, charge_left
    )
    return values


@kernel
def _finite_range(cost: Costs) -> tuple[float, float]:
    """Return the smallest and the largest finite cost; zeros if all are zero or infinite."""
    low, high = np.inf, 0.0
    for value in cost:
        if value < np.inf:
            low = min(low, float(value))
            high = max(high, float(value))
    return (low, high) if high > 0.0 else (0.0, 0.0)


@kernel
def _sweep(
    cost: Costs,
    values: Costs,
    stride: int,
    sources: NDArray[np.int64],
    width: float,
    count: int,
    final: bool,
    charge_left: bool,
) -> None:
    """Update cells bucket by bucket until the queue is empty.

    width, count: of the buckets. final: no move is cheaper than a bucket is wide, so that a value
    is final when its bucket is processed; otherwise a cell is queued again when its value falls.
    """
    straight = [-1, 1, -stride, stride]
    offsets = np.array(straight + [-stride - 1, -stride + 1, stride - 1, stride + 1])
    lengths = np.array([1.0] * 4 + [math.sqrt(2.0)] * 4)
    scale = 1.0 / width
    capacity = max(_INITIAL_CAPACITY, sources.size)
    queue = np.empty((count, capacity), np.int32)
    filled = np.zeros(count, np.int64)
    values[sources] = 0.0
    queue[0, : sources.size] = sources
    filled[0] = sources.size
    pending, number, slot = sources.size, 0, 0
    while pending > 0:
        taken = 0
        while taken < filled[slot]:
            cell = queue[slot, taken]
            taken += 1
            value = values[cell]
            if int(value * scale) < number:
                continue  # processed in an earlier bucket
            for k in range(8):
                other = cell + offsets[k]
                before = values[other]
                if before <= value:
                    continue  # costs are not negative
                entered = cost[cell] if charge_left and cost[other] < np.inf else cost[other]
                reached = np.float32(value + entered * lengths[k])
                if reached < before:
                    values[other] = reached
                    bucket = int(reached * scale)
                    if not (final and before < np.inf and int(before * scale) == bucket):
                        target = slot + bucket - number
                        if target >= count:
                            target -= count
                        if filled[target] == capacity:
                            queue = np.concatenate((queue, np.empty_like(queue)), axis=1)
                            capacity *= 2
                        queue[target, filled[target]] = other
                        filled[target] += 1
                        pending += 1
        pending -= filled[slot]
        filled[slot] = 0
        number += 1
        slot = slot + 1 if slot + 1 < count else 0
