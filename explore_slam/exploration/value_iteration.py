"""Cost of travel by deterministic value iteration (paper, section V-A).

V is 0 at the vehicle and elsewhere the fixed point of
V(x, y) = min over the 8 neighbors n of V(n) + |n - (x, y)| * P(occ(x, y)), over cells with
P(occ) <= occ_max. Cells are updated in the order of their value, from a circular queue of buckets
as wide as the cheapest move: then each value is final when its bucket comes up, and one sweep
reaches the fixed point (Dial, 1969; Denardo and Fox, 1979).
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from explore_slam.compiled import kernel
from explore_slam.errors import ExplorationError
from explore_slam.exploration.records import Cell

MOST_BUCKETS = 128
Costs = NDArray[np.float32]


def travel_cost(
    probability: ArrayLike,
    start: Cell,
    occ_max: float = 0.6,
    resolution: float = 1.0,
    *,
    charged: str = 'entered',
) -> Costs:
    """Return the cost V (H, W) of moving from the start cell (row, col) to every cell.

    probability (H, W) is charged per step times its length in units of `resolution`; cells above
    occ_max, and NaN (write it where unknown), cannot be entered and get inf. charged 'entered'
    takes the probability of the cell that a step leads to, 'left' that of the cell it comes from,
    as the update rule is printed in the paper. ExplorationError for an empty grid or a start
    that is outside or impassable.
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
    """Return the array (H, W) as float32, or ExplorationError if it is empty or negative."""
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
    for row in range(cost.shape[0]):
        for col in range(cost.shape[1]):
            if cost[row, col] <= limit:
                padded[row + 1, col + 1] = cost[row, col]


def check_cell(padded: Costs, name: str, cell: Cell) -> Cell:
    """Return the cell (row, col) in the padded array; ExplorationError if nobody can be there."""
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
    """Return V (H + 2, W + 2) over padded costs, from source cells (given in padded indices)."""
    low, high = _finite_range(padded.ravel())
    dearest = high * math.sqrt(2.0)
    # A bucket is a little narrower than the cheapest move, so that rounding cannot fill it again.
    width = max(low * 0.999, dearest / (MOST_BUCKETS - 3), 1e-12)
    count = int(dearest / width) + 3
    values = np.full(padded.shape, np.inf, np.float32)
    sources = rows * padded.shape[1] + cols
    final = width < low
    _sweep(
        padded.ravel(), values.ravel(), padded.shape[1], sources, width, count, final, charge_left
    )
    return values


@kernel
def _finite_range(cost: Costs) -> tuple[float, float]:
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

    final: no move is cheaper than a bucket is wide, so a cell has its value when its bucket is up;
    otherwise a cell is queued again whenever its value falls.
    """
    straight = [-1, 1, -stride, stride]
    offsets = np.array(straight + [-stride - 1, -stride + 1, stride - 1, stride + 1])
    lengths = np.array([1.0] * 4 + [math.sqrt(2.0)] * 4)
    scale = 1.0 / width
    room = max(1024, sources.size)
    queue = np.empty((count, room), np.int32)
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
                continue  # has had its turn in an earlier bucket
            for k in range(8):
                other = cell + offsets[k]
                entered = cost[cell] if charge_left and cost[other] < np.inf else cost[other]
                reached = np.float32(value + entered * lengths[k])
                before = values[other]
                if reached < before:
                    values[other] = reached
                    bucket = int(reached * scale)
                    if not (final and before < np.inf and int(before * scale) == bucket):
                        target = bucket % count
                        if filled[target] == room:
                            queue = np.concatenate((queue, np.empty_like(queue)), axis=1)
                            room *= 2
                        queue[target, filled[target]] = other
                        filled[target] += 1
                        pending += 1
        pending -= filled[slot]
        filled[slot] = 0
        number += 1
        slot = slot + 1 if slot + 1 < count else 0
