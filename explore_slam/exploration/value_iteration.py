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
from explore_slam.geometry import Array

MOST_BUCKETS = 4096


def travel_cost(
    probability: ArrayLike,
    start: Cell,
    occ_max: float = 0.6,
    resolution: float = 1.0,
    *,
    charged: str = 'entered',
) -> Array:
    """Return the cost V (H, W) of moving from the start cell (row, col) to every cell.

    probability (H, W) is charged per step times its length in units of `resolution`; cells above
    occ_max, and NaN (write it where unknown), cannot be entered and get inf. charged 'entered' takes
    the probability of the cell that a step leads to, 'left' that of the cell it comes from, as the
    update rule is printed in the paper. ExplorationError for an empty grid or a start that is
    outside or impassable.
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
    return values[1:-1, 1:-1] * resolution


def check_costs(probability: ArrayLike) -> NDArray[np.float32]:
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


def padded_costs(cost: NDArray[np.float32], limit: float) -> NDArray[np.float32]:
    """Return the costs (H + 2, W + 2) with inf around and where they are NaN or above the limit."""
    padded = np.full((cost.shape[0] + 2, cost.shape[1] + 2), np.inf, np.float32)
    _copy_passable(cost, np.float32(limit), padded)
    return padded


@kernel
def _copy_passable(cost: NDArray[np.float32], limit: float, padded: NDArray[np.float32]) -> None:
    for row in range(cost.shape[0]):
        for col in range(cost.shape[1]):
            if cost[row, col] <= limit:
                padded[row + 1, col + 1] = cost[row, col]


def check_cell(padded: NDArray[np.float32], name: str, cell: Cell) -> Cell:
    """Return the cell (row, col) in the padded array, or ExplorationError if nobody can be there."""
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
    padded: NDArray[np.float32],
    rows: NDArray[np.int64],
    cols: NDArray[np.int64],
    charge_left: bool = False,
) -> Array:
    """Return V (H + 2, W + 2) over padded costs, from source cells (given in padded indices)."""
    passable_low, passable_high = _finite_range(padded)
    width = max(passable_low, passable_high * math.sqrt(2.0) / (MOST_BUCKETS - 2), 1e-12)
    count = int(passable_high * math.sqrt(2.0) / width) + 3
    values = np.full(padded.shape, np.inf)
    sources = rows * padded.shape[1] + cols
    exact = width <= passable_low
    _spread(
        padded.ravel(), values.ravel(), padded.shape[1], sources, width, count, exact, charge_left
    )
    return values


@kernel
def _finite_range(padded: NDArray[np.float32]) -> tuple[float, float]:
    low, high = np.inf, 0.0
    for value in padded.flat:
        if value < np.inf:
            low = min(low, value)
            high = max(high, value)
    return (low, high) if high > 0.0 else (0.0, 0.0)


@kernel
def _spread(
    cost: NDArray[np.float32],
    values: Array,
    stride: int,
    sources: NDArray[np.int64],
    width: float,
    count: int,
    exact: bool,
    charge_left: bool,
) -> None:
    """Dial's buckets as linked lists in a pool that only holds the wave front.

    Not exact: moves may be cheaper than a bucket is wide, then a cell can come up again.
    """
    offsets = np.array(
        [-1, 1, -stride, stride, -stride - 1, -stride + 1, stride - 1, stride + 1], np.int64
    )
    root = math.sqrt(2.0)
    heads = np.full(count, -1, np.int32)
    capacity = 4096
    pool_cell, pool_next = np.empty(capacity, np.int32), np.empty(capacity, np.int32)
    unused, free = 0, -1
    pending = 0
    scale = 1.0 / width
    for source in sources:
        values[source] = 0.0
        pool_cell[unused], pool_next[unused] = source, heads[0]
        heads[0] = unused
        unused += 1
        pending += 1
        if unused == capacity:
            break
    number = 0
    slot = 0
    while pending > 0:
        while heads[slot] >= 0:
            node = heads[slot]
            heads[slot] = pool_next[node]
            cell = pool_cell[node]
            pool_next[node] = free
            free = node
            pending -= 1
            value = values[cell]
            if int(value * scale) < number:
                continue  # settled from an earlier bucket
            left = cost[cell]
            for k in range(8):
                other = cell + offsets[k]
                entered = cost[other]
                if entered == np.inf:
                    continue
                step = left if charge_left else entered
                reached = value + (step if k < 4 else step * root)
                before = values[other]
                if reached >= before:
                    continue
                values[other] = reached
                target = int(reached * scale)
                if exact and before < np.inf and int(before * scale) == target:
                    continue  # waits in that bucket already
                if free >= 0:
                    node = free
                    free = pool_next[node]
                else:
                    if unused == capacity:
                        larger_cell = np.empty(capacity * 2, np.int32)
                        larger_next = np.empty(capacity * 2, np.int32)
                        larger_cell[:capacity] = pool_cell
                        larger_next[:capacity] = pool_next
                        pool_cell, pool_next = larger_cell, larger_next
                        capacity *= 2
                    node = unused
                    unused += 1
                where = target % count
                pool_cell[node], pool_next[node] = other, heads[where]
                heads[where] = node
                pending += 1
        number += 1
        slot += 1
        if slot == count:
            slot = 0
