"""Kernels that renew what is derived from a grid, tile by tile (see planning_map).

A tile is a square of TILE x TILE cells; tile [0, 0] begins at cell [0, 0]. `todo` (R, C) marks the
tiles to renew. Every kernel gives the cells of a tile the values that the whole grid would give
them.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.exploration.clearance import squared_distance
from explore_slam.exploration.frontier_kernels import SQUARE, is_frontier_cell
from explore_slam.exploration.value_iteration import Costs

TILE = SQUARE  # cells; as the blocks by which grids grow, so that tiles stay tiles
UNKNOWN, FREE, OBSTACLE = 0, 1, 2
_FRONTIER_REACH = 2  # cells from a frontier cell to those that decide whether it is one
Mask = NDArray[np.bool_]


class Levels(NamedTuple):
    """The levels (H, W) of a grid, and what a cell of each level (65536,) is.

    kinds: UNKNOWN, FREE or OBSTACLE. bases: cost of a free cell far from obstacles.
    """

    cells: NDArray[np.int16]
    kinds: NDArray[np.uint8]
    bases: NDArray[np.float64]


class Todo(NamedTuple):
    """Tiles (R, C) whose squared distances, frontier cells and costs have to be renewed."""

    squared: Mask
    frontiers: Mask
    costs: Mask


class Area(NamedTuple):
    """The cells of a tile, without the row `bottom` and the column `right`."""

    top: int
    bottom: int
    left: int
    right: int


@kernel
def area_of(tile_row: int, tile_col: int, height: int, width: int) -> Area:
    """Return the cells of a tile of a grid (H, W)."""
    top, left = tile_row * TILE, tile_col * TILE
    return Area(top, min(height, top + TILE), left, min(width, left + TILE))


def tiles_of(shape: tuple[int, int]) -> tuple[int, int]:
    """Return the rows and columns of tiles of a grid (H, W)."""
    return -(-shape[0] // TILE), -(-shape[1] // TILE)


def moved(
    array: NDArray[Any], shift: tuple[int, int], shape: tuple[int, int], fill: float
) -> NDArray[Any]:
    """Return an array laid over a grid of another size or place.

    shift: rows and columns by which cell [0, 0] moves. fill: value of cells that are new.
    """
    result = np.full(shape, fill, array.dtype)
    (row, col), (height, width) = shift, array.shape
    part = result[max(0, row) : max(0, row + height), max(0, col) : max(0, col + width)]
    kept = array[max(0, -row) :, max(0, -col) :][: part.shape[0], : part.shape[1]]
    part[: kept.shape[0], : kept.shape[1]] = kept
    return result


@kernel
def mark_box(todo: Mask, low_row: int, high_row: int, low_col: int, high_col: int) -> None:
    """Mark the tiles that hold cells of a box; its high row and column do not belong to it."""
    first_row, last_row = max(0, low_row // TILE), min(todo.shape[0] - 1, (high_row - 1) // TILE)
    first_col, last_col = max(0, low_col // TILE), min(todo.shape[1] - 1, (high_col - 1) // TILE)
    for row in range(first_row, last_row + 1):
        for col in range(first_col, last_col + 1):
            todo[row, col] = True


@kernel
def _differs(one: NDArray[np.int16], other: NDArray[np.int16], area: Area) -> bool:
    """Return whether two arrays (H, W) differ in an area."""
    for row in range(area.top, area.bottom):
        # slices, so that the loop becomes vector instructions: indices from 0 cannot be negative
        first, second = one[row, area.left : area.right], other[row, area.left : area.right]
        bits = np.int16(0)
        for k in range(first.size):
            bits |= first[k] ^ second[k]
        if bits != 0:
            return True
    return False


@kernel
def _extend(box: NDArray[np.int64], row: int, col: int) -> None:
    """Extend a box (first row, last row, first column, last column) to a cell."""
    box[0], box[1] = min(box[0], row), max(box[1], row)
    box[2], box[3] = min(box[2], col), max(box[3], col)


@kernel
def _take_area(
    levels: Levels,
    kept: NDArray[np.int16],
    free: Mask,
    unknown: Mask,
    area: Area,
    boxes: NDArray[np.int64],
) -> bool:
    """Bring an area up to date; return whether something there has changed that costs depend on.

    boxes (2, 4): extended to the cells whose kind has changed, and to obstacles that have.
    """
    costs_change = False
    for row in range(area.top, area.bottom):
        for col in range(area.left, area.right):
            level, before = np.uint16(levels.cells[row, col]), np.uint16(kept[row, col])
            if level == before:
                continue
            kept[row, col] = levels.cells[row, col]
            kind, old = levels.kinds[level], levels.kinds[before]
            if kind != old or (kind == FREE and levels.bases[level] != levels.bases[before]):
                costs_change = True
            if kind != old:
                free[row, col], unknown[row, col] = kind == FREE, kind == UNKNOWN
                _extend(boxes[0], row, col)
                if OBSTACLE in (kind, old):
                    _extend(boxes[1], row, col)
    return costs_change


@kernel
def take_changes(
    levels: Levels, kept: NDArray[np.int16], free: Mask, unknown: Mask, limit: int, todo: Todo
) -> None:
    """Bring the kept levels up to date, and which cells are free and unknown (H, W).

    limit: distance (cells) up to which obstacles count.
    Mark the tiles in which, or around which, something that counts has changed.
    """
    height, width = kept.shape
    boxes = np.empty((2, 4), np.int64)
    for tile_row in range(todo.costs.shape[0]):
        for tile_col in range(todo.costs.shape[1]):
            area = area_of(tile_row, tile_col, height, width)
            if not _differs(levels.cells, kept, area):
                continue
            boxes[:, 0], boxes[:, 1], boxes[:, 2], boxes[:, 3] = height, -1, width, -1
            if _take_area(levels, kept, free, unknown, area, boxes):
                todo.costs[tile_row, tile_col] = True
            for k in range(2):
                low_row, high_row, low_col, high_col = boxes[k]
                if high_row < 0:
                    continue
                margin = limit if k else _FRONTIER_REACH
                mark_box(
                    todo.squared if k else todo.frontiers,
                    low_row - margin,
                    high_row + margin + 1,
                    low_col - margin,
                    high_col + margin + 1,
                )


@kernel
def renew_squared(
    free: Mask, unknown: Mask, limit: int, todo: Todo, squared: NDArray[Any]
) -> None:
    """Renew squared distances (H, W) to obstacles; mark tiles in which those of free cells change.

    Tiles side by side are done together: less is computed twice.
    """
    height, width = free.shape
    rows, cols = todo.squared.shape
    for tile_row in range(rows):
        top, bottom = tile_row * TILE, min(height, tile_row * TILE + TILE)
        low_row, high_row = max(0, top - limit), min(height, bottom + limit)
        first = 0
        while first < cols:
            if not todo.squared[tile_row, first]:
                first += 1
                continue
            last = first
            while last + 1 < cols and todo.squared[tile_row, last + 1]:
                last += 1
            left, right = first * TILE, min(width, last * TILE + TILE)
            low_col, high_col = max(0, left - limit), min(width, right + limit)
            obstacles = np.empty((high_row - low_row, high_col - low_col), np.bool_)
            for row in range(low_row, high_row):
                for col in range(low_col, high_col):
                    obstacles[row - low_row, col - low_col] = not (
                        free[row, col] or unknown[row, col]
                    )
            fresh = squared_distance(obstacles, limit)
            for row in range(top, bottom):
                for col in range(left, right):
                    value = fresh[row - low_row, col - low_col]
                    if squared[row, col] != value:
                        squared[row, col] = value
                        if free[row, col]:
                            todo.costs[tile_row, col // TILE] = True
            first = last + 1


@kernel
def renew_frontier_cells(
    free: Mask, unknown: Mask, todo: Mask, frontier: Mask, counts: NDArray[np.int32]
) -> None:
    """Renew which cells (H, W) are frontier cells, and their number in each tile (R, C)."""
    height, width = free.shape
    for tile_row in range(todo.shape[0]):
        for tile_col in range(todo.shape[1]):
            if not todo[tile_row, tile_col]:
                continue
            top, left = tile_row * TILE, tile_col * TILE
            count = 0
            for row in range(top, min(height, top + TILE)):
                for col in range(left, min(width, left + TILE)):
                    frontier[row, col] = is_frontier_cell(free, unknown, row, col)
                    count += frontier[row, col]
            counts[tile_row, tile_col] = count


@kernel
def renew_costs(
    levels: Levels,
    squared: NDArray[Any],
    factors: NDArray[np.float32],
    todo: Mask,
    cost: Costs,
    least: NDArray[np.float64],
) -> None:
    """Renew costs (H, W), and the smallest base of free cells in each tile (R, C).

    factors: on the cost of a free cell, by squared distance to an obstacle.
    """
    height, width = squared.shape
    last = factors.size - 1
    for tile_row in range(todo.shape[0]):
        for tile_col in range(todo.shape[1]):
            if not todo[tile_row, tile_col]:
                continue
            top, left = tile_row * TILE, tile_col * TILE
            low = np.inf
            for row in range(top, min(height, top + TILE)):
                for col in range(left, min(width, left + TILE)):
                    level = np.uint16(levels.cells[row, col])
                    if levels.kinds[level] == FREE:
                        base = levels.bases[level]
                        low = min(low, base)
                        cost[row, col] = base * factors[min(int(squared[row, col]), last)]
                    else:
                        cost[row, col] = np.inf
            least[tile_row, tile_col] = low


@kernel
def close_disc(cost: Costs, todo: Mask, row: int, col: int, radius: float) -> None:
    """Make a disc of cells impassable in some tiles; its centre may lie outside."""
    half = int(np.floor(radius))
    for r in range(max(0, row - half), min(cost.shape[0], row + half + 1)):
        for c in range(max(0, col - half), min(cost.shape[1], col + half + 1)):
            near = (r - row) ** 2 + (c - col) ** 2 <= radius * radius
            if near and todo[r // TILE, c // TILE]:
                cost[r, c] = np.inf


@kernel
def mark_around(todo: Mask, cells: NDArray[np.int64], half: int) -> None:
    """Mark the tiles that hold cells within `half` rows and columns of some cells (N, 2)."""
    for i in range(cells.shape[0]):
        row, col = cells[i, 0], cells[i, 1]
        mark_box(todo, row - half, row + half + 1, col - half, col + half + 1)


@kernel
def label_tiles(
    cost: Costs,
    todo: Mask,
    labels: NDArray[np.uint16],
    counts: NDArray[np.int32],
    passable: NDArray[np.int32],
) -> None:
    """Label the connected passable cells within each tile, from 1; 0 is impassable.

    counts, passable (R, C): number of labels and of passable cells in each tile.
    """
    height, width = cost.shape
    stack = np.empty((TILE * TILE, 2), np.int64)
    for tile_row in range(todo.shape[0]):
        for tile_col in range(todo.shape[1]):
            if not todo[tile_row, tile_col]:
                continue
            top, left = tile_row * TILE, tile_col * TILE
            bottom, right = min(height, top + TILE), min(width, left + TILE)
            labels[top:bottom, left:right] = 0
            label, total = 0, 0
            for row in range(top, bottom):
                for col in range(left, right):
                    if labels[row, col] or cost[row, col] == np.inf:
                        continue
                    label += 1
                    labels[row, col] = label
                    stack[0, 0], stack[0, 1] = row, col
                    size = 1
                    while size > 0:
                        size -= 1
                        total += 1
                        r, c = stack[size, 0], stack[size, 1]
                        for nr in range(max(top, r - 1), min(bottom, r + 2)):
                            for nc in range(max(left, c - 1), min(right, c + 2)):
                                if labels[nr, nc] == 0 and cost[nr, nc] < np.inf:
                                    labels[nr, nc] = label
                                    stack[size, 0], stack[size, 1] = nr, nc
                                    size += 1
            counts[tile_row, tile_col], passable[tile_row, tile_col] = label, total


@kernel
def _root(parents: NDArray[np.int32], item: int) -> int:
    """Return the root of an item, and shorten its way there."""
    while parents[item] != item:
        parents[item] = parents[parents[item]]
        item = parents[item]
    return item


@kernel
def join_tiles(
    labels: NDArray[np.uint16], offsets: NDArray[np.int64], count: int
) -> NDArray[np.int32]:
    """Return the region (N,) of each label of each tile: regions go on across tiles.

    offsets (R, C): number of labels in the tiles before; count: in all. A region is named by one
    of its labels.
    """
    height, width = labels.shape
    parents = np.arange(count).astype(np.int32)
    for tile_row in range(offsets.shape[0]):
        for tile_col in range(offsets.shape[1]):
            top, left = tile_row * TILE, tile_col * TILE
            bottom, right = min(height, top + TILE) - 1, min(width, left + TILE) - 1
            for step in range(2 * TILE):
                # down the last column, then along the last row
                below = step >= TILE
                row, col = (bottom, left + step - TILE) if below else (top + step, right)
                if row > bottom or col > right or labels[row, col] == 0:
                    continue
                here = offsets[tile_row, tile_col] + labels[row, col] - 1
                for k in range(-1, 2):
                    r, c = (row + 1, col + k) if below else (row + k, col + 1)
                    if not (0 <= r < height and 0 <= c < width) or labels[r, c] == 0:
                        continue
                    there = offsets[r // TILE, c // TILE] + labels[r, c] - 1
                    a, b = _root(parents, here), _root(parents, there)
                    parents[max(a, b)] = min(a, b)
    for item in range(count):
        parents[item] = _root(parents, item)
    return parents


@kernel
def renew_region(
    labels: NDArray[np.uint16],
    offsets: NDArray[np.int64],
    inside: Mask,
    old_offsets: NDArray[np.int64],
    old_inside: Mask,
    todo: Mask,
    mask: Mask,
) -> None:
    """Renew which cells (H, W) belong to a region; mark the tiles in which that changes.

    inside (N,): whether each label of each tile does. todo: tiles that have been labelled anew;
    in the others, labels are the same as when they were compared with the old ones.
    """
    height, width = labels.shape
    rows, cols = todo.shape
    for tile_row in range(rows):
        for tile_col in range(cols):
            begin = offsets[tile_row, tile_col]
            if not todo[tile_row, tile_col]:
                following = tile_row * cols + tile_col + 1
                end = inside.size
                if following < rows * cols:
                    end = offsets[following // cols, following % cols]
                before = old_offsets[tile_row, tile_col]
                for k in range(end - begin):
                    if inside[begin + k] != old_inside[before + k]:
                        todo[tile_row, tile_col] = True
                        break
            if not todo[tile_row, tile_col]:
                continue
            top, left = tile_row * TILE, tile_col * TILE
            for row in range(top, min(height, top + TILE)):
                for col in range(left, min(width, left + TILE)):
                    label = labels[row, col]
                    mask[row, col] = label > 0 and inside[begin + label - 1]
