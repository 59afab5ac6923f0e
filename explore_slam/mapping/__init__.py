"""Scans along the best particle's path -> occupancy grid; scan matching; map files."""

import numpy as np

from explore_slam.data import LaserScan
from explore_slam.geometry import IDENTITY
from explore_slam.mapping.config import GridConfig, ScanMatchingConfig
from explore_slam.mapping.laser_map import MAP_FRAME, Body, KeyframeScan, LaserMap, RedrawSummary
from explore_slam.mapping.map_files import load_map, read_pgm, save_map
from explore_slam.mapping.occupancy_grid import OccupancyGrid
from explore_slam.mapping.scan_matcher import ScanMatch, ScanMatcher

__all__ = [
    'MAP_FRAME',
    'Body',
    'GridConfig',
    'KeyframeScan',
    'LaserMap',
    'OccupancyGrid',
    'RedrawSummary',
    'ScanMatch',
    'ScanMatcher',
    'ScanMatchingConfig',
    'load_map',
    'read_pgm',
    'save_map',
    'warm_up',
]


def warm_up() -> None:
    """Compile every kernel of the package, so that no later call waits for the compiler."""
    grid = OccupancyGrid()
    scan = LaserScan(0.0, 0.0, 0.1, np.array([1.0, 2.0], np.float32), 0.0, 10.0)
    grid.insert_scan(IDENTITY, scan, [(1.0, 0.0, 0.2)])
    matcher = ScanMatcher(ScanMatchingConfig())
    wall = np.full(361, 2.0, np.float32)
    sweep = LaserScan(0.0, -1.5, 0.01, wall, 0.0, 10.0)
    for _ in range(2):
        matcher.match(sweep, IDENTITY, IDENTITY, 1e-4 * np.eye(3))
