"""Sets of cells: discs, connected regions, nearest passable cells."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.exploration.frontier_kernels import SQUARE
from explore_slam.exploration.records import Cell
from explore_slam.exploration.value_iteration import Costs
from explore_slam.geometry import Array


def set_disc(mask: NDArray[np.bool_], row: int, col: int, radius: float) -> None:
    """Set the cells of a disc in a mask (H, W); its centre may lie outside."""
    half = math.floor(radius)
    low_row, low_col = max(0, row - half), max(0, col - half)
    window = mask[low_row : max(0, row + half + 1), low_col : max(0, col + half + 1)]
    r, c = np.ogrid[low_row : low_row + window.shape[0], low_col : low_col + window.shape[1]]
    window[(r - row) ** 2 + (c - col) ** 2 <= radius * radius] = True


@kernel
def connected_region(cost: Costs, row: int, col: int) -> NDArray[np.bool_]:
    """Return the cells (H, W) of finite cost that are connected to a cell (8-neighbourhood)."""
    height, width = cost.shape
    mask = np.zeros((height, width), np.bool_)
    stack = np.empty(height * width, np.int32)
    stack[0] = row * width + col
    mask[row, col] = True
    size = 1
    while size > 0:
        size -= 1
        r, c = stack[size] // width, stack[size] % width
        for nr in range(max(0, r - 1), min(height, r + 2)):
            for nc in range(max(0, c - 1), min(width, c + 2)):
                if not mask[nr, nc] and cost[nr, nc] < np.inf:
                    mask[nr, nc] = True
                    stack[size] = nr * width + nc
                    size += 1
    return mask


def nearest_passable(cost: Costs, cell: Cell, radius: float) -> Cell | None:
    """Return the passable cell nearest to a cell within a radius (cells), or None.

    The cell may lie outside the grid.
    """
    row, col = cell
    height, width = cost.shape
    if 0 <= row < height and 0 <= col < width and math.isfinite(cost[row, col]):
        return row, col
    half = math.floor(radius)
    low_row, low_col = max(0, row - half), max(0, col - half)
    window = cost[low_row : max(0, row + half + 1), low_col : max(0, col + half + 1)]
    free = np.argwhere(np.isfinite(window))
    if not len(free):
        return None
    cells = free + (low_row, low_col)
    squared = ((cells - (row, col)) ** 2).sum(axis=1)
    best = int(np.argmin(squared))
    if squared[best] > radius * radius:
        return None
    return int(cells[best, 0]), int(cells[best, 1])


@kernel
def open_around(
    cost: Costs,
    allowed: NDArray[np.bool_],
    squared: NDArray[Any],
    cells: NDArray[np.int64],
    half: int,
    prices: NDArray[np.float32],
    todo: NDArray[np.bool_],
) -> None:
    """Make impassable cells within `half` cells of some cells (N, 2) passable at a price.

    allowed (H, W): cells that may be opened.
    squared (H, W): squared distance (cells) to the nearest obstacle.
    prices: by squared distance; the last one applies beyond.
    todo (R, C): squares of 64 x 64 cells in which that is done.
    """
    last_row, last_col = -1, -1
    for i in range(cells.shape[0]):
        row, col = cells[i, 0], cells[i, 1]
        if row == last_row and col == last_col:
            continue
        last_row, last_col = row, col
        for r in range(max(0, row - half), min(cost.shape[0], row + half + 1)):
            for c in range(max(0, col - half), min(cost.shape[1], col + half + 1)):
                if allowed[r, c] and cost[r, c] == np.inf and todo[r // SQUARE, c // SQUARE]:
                    cost[r, c] = prices[min(squared[r, c], prices.size - 1)]


def along_main_direction(cells: NDArray[np.int64]) -> Array:
    """Return where cells (N, 2) lie along the direction in which they spread most, as (N,)."""
    centered = cells - cells.mean(axis=0)
    spread: Array = centered.T @ centered
    found: Array = np.round(centered @ np.linalg.eigh(spread)[1][:, -1], 6)
    return found


def cut_across(cells: NDArray[np.int64], along: Array, pieces: int) -> list[NDArray[np.int64]]:
    """Cut cells (N, 2) into pieces of about equal size, in the order of `along` (N,)."""
    order = np.argsort(along, kind='stable')
    return [np.ascontiguousarray(part) for part in np.array_split(cells[order], pieces)]
