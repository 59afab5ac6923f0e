"""Frontiers: stretches of free cells beside unknown ones, and the place from which to look in.

A frontier cell is a known free cell with an unknown neighbor (4-neighborhood); unknown cells that
stand alone, as between far beams, do not count. Cells that touch (8-neighborhood) are one cluster;
long clusters are split along their main direction, short ones and those with little to see are
dropped. The target of a frontier is a cell where a vehicle fits: in the cluster, or near it.
"""

import math

import numpy as np
from numpy.typing import NDArray

from explore_slam.exploration.clearance import CostMap, make_cost_map
from explore_slam.exploration.config import ExplorationConfig, FrontierConfig
from explore_slam.exploration.frontier_kernels import (
    frontier_clusters,
    nearest_stand,
    pocket_size,
    visible_unknown,
)
from explore_slam.exploration.records import Frontier, Grid
from explore_slam.geometry import Array

RAYS = 64
POCKET = 6.0  # m²: unknown areas that are smaller than this are measured, not estimated


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
    stands = np.isfinite(costs.cost) if reachable is None else reachable
    return _frontiers_of(grid, settings.frontiers, costs, stands)


def _frontiers_of(
    grid: Grid, config: FrontierConfig, costs: CostMap, stands: NDArray[np.bool_]
) -> list[Frontier]:
    cells, lengths = frontier_clusters(costs.free, costs.unknown)
    scale = grid.resolution
    smallest = max(1, round(config.min_frontier_size / scale))
    largest = max(1, round(config.max_frontier_size / scale))
    reach = round(config.frontier_reach / scale)
    sensor, area = int(config.sensor_range / scale), scale * scale
    marks = np.zeros(costs.free.shape, np.int32)
    parts: list[NDArray[np.int64]] = []
    places: list[tuple[int, int]] = []
    gains: list[float] = []
    end = 0
    for length in lengths.tolist():
        start, end = end, end + length
        if length < smallest:
            continue
        for part in _split(cells[start:end], largest):
            mark = 2 * len(parts) + 1
            row, col = nearest_stand(costs.free, stands, marks, mark, part, reach)
            pocket = pocket_size(costs.unknown, marks, mark + 1, part, int(POCKET / area))
            if row < 0 or pocket * area < config.min_frontier_gain:
                continue
            seen = visible_unknown(costs.free, costs.unknown, row, col, sensor, RAYS)
            gain = area * (pocket if pocket * area < POCKET else max(seen, pocket))
            parts.append(part)
            places.append((row, col))
            gains.append(gain)
    return _records(grid, parts, places, gains)


def _records(
    grid: Grid,
    parts: list[NDArray[np.int64]],
    places: list[tuple[int, int]],
    gains: list[float],
) -> list[Frontier]:
    if not parts:
        return []
    points = grid.to_point(np.array(places))
    x, y = grid.origin
    frontiers = []
    for part, place, point, gain in zip(parts, places, points.tolist(), gains, strict=True):
        middle_row, middle_col = part.mean(axis=0).tolist()
        centroid = (
            x + (middle_col + 0.5) * grid.resolution,
            y + (middle_row + 0.5) * grid.resolution,
        )
        size = len(part) * grid.resolution
        cell = (int(place[0]), int(place[1]))
        frontiers.append(Frontier(part, centroid, (point[0], point[1]), cell, size, gain))
    return frontiers


def _split(cells: NDArray[np.int64], largest: int) -> list[NDArray[np.int64]]:
    """Cut a cluster across its main direction into pieces of about equal length."""
    pieces = math.ceil(len(cells) / largest)
    if pieces == 1:
        return [cells]
    centered = cells - cells.mean(axis=0)
    spread: Array = centered.T @ centered
    direction = np.linalg.eigh(spread)[1][:, -1]
    order = np.argsort(np.round(centered @ direction, 6), kind='stable')
    return [np.ascontiguousarray(part) for part in np.array_split(cells[order], pieces)]
