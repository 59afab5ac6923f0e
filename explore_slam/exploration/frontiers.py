"""Frontiers: stretches of free cells beside unknown ones, and the place from which to look in.

A frontier cell is a known free cell with an unknown neighbor (4-neighborhood). Cells that touch
(8-neighborhood) are one cluster; long clusters are split along their main direction, short ones
are dropped. The target of a frontier is a cell where a vehicle fits: in the cluster, or near it.
"""

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.exploration.clearance import CostMap, make_cost_map
from explore_slam.exploration.config import ExplorationConfig, FrontierConfig
from explore_slam.exploration.records import Frontier, Grid
from explore_slam.geometry import Array


def find_frontiers(
    grid: Grid,
    config: ExplorationConfig | None = None,
    cost_map: CostMap | None = None,
    reachable: NDArray[np.bool_] | None = None,
) -> list[Frontier]:
    """Return the frontiers of a grid that a vehicle can look into, in the order of their cells.

    cost_map: as made by make_cost_map, if at hand. reachable (H, W): cells that some vehicle can
    get to; without it every cell where a vehicle fits counts.
    """
    settings = config or ExplorationConfig()
    if 0 in grid.shape:
        return []
    costs = cost_map or make_cost_map(grid, settings.paths)
    passable = np.isfinite(costs.cost)
    stands = passable if reachable is None else passable & reachable
    return _frontiers_of(grid, settings.frontiers, costs, stands)


def _frontiers_of(
    grid: Grid, config: FrontierConfig, costs: CostMap, stands: NDArray[np.bool_]
) -> list[Frontier]:
    cells, lengths = frontier_clusters(costs.free, costs.unknown)
    smallest = max(1, round(config.min_frontier_size / grid.resolution))
    largest = max(1, round(config.max_frontier_size / grid.resolution))
    reach = round(config.frontier_reach / grid.resolution)
    marks = np.zeros(costs.free.shape, np.int32)
    mark = 0
    frontiers = []
    end = 0
    for length in lengths.tolist():
        start, end = end, end + length
        if length < smallest:
            continue
        for part in _split(cells[start:end], largest):
            mark += 1
            center = part.mean(axis=0)
            row, col = _nearest_stand(costs.free, stands, marks, mark, part, center, reach)
            if row < 0:
                continue
            points = grid.to_point(np.array([[row, col]]))
            middle = grid.to_point(part).mean(axis=0)
            frontiers.append(
                Frontier(
                    part,
                    (float(middle[0]), float(middle[1])),
                    (float(points[0, 0]), float(points[0, 1])),
                    (int(row), int(col)),
                    len(part) * grid.resolution,
                )
            )
    return frontiers


def _split(cells: NDArray[np.int64], largest: int) -> list[NDArray[np.int64]]:
    """Cut a cluster across its main direction into pieces of about equal length."""
    pieces = -(-len(cells) // largest)
    if pieces == 1:
        return [cells]
    centered = cells - cells.mean(axis=0)
    spread: Array = centered.T @ centered
    direction = np.linalg.eigh(spread)[1][:, -1]
    order = np.argsort(np.round(centered @ direction, 6), kind='stable')
    return [np.ascontiguousarray(part) for part in np.array_split(cells[order], pieces)]


@kernel
def frontier_clusters(
    free: NDArray[np.bool_], unknown: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the frontier cells (N, 2) cluster by cluster, and the length of each cluster."""
    height, width = free.shape
    edge = np.zeros((height, width), np.bool_)
    total = 0
    for row in range(height):
        for col in range(width):
            if free[row, col] and (
                (row > 0 and unknown[row - 1, col])
                or (row + 1 < height and unknown[row + 1, col])
                or (col > 0 and unknown[row, col - 1])
                or (col + 1 < width and unknown[row, col + 1])
            ):
                edge[row, col] = True
                total += 1
    cells = np.empty((total, 2), np.int64)
    lengths = np.empty(total, np.int64)
    clusters, filled = 0, 0
    for row in range(height):
        for col in range(width):
            if not edge[row, col]:
                continue
            first = filled
            edge[row, col] = False
            cells[filled, 0], cells[filled, 1] = row, col
            filled += 1
            head = first
            while head < filled:
                r, c = cells[head, 0], cells[head, 1]
                head += 1
                for dr in range(-1, 2):
                    for dc in range(-1, 2):
                        nr, nc = r + dr, c + dc
                        if 0 <= nr < height and 0 <= nc < width and edge[nr, nc]:
                            edge[nr, nc] = False
                            cells[filled, 0], cells[filled, 1] = nr, nc
                            filled += 1
            lengths[clusters] = filled - first
            clusters += 1
    return cells, lengths[:clusters]


@kernel
def _nearest_stand(
    free: NDArray[np.bool_],
    stands: NDArray[np.bool_],
    marks: NDArray[np.int32],
    mark: int,
    cells: NDArray[np.int64],
    center: Array,
    reach: int,
) -> tuple[int, int]:
    """Return the cell to stand on: of the cluster, nearest to its center, else the nearest one.

    The search spreads from the cluster over free cells (so never through a wall), up to `reach`
    steps; (-1, -1) if a vehicle fits nowhere there.
    """
    best_row, best_col, best = -1, -1, np.inf
    for i in range(cells.shape[0]):
        row, col = cells[i, 0], cells[i, 1]
        if stands[row, col]:
            distance = (row - center[0]) ** 2 + (col - center[1]) ** 2
            if distance < best:
                best_row, best_col, best = row, col, distance
    if best_row >= 0:
        return best_row, best_col
    height, width = free.shape
    wave = [(cells[i, 0], cells[i, 1]) for i in range(cells.shape[0])]
    for row, col in wave:
        marks[row, col] = mark
    for _ in range(reach):
        following = [(0, 0) for _ in range(0)]
        for row, col in wave:
            for k in range(4):
                nr = row + (k == 0) - (k == 1)
                nc = col + (k == 2) - (k == 3)
                if not (0 <= nr < height and 0 <= nc < width):
                    continue
                if marks[nr, nc] == mark or not free[nr, nc]:
                    continue
                marks[nr, nc] = mark
                following.append((nr, nc))
                if stands[nr, nc]:
                    distance = (nr - center[0]) ** 2 + (nc - center[1]) ** 2
                    if distance < best:
                        best_row, best_col, best = nr, nc, distance
        if best_row >= 0:
            return best_row, best_col
        wave = following
    return -1, -1


@kernel
def visible_unknown(
    occupied: NDArray[np.bool_],
    unknown: NDArray[np.bool_],
    row: int,
    col: int,
    reach: int,
    rays: int,
) -> float:
    """Estimate the unknown area (cells) in sight of a cell: rays up to `reach` or an obstacle."""
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
            if occupied[r, q]:
                break
            if unknown[r, q]:
                area += wedge * step
    return area
