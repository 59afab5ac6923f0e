"""Distance to obstacles, and the cost map on which vehicles plan."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.data import VehicleBody
from explore_slam.exploration.frontier_kernels import FrontierCells
from explore_slam.exploration.records import Grid
from explore_slam.exploration.sections import LARGEST_PLANNING_RADIUS, PathConfig

# Chosen by hand; `explore_slam benchmark exploration` measures what another value does. A tight
# passage is taken where the detour around it would be at least _TIGHT_FACTOR times as long.
_TIGHT_FACTOR = 20.0  # by which cells within planning_radius of an obstacle cost more
_SQUEEZE = 2.0  # further increase towards the obstacle, so that the middle of a gap is cheapest


@dataclass(frozen=True)
class CostMap:
    """Cost (H, W) per length of travel, inf where impassable, and what it is made of.

    make_tight: see tight_cost.
    free: known cells (H, W) that are not obstacles, whether or not a vehicle fits there.
    unknown: cells (H, W) that have never been observed.
    squared: squared distance (H, W) in cells to the nearest obstacle.
    roomy: from this squared distance (cells) on, there is room for the errors of a vehicle.
    frontiers: which cells are frontier cells, if that is known.
    """

    cost: NDArray[np.float32]
    make_tight: Callable[[], NDArray[np.float32]]
    free: NDArray[np.bool_]
    unknown: NDArray[np.bool_]
    squared: NDArray[Any]
    roomy: int = 0
    frontiers: FrontierCells | None = None

    @cached_property
    def tight_cost(self) -> NDArray[np.float32]:
        """The cost (H, W) for trapped vehicles, which is made when it is asked for.

        Cells between minimum_planning_radius and planning_radius of an obstacle are passable at a
        high price.
        """
        return self.make_tight()


@kernel
def _nearest_along(line: NDArray[np.int32], col: int, limit: int) -> int:
    """Return the smallest squared distance over the columns within a limit of one."""
    best = line[col] * line[col]
    reach = 1
    while reach <= limit and reach * reach < best:
        if col >= reach:
            best = min(best, reach * reach + line[col - reach] * line[col - reach])
        if col + reach < line.size:
            best = min(best, reach * reach + line[col + reach] * line[col + reach])
        reach += 1
    return int(best)


@kernel
def squared_distance(obstacles: NDArray[np.bool_], limit: int) -> NDArray[np.int32]:
    """Return the squared distance (H, W) to the nearest obstacle, exact up to `limit` cells.

    Beyond the limit (limit + 1)² is returned. Distances are computed along columns, then along
    rows within the limit, which is less work than the full Euclidean distance transform.
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
    result = np.full((height, width), far * far, np.int32)
    for row in range(height):
        line, out = column[row], result[row]
        last = -1  # the columns up to this one are done
        for at in range(width):
            if line[at] == far:
                continue
            for col in range(max(last + 1, at - limit), min(width, at + limit + 1)):
                out[col] = min(_nearest_along(line, col, limit), far * far)
                last = col
    return result


