"""Speed of planning, relative to reference methods on the same 1000 x 1000 cells.

python benchmarks/planning_speed.py [--size 1000] [--repeats 5]
Value iteration is compared with SciPy Dijkstra (values) and scikit-image MCP_Geometric (time), A*
with the value of its goal, a planning cycle for four vehicles with one SciPy Dijkstra.
"""

import argparse
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from skimage.graph import MCP_Geometric

from explore_slam.exploration import (
    ExplorationConfig,
    Planner,
    VehicleSnapshot,
    plan_path,
    travel_cost,
    warm_up,
)
from explore_slam.geometry import Pose2
from explore_slam.mapping import GridConfig, OccupancyGrid

OCC_MAX = 0.6
ROOM = 80  # cells


def office(size: int, generator: np.random.Generator) -> NDArray[np.float32]:
    """Make rooms of 4 m with doors of 1 m, at 0.05 m, and free cells of varying probability."""
    grid = generator.choice([0.03, 0.06, 0.15, 0.4], (size, size)).astype(np.float32)
    grid[::ROOM] = grid[:, ::ROOM] = grid[-1] = grid[:, -1] = 0.97
    for row in range(0, size, ROOM):
        for col in range(0, size, ROOM):
            at = int(generator.integers(10, ROOM - 30))
            if row + ROOM < size:
                grid[min(row + ROOM, size - 1), col + at : col + at + 20] = 0.05
            if col + ROOM < size:
                grid[row + at : row + at + 20, min(col + ROOM, size - 1)] = 0.05
    grid[-1] = grid[:, -1] = grid[0] = grid[:, 0] = 0.97
    return grid


def noise(size: int, generator: np.random.Generator) -> NDArray[np.float32]:
    """Make cells of random probability, one fifth of them occupied."""
    grid = generator.uniform(0.03, 0.5, (size, size)).astype(np.float32)
    grid[generator.random((size, size)) < 0.2] = 0.9
    return grid


def graph_of(grid: NDArray[np.float32]) -> csr_matrix:
    """Return the graph for SciPy: step length times the probability of the entered cell."""
    height, width = grid.shape
    index = np.arange(height * width, dtype=np.int32).reshape(height, width)
    free = (grid <= OCC_MAX).ravel()
    rows, cols, data = [], [], []
    for dr in (-1, 0, 1):
        for dc in (-1, 0, 1):
            if dr or dc:
                low_r, high_r = max(0, -dr), height - max(0, dr)
                low_c, high_c = max(0, -dc), width - max(0, dc)
                here = index[low_r:high_r, low_c:high_c].ravel()
                there = index[low_r + dr : high_r + dr, low_c + dc : high_c + dc].ravel()
                use = free[here] & free[there]
                rows.append(here[use])
                cols.append(there[use])
                data.append(math.hypot(dr, dc) * grid.ravel()[there[use]].astype(np.float64))
    return csr_matrix(
        (np.concatenate(data), (np.concatenate(rows), np.concatenate(cols))),
        shape=(height * width, height * width),
    )


def best_of(repeats: int, function: Callable[[], Any]) -> tuple[float, Any]:
    """Return the shortest time (s) of several calls, and the last result."""
    times, result = [], None
    for _ in range(repeats):
        begun = time.perf_counter()
        result = function()
        times.append(time.perf_counter() - begun)
    return min(times), result


def compare_values(name: str, grid: NDArray[np.float32], repeats: int) -> float:
    """Print the comparison on one grid; return the time (s) of SciPy Dijkstra."""
    size = grid.shape[0]
    start = (size // 2 + 7, size // 2 + 7)
    grid[start] = 0.05
    own, values = best_of(repeats, lambda: travel_cost(grid, start, OCC_MAX))
    graph = graph_of(grid)
    flat = start[0] * size + start[1]
    scipy_time, exact = best_of(max(1, repeats // 2), lambda: dijkstra(graph, indices=flat))
    exact = exact.reshape(grid.shape)
    seen = np.isfinite(exact)
    error = np.max(np.abs(values[seen] - exact[seen]) / np.maximum(exact[seen], 1e-12))
    same = np.array_equal(np.isfinite(values), seen)
    costs = np.where(grid <= OCC_MAX, grid, -1.0).astype(np.float64)
    mcp, _ = best_of(repeats, lambda: MCP_Geometric(costs).find_costs([start]))
    print(f'{name}: value iteration {1e3 * own:.0f} ms, largest relative error {error:.1e} ')
    print(f'  (required 1e-4), same cells reached: {same}; {int(seen.sum())} cells')
    print(f'  {own / mcp:.2f} of MCP_Geometric ({1e3 * mcp:.0f} ms; required 0.40)')
    print(f'  {own / scipy_time:.2f} of scipy Dijkstra ({1e3 * scipy_time:.0f} ms)')
    rows, cols = np.nonzero(seen)
    far = int(np.argmax(exact[rows, cols]))
    goal = int(rows[far]), int(cols[far])
    star, (_, cost) = best_of(repeats, lambda: plan_path(grid, start, goal, OCC_MAX))
    print(f'  A* to the farthest cell {1e3 * star:.0f} ms, cost / value {cost / values[goal]:.7f}')
    return scipy_time


def planning_cycle(grid: NDArray[np.float32], repeats: int) -> float:
    """Return the time (s) of a planning cycle for 4 vehicles in a partly explored office."""
    size = grid.shape[0]
    known = np.zeros(grid.shape, np.bool_)
    known[: size // 2 + 20] = True
    known[:, : size // 3] = True
    occupancy = OccupancyGrid.from_probability(grid, known, config=GridConfig(resolution=0.05))
    half = (ROOM // 2) * 0.05
    vehicles = {
        f'robot{i}': VehicleSnapshot(Pose2(half + 4.0 * i * 2, half + 4.0 * i, 0.0))
        for i in range(4)
    }

    def cycle() -> int:
        result = Planner(ExplorationConfig()).plan(occupancy, 0.0, vehicles)
        assert len(result.plans) == 4, result.waiting
        return len(result.frontiers)

    seconds, frontiers = best_of(repeats, cycle)
    print(f'planning cycle, 4 vehicles, {frontiers} frontiers: {1e3 * seconds:.0f} ms')
    return seconds


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--size', type=int, default=1000)
    parser.add_argument('--repeats', type=int, default=5)
    arguments = parser.parse_args()
    begun = time.perf_counter()
    warm_up()
    print(f'warm-up (kernels from the cache or compiled): {time.perf_counter() - begun:.2f} s')
    generator = np.random.default_rng(0)
    compare_values('random grid', noise(arguments.size, generator), arguments.repeats)
    rooms = office(arguments.size, generator)
    one = compare_values('office grid', rooms, arguments.repeats)
    seconds = planning_cycle(rooms, arguments.repeats)
    print(f'  {seconds / one:.2f} of one scipy Dijkstra on that grid (required 2)')


if __name__ == '__main__':
    main()
