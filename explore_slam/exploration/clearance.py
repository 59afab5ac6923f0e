"""Distance to obstacles, and the cost map that vehicles of some width plan on."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.exploration.config import PathConfig
from explore_slam.exploration.records import Grid

TIGHT = 20.0  # a cell that vehicle_radius does not clear costs so many times more on tight maps


class CostMap(NamedTuple):
    """What paths are planned on: cost (H, W) per length, inf where impassable, and its sources.

    tight_cost: the same, but cells between tight_radius and vehicle_radius of an obstacle are
    passable at a high price: for a vehicle that is shut in by what it sees from where it is.
    free: known cells (H, W) that are no obstacles, whether or not the vehicle fits in.
    unknown: cells (H, W) never seen. squared: squared distance (H, W) to the next obstacle.
    """

    cost: NDArray[np.float32]
    tight_cost: NDArray[np.float32]
    free: NDArray[np.bool_]
    unknown: NDArray[np.bool_]
    squared: NDArray[np.int32]


@kernel
def squared_distance(obstacles: NDArray[np.bool_], limit: int) -> NDArray[np.int32]:
    """Return the squared distance (H, W) in cells to the next obstacle, exact up to `limit` cells.

    Beyond the limit (limit + 1)² is returned. First along columns, then along rows within the
    limit only, which is less work than the full transform.
    """
    height, width = obstacles.shape
    far = limit + 1
    column = np.empty((height, width), np.int32)
    for col in range(width):
        column[0, col] = 0 if obstacles[0, col] else far
    for row in range(1, height):
        for col in range(width):
            column[row, col] = 0 if obstacles[row, col] else min(far, column[row - 1, col] + 1)
    for row in range(height - 2, -1, -1):
        for col in range(width):
            column[row, col] = min(column[row, col], column[row + 1, col] + 1)
    result = np.empty((height, width), np.int32)
    for row in range(height):
        line = column[row]
        for col in range(width):
            best = line[col] * line[col]
            reach = 1
            while reach <= limit and reach * reach < best:
                if col >= reach:
                    best = min(best, reach * reach + line[col - reach] * line[col - reach])
                if col + reach < width:
                    best = min(best, reach * reach + line[col + reach] * line[col + reach])
                reach += 1
            result[row, col] = best
    return result


@kernel
def _charge(
    probability: NDArray[np.float32],
    known: NDArray[np.bool_],
    squared: NDArray[np.int32],
    factors: NDArray[np.float32],
    occ_max: float,
    floor: float,
    scale: float,
) -> NDArray[np.float32]:
    cost = np.full(probability.shape, np.inf, np.float32)
    last = factors.size - 1
    for row in range(cost.shape[0]):
        for col in range(cost.shape[1]):
            p = probability[row, col]
            if known[row, col] and p <= occ_max:
                factor = factors[min(squared[row, col], last)]
                cost[row, col] = max(p, floor) * scale * factor
    return cost


def make_cost_map(grid: Grid, config: PathConfig, *, paper_costs: bool = False) -> CostMap:
    """Return the costs of the grid for the center of a vehicle.

    Cells nearer than vehicle_radius to an obstacle are impassable. With paper_costs the rest costs
    its probability; otherwise max(probability, cost_floor) / cost_floor, and more near obstacles.
    """
    probability, known = grid.probability(), grid.known()
    with np.errstate(invalid='ignore'):
        obstacles = known & ~(probability <= config.occ_max)
    free = known & ~obstacles
    factors, tight = clearance_factors(config, grid.resolution, soft=not paper_costs)
    limit = math.isqrt(factors.size) + 1
    squared = squared_distance(obstacles, limit)
    floor = 0.0 if paper_costs else config.cost_floor
    scale = 1.0 if paper_costs else 1.0 / config.cost_floor
    cost = _charge(probability, known, squared, factors, config.occ_max, floor, scale)
    tight_cost = _charge(probability, known, squared, tight, config.occ_max, floor, scale)
    return CostMap(cost, tight_cost, free, ~known, squared)


def clearance_factors(
    config: PathConfig, resolution: float, *, soft: bool
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return factors on the cost by squared distance (cells) to an obstacle; the last is 1.

    The first array has inf up to vehicle_radius, the second up to tight_radius only.
    """
    radius = config.vehicle_radius / resolution
    reach = radius + (config.clearance_distance / resolution if soft else 0.0)
    distances = np.sqrt(np.arange(int(reach * reach) + 2))
    factors = np.ones(distances.size, np.float32)
    if soft and reach > radius:
        nearness = np.clip((reach - distances) / (reach - radius), 0.0, 1.0)
        factors += np.float32(config.clearance_weight) * nearness.astype(np.float32) ** 2
    tight = factors.copy()
    factors[distances <= radius] = np.inf
    tight[distances <= radius] *= np.float32(TIGHT)
    tight[distances <= min(config.tight_radius, config.vehicle_radius) / resolution] = np.inf
    for array in (factors, tight):
        array[0], array[-1] = np.inf, 1.0
    return factors, tight
