"""Time and memory of planning cycles on a large map, while vehicles drive and map.

python benchmarks/planning_cycles.py [--side 200] [--vehicles 4,16] [--cycles 5] [--profile]

The map is an office of rooms and corridors, 200 x 200 m in cells of 0.05 m: 16 million. All of it
is known but for the rooms along its edge and some within. The vehicles start spread out beside
what is unknown, and explore in the grid simulator; a cycle follows every two seconds of their
laser scans. Times are CPU seconds of the planner alone. The memory is what the planner holds at
most, above grid and simulator.
"""

import argparse
import cProfile
import gc
import os
import platform
import pstats
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import Plan
from explore_slam.exploration import ExplorationConfig, Planner, VehicleSnapshot, warm_up
from explore_slam.geometry import Pose2
from explore_slam.mapping import GridConfig, OccupancyGrid
from explore_slam.simulation.grid.grid_simulator import GridSimulator
from explore_slam.simulation.worlds.grid_world import FREE, SOLID, GridWorld

RESOLUTION = 0.05  # m
ROOM = 100  # cells from wall to wall
CORRIDOR = 50  # cells
WALL = 3  # cells
DOOR = 22  # cells
UNSEEN = 0.03  # of the rooms within are unknown
SCANS = 4  # of every vehicle between two cycles, half a second apart
WARM = 3  # cycles before those that count
LEVELS = np.array([np.nan, 0.03, 0.97])  # probability: unknown, free, occupied


