"""Build an occupancy grid from laser scans at known poses and save it for nav2's map_server.

python examples/occupancy_grid.py [--output MAP]      writes MAP.pgm and MAP.yaml

The scans are those of a 180-degree laser that drives around a pillar in a room of 8 x 6 m.
"""

import argparse
import math
from pathlib import Path

import numpy as np

from explore_slam.data import LaserScan
from explore_slam.geometry import Pose2
from explore_slam.mapping import OccupancyGrid, save_map

WALLS = (-4.0, -3.0, 4.0, 3.0)  # x and y of the room's corners (m)
PILLAR = (0.0, 0.0, 0.5)  # x, y, radius (m)
BEAMS = 361


def scan_from(stamp: float, pose: Pose2) -> LaserScan:
    """Return what the laser at a pose measures: the nearer of wall and pillar, per beam."""
    angles = np.linspace(-math.pi / 2, math.pi / 2, BEAMS)
    c, s = np.cos(angles + pose.theta), np.sin(angles + pose.theta)
    with np.errstate(divide='ignore'):
        to_x = np.where(c > 0.0, WALLS[2] - pose.x, WALLS[0] - pose.x) / c
        to_y = np.where(s > 0.0, WALLS[3] - pose.y, WALLS[1] - pose.y) / s
    ranges = np.minimum(to_x, to_y)
    x, y, radius = PILLAR
    along = c * (x - pose.x) + s * (y - pose.y)
    depth = radius**2 - ((x - pose.x) ** 2 + (y - pose.y) ** 2 - along**2)
    hit = (along > 0.0) & (depth > 0.0)
    ranges[hit] = np.minimum(ranges[hit], along[hit] - np.sqrt(depth[hit]))
    return LaserScan(
        stamp=stamp,
        angle_min=-math.pi / 2,
        angle_increment=math.pi / (BEAMS - 1),
        ranges=ranges.astype(np.float32),
        range_min=0.05,
        range_max=8.0,
    )


def main() -> None:
    """Insert scans from a circle around the pillar, save and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--output', type=Path, default=Path('pillar_map'))
    output = parser.parse_args().output

    grid = OccupancyGrid()
    for number, angle in enumerate(np.linspace(0.0, 2.0 * math.pi, 40).tolist()):
        pose = Pose2(2.0 * math.cos(angle), 2.0 * math.sin(angle), angle + math.pi / 2)
        grid.insert_scan(pose, scan_from(float(number), pose))

    occupied = grid.known() & (grid.probability() > 0.65)
    area = grid.resolution**2
    print(
        f'{grid.shape[1]} x {grid.shape[0]} cells of {grid.resolution} m: '
        f'{area * (grid.known() & ~occupied).sum():.1f} m² free, '
        f'{area * occupied.sum():.1f} m² occupied'
    )
    print(f'saved: {save_map(grid, output)}')


if __name__ == '__main__':
    main()
