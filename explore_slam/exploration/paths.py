"""Cheapest paths by A* on the costs of the value iteration, and their smoothing.

P. Hart, N. Nilsson and B. Raphael, "A formal basis for the heuristic determination of minimum cost
paths", IEEE Transactions on Systems Science and Cybernetics 4(2), 1968.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from explore_slam.compiled import kernel
from explore_slam.exploration.records import Cell
from explore_slam.exploration.sparse_memory import SparseArray
from explore_slam.exploration.value_iteration import check_cell, check_costs, padded_costs
from explore_slam.heap import push, remove_first

# A straight piece of a smoothed path may cost this much more than the cells it replaces, for
# fewer corners. Chosen by hand; test_value_iteration shows what it decides.
_STRAIGHT_FACTOR = 1.02
_ROUNDING = 1e-6
_SEARCHES = 200  # after which the memory is given back, before it holds the whole of a large map
_INITIAL_CAPACITY = 1024  # entries of the open list


def plan_path(
    probability: ArrayLike,
    start: Cell,
    goal: Cell,
    occ_max: float = 0.6,
    resolution: float = 1.0,
) -> tuple[NDArray[np.int64], float]:
    """Return the cells (L, 2) of the cheapest path from start to goal (row, col), and its cost.

    The costs are those of travel_cost, so that the cost returned is V of the goal. If the goal
    cannot be reached, there are no cells and the cost is infinite. ExplorationError for a start or
    goal that is outside of the grid or in an impassable cell.
    """
    padded = padded_costs(check_costs(probability), occ_max)
    row, col = check_cell(padded, 'start', start)
    goal_row, goal_col = check_cell(padded, 'goal', goal)
    stride = padded.shape[1]
    cells, cost = search_path(padded, row * stride + col, goal_row * stride + goal_col)
    rows, cols = np.divmod(cells, stride)
    return np.stack([rows - 1, cols - 1], axis=1), cost * resolution


class SearchMemory:
    """Working memory of searches: a search costs what it visits, not what the grid is large.

    What a cell holds counts only if its mark is that of the present search.
    """

    def __init__(self) -> None:
        self._resize(0)

    def _resize(self, size: int) -> None:
        self._values = SparseArray(size, np.float64)
        self._moves = SparseArray(size, np.int8)
        self._marks = SparseArray(size, np.int32)
        self._mark = 0

    def begin(
        self, size: int
    ) -> tuple[NDArray[np.float64], NDArray[np.int8], NDArray[np.int32], int]:
        """Return values, moves and marks (size,), and the mark of cells that are open."""
        if size > self._marks.values.size:
            self._resize(size)
        elif self._mark >= 2 * _SEARCHES:
            for array in (self._values, self._moves, self._marks):
                array.clear()
            self._mark = 0
        self._mark += 2
        values, moves, marks = (
            array.values[:size] for array in (self._values, self._moves, self._marks)
        )
        return values, moves, marks, self._mark


def search_path(
    padded: NDArray[np.float32],
    start: int,
    goal: int,
    memory: SearchMemory | None = None,
    lowest: float | None = None,
) -> tuple[NDArray[np.int64], float]:
    """Search over padded costs between flat indices; see plan_path.

    memory: to be used again by the next search. lowest: smallest cost, or less; by default it is
    determined.
    """
    flat = padded.ravel()
    least = lowest_cost(padded) if lowest is None else lowest
    work = (memory or SearchMemory()).begin(flat.size)
    cells, cost = _a_star(flat, padded.shape[1], start, goal, least, *work)
    return cells, float(cost)


def lowest_cost(padded: NDArray[np.float32]) -> float:
    """Return the smallest of padded costs."""
    return float(_lowest(padded.ravel()))


@kernel
def _lowest(cost: NDArray[np.float32]) -> float:
    """Return the smallest cost."""
    low = np.inf
    for value in cost:
        low = min(low, value)
    return low


@kernel
def _bound(cell: int, goal_row: int, goal_col: int, stride: int, lowest: float) -> float:
    """Return a lower bound of the cost to the goal: octile distance over the cheapest cells."""
    dr, dc = abs(cell // stride - goal_row), abs(cell % stride - goal_col)
    # slightly below the true bound, so that rounding never makes it inconsistent
    return lowest * (max(dr, dc) + (math.sqrt(2.0) - 1.0) * min(dr, dc)) * (1.0 - 1e-9)


@kernel
def _a_star(
    cost: NDArray[np.float32],
    stride: int,
    start: int,
    goal: int,
    lowest: float,
    values: NDArray[np.float64],
    came: NDArray[np.int8],
    marks: NDArray[np.int32],
    opened: int,
) -> tuple[NDArray[np.int64], float]:
    """Return the flat indices of the cells from start to goal, and the cost; see plan_path.

    values, came: valid where the mark is `opened`, or opened + 1 for cells that are closed.
    """
    closed = opened + 1
    offsets = np.array(
        [-1, 1, -stride, stride, -stride - 1, -stride + 1, stride - 1, stride + 1], np.int64
    )
    root = math.sqrt(2.0)
    goal_row, goal_col = goal // stride, goal % stride
    keys, items = np.empty(_INITIAL_CAPACITY), np.empty(_INITIAL_CAPACITY, np.int64)
    size = 1
    keys[0], items[0] = 0.0, start
    values[start], marks[start] = 0.0, opened
    while size > 0:
        cell = items[0]
        size -= 1
        remove_first(keys, items, size)
        if marks[cell] == closed:
            continue
        marks[cell] = closed
        if cell == goal:
            break
        for k in range(8):
            other = cell + offsets[k]
            entered = cost[other]
            if entered == np.inf or marks[other] == closed:
                continue
            reached = values[cell] + (entered if k < 4 else entered * root)
            if marks[other] != opened or reached < values[other]:
                values[other], marks[other] = reached, opened
                came[other] = k
                if size == keys.size:
                    keys = np.concatenate((keys, np.empty(keys.size)))
                    items = np.concatenate((items, np.empty(items.size, np.int64)))
                key = reached + _bound(other, goal_row, goal_col, stride, lowest)
                push(keys, items, size, key, other)
                size += 1
    if marks[goal] < opened:
        return np.empty(0, np.int64), np.inf
    return _trace(came, offsets, start, goal), values[goal]


@kernel
def _trace(
    came: NDArray[np.int8], offsets: NDArray[np.int64], start: int, goal: int
) -> NDArray[np.int64]:
    """Return the cells from start to goal, by the moves that led to each cell."""
    cells = [goal]
    while cells[-1] != start:
        cells.append(cells[-1] - offsets[came[cells[-1]]])
    path = np.empty(len(cells), np.int64)
    for i in range(len(cells)):
        path[i] = cells[len(cells) - 1 - i]
    return path


@kernel
def _straight_cost(
    cost: NDArray[np.float32], row_a: int, col_a: int, row_b: int, col_b: int
) -> float:
    """Return the cost along the line between two cell centres; inf through a blocked cell."""
    dr, dc = row_b - row_a, col_b - col_a
    length = math.sqrt(dr * dr + dc * dc)
    samples = max(1, math.ceil(length * 2.0))
    total = 0.0
    for i in range(samples + 1):
        r = math.floor(row_a + dr * i / samples + 0.5)
        c = math.floor(col_a + dc * i / samples + 0.5)
        value = cost[r, c]
        if value == np.inf:
            return np.inf
        total += value * (0.5 if i in (0, samples) else 1.0)
    return total * length / samples


@kernel
def shortcut(cost: NDArray[np.float32], cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the corners (W, 2) of a smoother path: straight where that costs hardly more.

    cost: (H, W), inf for blocked cells.
    cells: (L, 2), a path of neighbouring cells.
    Each straight piece extends as far as it is passable and costs at most 2 % more than the cells
    it replaces; its end is found by doubling and bisection.
    """
    count = cells.shape[0]
    along = np.zeros(count)
    for i in range(1, count):
        dr, dc = cells[i, 0] - cells[i - 1, 0], cells[i, 1] - cells[i - 1, 1]
        mean = 0.5 * (cost[cells[i, 0], cells[i, 1]] + cost[cells[i - 1, 0], cells[i - 1, 1]])
        along[i] = along[i - 1] + mean * math.sqrt(dr * dr + dc * dc)
    corners = [0]
    at = 0
    while at < count - 1:
        best, step = at + 1, 2
        ahead = at + step
        while True:
            ahead = min(at + step, count - 1)
            straight = _straight_cost(
                cost, cells[at, 0], cells[at, 1], cells[ahead, 0], cells[ahead, 1]
            )
            if straight <= (along[ahead] - along[at]) * _STRAIGHT_FACTOR + _ROUNDING:
                best = ahead
                if ahead == count - 1:
                    break
                step *= 2
            else:
                break
        low, high = best, ahead
        while high - low > 1:
            middle = (low + high) // 2
            straight = _straight_cost(
                cost, cells[at, 0], cells[at, 1], cells[middle, 0], cells[middle, 1]
            )
            if straight <= (along[middle] - along[at]) * _STRAIGHT_FACTOR + _ROUNDING:
                low = middle
            else:
                high = middle
        at = max(low, at + 1)
        corners.append(at)
    result = np.empty((len(corners), 2), np.int64)
    for i in range(len(corners)):
        result[i] = cells[corners[i]]
    return result