def office(side: int, random: np.random.Generator) -> NDArray[np.bool_]:
    """Return the solid cells (side, side): double rows of rooms with furniture, and corridors."""
    solid = np.ones((side, side), np.bool_)
    period = CORRIDOR + 2 * ROOM
    solid[:, WALL : side - WALL] = False
    for low in range(0, side, period):
        solid[low : low + WALL] = True
        solid[low + CORRIDOR : low + CORRIDOR + WALL] = True
        solid[low + CORRIDOR + ROOM : low + CORRIDOR + ROOM + WALL] = True
    for low in range(0, side, period):
        for row in (low + CORRIDOR, low + CORRIDOR + ROOM):
            for col in range(0, side - ROOM // 2, ROOM):
                solid[row : row + ROOM, col : col + WALL] = True
                _furnish(solid, row + WALL, col + WALL, random)
                wall = row if row == low + CORRIDOR else row + ROOM
                door = col + int(random.integers(WALL + 8, ROOM - DOOR - 8))
                solid[wall : wall + WALL, door : door + DOOR] = False
        # cross corridors join the others
        for col in range(ROOM, side, 6 * ROOM):
            solid[low + CORRIDOR : low + period + WALL, col + 35 : col + 35 + DOOR] = False
    solid[:WALL] = solid[-WALL:] = solid[:, :WALL] = solid[:, -WALL:] = True
    return solid


def _furnish(solid: NDArray[np.bool_], row: int, col: int, random: np.random.Generator) -> None:
    for _ in range(3):
        height, width = random.integers(8, 26, 2)
        top, left = row + int(random.integers(22, 60)), col + int(random.integers(8, 70))
        solid[top : top + height, left : left + width] = True


def known_cells(side: int, random: np.random.Generator) -> NDArray[np.bool_]:
    """Return which cells (side, side) have been explored."""
    known = np.zeros((side, side), np.bool_)
    margin = side // 16
    known[margin : side - margin, margin : side - margin] = True
    period = CORRIDOR + 2 * ROOM
    for low in range(0, side, period):
        for row in (low + CORRIDOR, low + CORRIDOR + ROOM):
            for col in range(0, side, ROOM):
                if random.random() < UNSEEN:
                    known[row : row + ROOM, col : col + ROOM] = False
    return known


def start_poses(
    world: GridWorld, known: NDArray[np.bool_], count: int, random: np.random.Generator
) -> dict[str, Pose2]:
    """Return poses in corridors beside what is unknown, spread out (farthest point sampling)."""
    side = len(known)
    period = CORRIDOR + 2 * ROOM
    rows = np.arange(0, side, period) + CORRIDOR // 2
    cols = np.arange(ROOM // 2, side, 20)
    cells = np.stack(np.meshgrid(rows, cols, indexing='ij'), axis=-1).reshape(-1, 2)
    cells = cells[(cells < side).all(axis=1)]
    inner, reach = side // 16, ROOM
    near = ((cells < inner + reach) | (cells > side - inner - reach)).any(axis=1)
    free = world.clearance[cells[:, 0], cells[:, 1]] > 0.5
    cells = cells[near & free & known[cells[:, 0], cells[:, 1]]]
    chosen = [int(random.integers(len(cells)))]
    gaps = np.full(len(cells), np.inf)
    while len(chosen) < count:
        gaps = np.minimum(gaps, np.linalg.norm(cells - cells[chosen[-1]], axis=1))
        chosen.append(int(np.argmax(gaps)))
    points = world.to_point(cells[chosen]).tolist()
    return {f'robot{i + 1}': Pose2(x, y, 0.0) for i, (x, y) in enumerate(points)}


class PlannerMemory:
    """Largest memory (MB) that the planner has held: what it keeps, and what a cycle adds.

    Between the cycles, grid and simulator grow too: pages are taken when they are first written.
    """

    def __init__(self) -> None:
        self.peak = self._kept = self._before = 0.0

    def begin(self) -> None:
        """Begin a cycle."""
        gc.collect()
        Path('/proc/self/clear_refs').write_text('5')  # the peak is now the present value
        self._before = self._read('VmRSS')

    def end(self) -> None:
        """End a cycle."""
        self.peak = max(self.peak, self._kept + self._read('VmHWM') - self._before)
        self._kept += self._read('VmRSS') - self._before

    @staticmethod
    def _read(name: str) -> float:
        for line in Path('/proc/self/status').read_text().splitlines():
            if line.startswith(f'{name}:'):
                return float(line.split()[1]) * 1024.0 / 1e6
        raise OSError(f'/proc/self/status has no {name}')


def measure(side: int, vehicles: int, cycles: int, seed: int, profile: bool) -> None:
    """Let a team explore, and print time and memory of its planning cycles."""
    random = np.random.default_rng(seed)
    solid, known = office(side, random), known_cells(side, random)
    world = GridWorld(np.where(solid, SOLID, FREE).astype(np.int8), RESOLUTION)
    simulator = GridSimulator(world, start_poses(world, known, vehicles, random), seed=seed)
    levels = np.where(known, np.where(solid, np.uint8(2), np.uint8(1)), np.uint8(0))
    grid = OccupancyGrid.from_levels(levels, LEVELS, config=GridConfig(resolution=RESOLUTION))
    del solid, known, levels
    planner = Planner(ExplorationConfig())
    memory = PlannerMemory()
    profiler = cProfile.Profile(time.process_time)
    times: list[float] = []
    plans: dict[str, Plan] = {}
    for cycle in range(WARM + cycles):
        for _ in range(SCANS):
            for _ in range(round(0.5 / simulator.config.time_step)):
                simulator.step()
            for name in simulator.vehicles:
                grid.insert_scan(simulator.known_pose(name), simulator.scan(name))
        poses = {name: simulator.known_pose(name) for name in simulator.vehicles}
        snapshots = {name: VehicleSnapshot(pose) for name, pose in poses.items()}
        memory.begin()
        if profile and cycle >= WARM:
            profiler.enable()
        begun = time.process_time()
        result = planner.plan(grid, simulator.time, snapshots)
        times.append(time.process_time() - begun)
        profiler.disable()
        memory.end()
        for name in simulator.vehicles:
            if result.plans.get(name) is not plans.get(name):
                simulator.set_plan(name, result.plans.get(name))
        plans = dict(result.plans)
    warm = times[WARM:]
    load = os.getloadavg()[0]
    print(
        f'{side * side / 1e6:.0f} Mcells, {vehicles} vehicles: first cycle {times[0]:.2f} s, warm '
        f'{np.median(warm):.3f} s (median of {cycles}; {min(warm):.3f} to {max(warm):.3f}), '
        f'{memory.peak:.0f} MB above the grid; {len(result.frontiers)} frontiers, '
        f'{len(plans)} plans, load {load:.1f}',
        flush=True,
    )
    if profile:
        pstats.Stats(profiler).sort_stats('tottime').print_stats(25)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--side', type=float, default=200.0, help='of the map (m)')
    parser.add_argument('--vehicles', default='4,16')
    parser.add_argument('--cycles', type=int, default=5)
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--profile', action='store_true')
    arguments = parser.parse_args()
    print(f'{platform.machine()}, {os.cpu_count()} CPUs')
    warm_up()
    for vehicles in map(int, arguments.vehicles.split(',')):
        measure(
            round(arguments.side / RESOLUTION),
            vehicles,
            arguments.cycles,
            arguments.seed,
            arguments.profile,
        )


if __name__ == '__main__':
    main()
