"""Kernels of the search for frontiers."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel

Mask = NDArray[np.bool_]
Cells = NDArray[np.int64]
_MINIMUM_CLUSTER = 3  # unknown cells in a 3 x 3 window; fewer are gaps between far beams


SQUARE = 64  # cells; the side of the squares in which frontier cells are counted


class FrontierCells(NamedTuple):
    """Which cells (H, W) are frontier cells, and how many of each square of 64 x 64 cells are."""

    mask: Mask
    counts: NDArray[np.int32]


@kernel
def _is_unexplored(unknown: Mask, row: int, col: int) -> bool:
    """Return whether a cell is unknown, together with cells around it."""
    height, width = unknown.shape
    if not (0 <= row < height and 0 <= col < width) or not unknown[row, col]:
        return False
    count = 0
    for r in range(max(0, row - 1), min(height, row + 2)):
        for c in range(max(0, col - 1), min(width, col + 2)):
            count += unknown[r, c]
    return count >= _MINIMUM_CLUSTER


@kernel
def is_frontier_cell(free: Mask, unknown: Mask, row: int, col: int) -> bool:
    """Return whether a cell is free and has an unexplored 4-neighbour."""
    return bool(
        free[row, col]
        and (
            _is_unexplored(unknown, row - 1, col)
            or _is_unexplored(unknown, row + 1, col)
            or _is_unexplored(unknown, row, col - 1)
            or _is_unexplored(unknown, row, col + 1)
        )
    )


@kernel
def frontier_cells(free: Mask, unknown: Mask) -> FrontierCells:
    """Return the frontier cells of a whole grid (H, W)."""
    height, width = free.shape
    mask = np.zeros((height, width), np.bool_)
    counts = np.zeros((-(-height // SQUARE), -(-width // SQUARE)), np.int32)
    for row in range(height):
        for col in range(width):
            if is_frontier_cell(free, unknown, row, col):
                mask[row, col] = True
                counts[row // SQUARE, col // SQUARE] += 1
    return FrontierCells(mask, counts)


@kernel
def frontier_clusters(frontiers: FrontierCells) -> tuple[Cells, Cells]:
    """Return the frontier cells (N, 2) cluster by cluster, and the size of each cluster."""
    edge, counts = frontiers
    height, width = edge.shape
    total = counts.sum()
    cells = np.empty((total, 2), np.int64)
    lengths = np.empty(total, np.int64)
    clusters, filled = 0, 0
    for row in range(height):
        for square in range(counts.shape[1]):
            if counts[row // SQUARE, square] == 0:
                continue
            for col in range(square * SQUARE, min(width, (square + 1) * SQUARE)):
                if not edge[row, col]:
                    continue
                head = filled
                edge[row, col] = False  # taken, until the end
                cells[filled, 0], cells[filled, 1] = row, col
                filled += 1
                first = head
                while head < filled:
                    r, c = cells[head, 0], cells[head, 1]
                    head += 1
                    for nr in range(max(0, r - 1), min(height, r + 2)):
                        for nc in range(max(0, c - 1), min(width, c + 2)):
                            if edge[nr, nc]:
                                edge[nr, nc] = False
                                cells[filled, 0], cells[filled, 1] = nr, nc
                                filled += 1
                lengths[clusters] = filled - first
                clusters += 1
    for i in range(filled):
        edge[cells[i, 0], cells[i, 1]] = True
    return cells, lengths[:clusters]


class Viewpoints(NamedTuple):
    """Cells (H, W) that will do as viewpoints, squared distances (H, W) to obstacles (cells)."""

    cells: Mask
    squared: NDArray[Any]


@kernel
def _nearest_viewpoint(
    viewpoints: Viewpoints, roomy: int, cells: Cells, first: int, last: int, row: float, col: float
) -> int:
    """Return which of the cells first to last is the viewpoint nearest to a place, or -1.

    roomy: smallest squared distance to obstacles.
    """
    best, found = np.inf, -1
    for i in range(first, last):
        r, c = cells[i, 0], cells[i, 1]
        if viewpoints.cells[r, c] and viewpoints.squared[r, c] >= roomy:
            distance = (r - row) ** 2 + (c - col) ** 2
            if distance < best:
                best, found = distance, i
    return found


@kernel
def _grow(
    allowed: Mask, marks: NDArray[np.int32], mark: int, queue: Cells, at: int, end: int
) -> int:
    """Append the unmarked allowed 4-neighbours of one queued cell; return the new end."""
    height, width = allowed.shape
    for k in range(4):
        row = queue[at, 0] + (k == 0) - (k == 1)
        col = queue[at, 1] + (k == 2) - (k == 3)
        inside = 0 <= row < height and 0 <= col < width
        if end < len(queue) and inside and marks[row, col] != mark and allowed[row, col]:
            marks[row, col] = mark
            queue[end, 0], queue[end, 1] = row, col
            end += 1
    return end


@kernel
def find_viewpoint(
    free: Mask,
    viewpoints: Viewpoints,
    roomy: int,
    marks: NDArray[np.int32],
    mark: int,
    cells: Cells,
    reach: int,
) -> tuple[int, int]:
    """Return the viewpoint of a cluster (N, 2): in it, nearest to its centre, or else near it.

    The search spreads from the cluster over free cells, so never through a wall, up to `reach`
    steps; (-1, -1) if there is no viewpoint. roomy: squared distance (cells) to obstacles that it
    keeps at least. marks (H, W) must not contain mark.
    """
    row, col = cells[:, 0].mean(), cells[:, 1].mean()
    count = cells.shape[0]
    found = _nearest_viewpoint(viewpoints, roomy, cells, 0, count, row, col)
    if found >= 0:
        return cells[found, 0], cells[found, 1]
    queue = np.empty((count + 4 * (reach + 1) * (reach + count), 2), np.int64)
    queue[:count] = cells
    for i in range(count):
        marks[cells[i, 0], cells[i, 1]] = mark
    start, end = 0, count
    for _ in range(reach):
        fresh = end
        for at in range(start, fresh):
            end = _grow(free, marks, mark, queue, at, end)
        found = _nearest_viewpoint(viewpoints, roomy, queue, fresh, end, row, col)
        if found >= 0:
            return queue[found, 0], queue[found, 1]
        start = fresh
    return -1, -1


@kernel
def pocket_size(
    unknown: Mask, marks: NDArray[np.int32], mark: int, cells: Cells, limit: int
) -> tuple[int, float, float, Cells]:
    """Return the number of connected unknown cells behind a frontier, their centre and their box.

    Counted up to a limit, nearest first; the centre (row, col) is of those that were counted, and
    so is the box: first and last row, first and last column.
    """
    queue = np.empty((limit + 4, 2), np.int64)
    end = 0
    for i in range(cells.shape[0]):
        for k in range(4):
            row = cells[i, 0] + (k == 0) - (k == 1)
            col = cells[i, 1] + (k == 2) - (k == 3)
            if end < limit and _is_unexplored(unknown, row, col) and marks[row, col] != mark:
                marks[row, col] = mark
                queue[end, 0], queue[end, 1] = row, col
                end += 1
    at = 0
    while at < end < limit:
        end = _grow(unknown, marks, mark, queue, at, end)
        at += 1
    if end == 0:
        row, col = cells[0, 0], cells[0, 1]
        return 0, row, col, np.array([row, row, col, col])
    rows, cols = queue[:end, 0], queue[:end, 1]
    box = np.array([rows.min(), rows.max(), cols.min(), cols.max()])
    return min(end, limit), rows.mean(), cols.mean(), box


@kernel
def visible_unknown(free: Mask, unknown: Mask, row: int, col: int, reach: int, rays: int) -> float:
    """Return the unknown area (cells) in sight of a cell, by rays up to `reach` or an obstacle."""
    height, width = unknown.shape
    area = 0.0
    wedge = 2.0 * np.pi / rays
    for ray in range(rays):
        c, s = np.cos(ray * wedge), np.sin(ray * wedge)
        for step in range(1, reach + 1):
            r, q = int(np.floor(row + 0.5 + step * s)), int(np.floor(col + 0.5 + step * c))
            if not (0 <= r < height and 0 <= q < width):
                area += wedge * 0.5 * (reach * reach - step * step)
                break
            if unknown[r, q]:
                area += wedge * step
            elif not free[r, q]:
                break
    return area
