"""Real-time factor of the grid world simulator, without planning.

Usage: python benchmarks/grid_world_speed.py MAP [--vehicles 4] [--seconds 300]
"""

import argparse
import math
import time
from pathlib import Path

import numpy as np

from explore_slam.data import Plan
from explore_slam.geometry import Pose2
from explore_slam.simulation.grid.grid_simulator import GridSimulator, warm_up
from explore_slam.simulation.worlds.loading import load_grid_world

SCAN_EVERY = 5  # ticks of 0.1 s


def wander(simulator: GridSimulator, rng: np.random.Generator) -> None:
    """Give idle and stalled vehicles a straight path of 4 m in a random direction."""
    for vehicle in simulator.vehicles:
        if simulator.is_idle(vehicle) or simulator.stalled_for(vehicle) > 3.0:
            x, y, _ = simulator.true_pose(vehicle)
            angle = rng.uniform(-math.pi, math.pi)
            end = Pose2(x + 4.0 * math.cos(angle), y + 4.0 * math.sin(angle), 0.0)
            points = np.array([(x, y), end[:2]])
            simulator.set_plan(vehicle, Plan(simulator.time, vehicle, end, points))


def main() -> None:
    """Print the real-time factor for each team size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('map', type=Path)
    parser.add_argument('--vehicles', type=int, nargs='+', default=[1, 2, 4, 8])
    parser.add_argument('--seconds', type=float, default=300.0)
    arguments = parser.parse_args()
    world = load_grid_world(arguments.map)
    warm_up()
    for count in arguments.vehicles:
        poses = world.start_poses(count, 0, 0.3)
        starts = {f'robot{index + 1}': pose for index, pose in enumerate(poses)}
        simulator = GridSimulator(world, starts)
        rng = np.random.default_rng(0)
        begun, ticks, scans = time.process_time(), 0, 0
        while simulator.time < arguments.seconds:
            wander(simulator, rng)
            simulator.step()
            ticks += 1
            if ticks % SCAN_EVERY == 0:
                scans += sum(1 for vehicle in simulator.vehicles if simulator.scan(vehicle))
        spent = time.process_time() - begun
        print(
            f'{count} vehicles: {arguments.seconds / spent:.0f} x real time '
            f'({scans} scans of {simulator.config.beams} beams, {spent:.2f} s of CPU, '
            f'{len(simulator.collisions)} collisions)'
        )


if __name__ == '__main__':
    main()
