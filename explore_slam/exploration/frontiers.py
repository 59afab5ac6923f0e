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

RAYS = 40
NARROW = 0.6  # of that where no vehicle fits through the frontier itself
POCKET = 6.0  # m²: unknown areas that are smaller than this are measured, not estimated


def expected_area(unknown: float, reach: float) -> float:
    """Return the free area (m²) that comes to light where rays cross an unknown area (m²).

    Walls and what lies behind them are unknown too, so the less is unknown all around, the
    smaller the share that proves to be free. Fitted to 4320 frontiers of an office building
    (mean of the new reachable area seen from their targets).
    """
    full = math.pi * reach * reach
    share = unknown / full
    return full * min(0.44 * share * share, 0.15 * share)


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
    limit = round(POCKET / area)
    marks = np.zeros(costs.free.shape, np.int32)
    parts: list[NDArray[np.int64]] = []
    places: list[tuple[int, int]] = []
    middles: list[tuple[float, float]] = []
    gains: list[float] = []
    end, mark = 0, 1
    for length in lengths.tolist():
        start, end = end, end + length
        if length < smallest:
            continue
        for part in _split(cells[start:end], largest):
            mark += 2
            row, col = nearest_stand(costs.free, stands, marks, mark, part, reach)
            if row < 0:
                continue
            pocket, *middle = pocket_size(costs.unknown, marks, mark + 1, part, limit)
            if pocket * area < config.min_frontier_gain:
                continue
            gain = area * pocket
            if pocket >= limit:
                # What is seen from the stand is a rough guess: it ranks a frontier, it drops none.
                seen = visible_unknown(costs.free, costs.unknown, row, col, sensor, RAYS)
                gain = expected_area(area * seen, config.sensor_range)
                if not stands[part[:, 0], part[:, 1]].any():
                    gain *= NARROW
                    if gain < config.min_frontier_gain:
                        continue  # a crack: nobody gets through, and nothing is seen of it
                gain = max(gain, config.min_frontier_gain)
            parts.append(part)
            places.append((row, col))
            middles.append((middle[0], middle[1]))
            gains.append(gain)
    return _records(grid, parts, places, middles, gains)


def _records(
    grid: Grid,
    parts: list[NDArray[np.int64]],
    places: list[tuple[int, int]],
    middles: list[tuple[float, float]],
    gains: list[float],
) -> list[Frontier]:
    if not parts:
        return []
    points = grid.to_point(np.array(places)).tolist()
    scale, (x, y) = grid.resolution, grid.origin
    lengths = np.array([len(part) for part in parts])
    starts = np.concatenate([[0], np.cumsum(lengths)[:-1]])
    means = (np.add.reduceat(np.concatenate(parts), starts) / lengths[:, None]).tolist()
    frontiers = []
    for i, part in enumerate(parts):
        row, col = means[i]
        centroid = (x + (col + 0.5) * scale, y + (row + 0.5) * scale)
        look_at = (x + (middles[i][1] + 0.5) * scale, y + (middles[i][0] + 0.5) * scale)
        cell = (int(places[i][0]), int(places[i][1]))
        target = (points[i][0], points[i][1])
        frontiers.append(
            Frontier(part, centroid, target, cell, len(part) * scale, gains[i], look_at)
        )
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