@kernel
def _classify(
    probability: NDArray[np.float32], known: NDArray[np.bool_], occ_max: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which cells (H, W) are obstacles, free, unknown; known NaN is an obstacle."""
    obstacles = np.empty(known.shape, np.bool_)
    free = np.empty(known.shape, np.bool_)
    unknown = np.empty(known.shape, np.bool_)
    for row in range(known.shape[0]):
        for col in range(known.shape[1]):
            seen, low = known[row, col], probability[row, col] <= occ_max
            obstacles[row, col] = seen and not low
            free[row, col] = seen and low
            unknown[row, col] = not seen
    return obstacles, free, unknown


@kernel
def _charge(
    probability: NDArray[np.float32],
    free: NDArray[np.bool_],
    squared: NDArray[np.int32],
    factors: NDArray[np.float32],
    floor: float,
    scale: float,
) -> NDArray[np.float32]:
    """Return the cost of free cells by factors on it; inf elsewhere."""
    cost = np.full(probability.shape, np.inf, np.float32)
    last = factors.size - 1
    for row in range(cost.shape[0]):
        for col in range(cost.shape[1]):
            if free[row, col]:
                base = max(probability[row, col], floor) * scale
                cost[row, col] = base * factors[min(squared[row, col], last)]
    return cost


def distance_limit(factors: NDArray[np.float32]) -> int:
    """Return the distance (cells) up to which obstacles count for factors of clearance_factors."""
    return math.isqrt(factors.size) + 1


def roomy_from(config: PathConfig, resolution: float) -> int:
    """Return the squared distance (cells) from which on there is room for errors."""
    with_room = (config.planning_radius + config.planning_margin) / resolution
    return int(with_room * with_room) + 1


def make_cost_map(grid: Grid, config: PathConfig, *, probability_costs: bool = False) -> CostMap:
    """Return the costs of a grid for the centre of a vehicle.

    Cells nearer to an obstacle than planning_radius are impassable. With probability_costs the
    others cost their probability of occupation, as in the paper; otherwise
    max(probability, cost_floor) / cost_floor, and more near obstacles. PlanningMap keeps the same
    from cycle to cycle.
    """
    probability, known = grid.probability(), grid.known()
    obstacles, free, unknown = _classify(probability, known, config.occ_max)
    factors, tight = clearance_factors(config, grid.resolution, soft=not probability_costs)
    squared = squared_distance(obstacles, distance_limit(factors))
    floor = 0.0 if probability_costs else config.cost_floor
    scale = 1.0 if probability_costs else 1.0 / config.cost_floor
    cost = _charge(probability, free, squared, factors, floor, scale)

    def make_tight() -> NDArray[np.float32]:
        return _charge(probability, free, squared, tight, floor, scale)

    return CostMap(cost, make_tight, free, unknown, squared, roomy_from(config, grid.resolution))


def paths_of(config: PathConfig, body: VehicleBody) -> PathConfig:
    """Return the settings with the planning radii of a body: its clearance stays the same.

    The minimum is never below what the path follower of the vehicle keeps free.
    """
    largest = LARGEST_PLANNING_RADIUS
    radii = (config.planning_radius, config.minimum_planning_radius)
    radius, smallest = (min(max(one + body.extra_radius, 0.0), largest) for one in radii)
    smallest = max(smallest, min(body.envelope, largest))
    return replace(config, planning_radius=radius, minimum_planning_radius=smallest)


def tight_factor(distances: NDArray[Any], radius: float) -> NDArray[np.float32]:
    """Return the factor on the cost of cells at distances below the radius from an obstacle."""
    nearness = 1.0 - np.asarray(distances, np.float32) / np.float32(radius)
    return (_TIGHT_FACTOR * (1.0 + _SQUEEZE * nearness)).astype(np.float32)


def clearance_factors(
    config: PathConfig, resolution: float, *, soft: bool
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return factors on the cost by squared distance (cells) to an obstacle; the last is 1.

    The first array is inf up to planning_radius, the second up to minimum_planning_radius.
    """
    radius = config.planning_radius / resolution
    beyond = max(config.clearance_distance if soft else 0.0, config.planning_margin)
    reach = radius + beyond / resolution
    distances = np.sqrt(np.arange(int(reach * reach) + 2))
    factors = np.ones(distances.size, np.float32)
    if soft and config.clearance_distance > 0.0:
        reach = radius + config.clearance_distance / resolution
        nearness = np.clip((reach - distances) / (reach - radius), 0.0, 1.0)
        factors += np.float32(config.clearance_weight) * nearness.astype(np.float32) ** 2
    tight = factors.copy()
    factors[distances <= radius] = np.inf
    tight[distances <= radius] *= tight_factor(distances[distances <= radius], radius)
    smallest = min(config.minimum_planning_radius, config.planning_radius) / resolution
    tight[distances <= smallest] = np.inf
    for array in (factors, tight):
        array[0], array[-1] = np.inf, 1.0
    return factors, tight
