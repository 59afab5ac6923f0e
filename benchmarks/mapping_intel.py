"""Intel Research Lab: grid map along the reference poses, and agreement of the beams with it.

python benchmarks/mapping_intel.py FOLDER [--output MAP]
FOLDER holds intel_raw_odom_scans.npz and reference_pose_flirt.csv. The reference gives a pose for
510 of the 2726 scans; between these, poses follow odometry with its error distributed linearly.
"""

import argparse
import math
import time
from pathlib import Path

import numpy as np

from explore_slam.data import LaserScan
from explore_slam.geometry import Array, Pose2, between, compose
from explore_slam.mapping import GridConfig, OccupancyGrid, save_map, warm_up

MAX_RANGE = 30.0


def fill_poses(odometry: Array, steps: list[int], reference: Array) -> dict[int, Array]:
    """Return poses by scan: the reference, and between two of its poses corrected odometry."""
    poses: dict[int, Array] = {}
    for i in range(len(steps) - 1):
        first, last = steps[i], steps[i + 1]
        own = between(odometry[first], odometry[first : last + 1])
        rolled = compose(reference[i], own)
        error = between(rolled[-1], reference[i + 1])
        share = np.linspace(0.0, 1.0, last - first + 1)[:, None]
        poses.update(zip(range(first, last + 1), compose(rolled, share * error), strict=True))
    return poses


def load(folder: Path) -> tuple[list[LaserScan], list[int], Array, dict[int, Array]]:
    """Return scans, indices with a reference pose, the reference poses, and poses by index."""
    data = np.load(folder / 'intel_raw_odom_scans.npz')
    ranges = data['ranges'].copy()
    ranges[data['valid'] == 0] = np.nan
    ranges[ranges >= MAX_RANGE] = np.inf
    increment = math.radians(
        1.0
    )  # beams of the SICK laser: the first at -90 degrees, one per degree
    scans = [
        LaserScan(float(k), -math.pi / 2, increment, ranges[k], 0.05, MAX_RANGE)
        for k in range(len(ranges))
    ]
    rows = np.loadtxt(folder / 'reference_pose_flirt.csv', comments='#')
    steps = rows[:, 0].astype(int).tolist()
    poses = fill_poses(data['odom_pose_at_scan'], steps, rows[:, 1:4])
    return scans, steps, rows[:, 1:4], poses


def agreement(
    grid: OccupancyGrid, scans: list[LaserScan], steps: list[int], poses: Array
) -> tuple[float, float, float]:
    """Return fractions of beams that end next to an occupied cell, cross one, and agree in both.

    A beam crosses an obstacle if it enters an occupied cell more than 0.3 m before its end.
    """
    occupied = np.pad(grid.known() & (grid.probability() > 0.5), 1)
    near = np.zeros_like(occupied)
    for dr in (-1, 0, 1):
        for dc in (-1, 0, 1):
            near |= np.roll(occupied, (dr, dc), (0, 1))
    occupied, near = occupied[1:-1, 1:-1], near[1:-1, 1:-1]
    ends = crossed = both = total = 0
    for step, pose in zip(steps, poses, strict=True):
        scan = scans[step]
        ranges = scan.ranges.astype(np.float64)
        used = np.isfinite(ranges) & (ranges < grid.config.max_laser_range)
        headings = pose[2] + scan.angles[used]
        unit = np.stack([np.cos(headings), np.sin(headings)], axis=1)
        end_cells = grid.to_cell(pose[:2] + unit * ranges[used, None])
        hit = near[end_cells[:, 0], end_cells[:, 1]]
        at = np.arange(0.0, grid.config.max_laser_range, grid.resolution / 2)
        samples = grid.to_cell((pose[:2] + unit[:, None] * at[:, None]).reshape(-1, 2)).reshape(
            len(unit), len(at), 2
        )
        samples = np.clip(samples, 0, np.array(grid.shape) - 1)
        before = at[None] < ranges[used, None] - 0.3
        through = (occupied[samples[..., 0], samples[..., 1]] & before).any(axis=1)
        ends += int(hit.sum())
        crossed += int(through.sum())
        both += int((hit & ~through).sum())
        total += len(hit)
    return ends / total, crossed / total, both / total


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('folder', type=Path)
    parser.add_argument('--output', type=Path)
    arguments = parser.parse_args()
    scans, steps, reference, poses = load(arguments.folder)
    warm_up()
    config = GridConfig(resolution=0.05, max_laser_range=20.0, no_return_range=0.0)
    grid = OccupancyGrid(config)
    begun = time.perf_counter()
    for step, pose in zip(steps, reference, strict=True):
        grid.insert_scan(Pose2(*pose.tolist()), scans[step])
    print(f'{len(steps)} scans with reference poses: {time.perf_counter() - begun:.2f} s')
    ends, crossed, both = agreement(grid, scans, steps, reference)
    print(f'grid {grid.shape} cells of {grid.resolution} m')
    print(f'beams that end within a cell of an occupied one: {100 * ends:.1f} %')
    print(f'beams that cross an occupied cell > 0.3 m before their end: {100 * crossed:.1f} %')
    print(f'beams that agree in both: {100 * both:.1f} %')
    full = OccupancyGrid(config)
    begun = time.perf_counter()
    for k, scan in enumerate(scans):  # standing before the first reference pose
        full.insert_scan(Pose2(*poses.get(k, reference[0]).tolist()), scan)
    print(f'all {len(scans)} scans: {time.perf_counter() - begun:.2f} s')
    if arguments.output:
        print(f'map written to {save_map(grid, arguments.output)}')


if __name__ == '__main__':
    main()
