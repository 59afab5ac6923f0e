"""Scans along the most likely path -> occupancy grid; map files."""

import numpy as np

from explore_slam.data import LaserScan, ObstacleView
from explore_slam.geometry import IDENTITY
from explore_slam.mapping.config import GridConfig
from explore_slam.mapping.laser_map import KeyframeScan, LaserMap
from explore_slam.mapping.map_files import load_map, save_map
from explore_slam.mapping.map_images import read_image
from explore_slam.mapping.obstacle_map import (
    ObstacleGrid,
    ObstacleMap,
    PlacedView,
    cells_looked_at,
    with_obstacles,
)
from explore_slam.mapping.occupancy_grid import OccupancyGrid
from explore_slam.mapping.path_drawing import MAP_FRAME, RedrawSummary, VehicleDisc

__all__ = [
    'MAP_FRAME',
    'GridConfig',
    'KeyframeScan',
    'LaserMap',
    'ObstacleGrid',
    'ObstacleMap',
    'OccupancyGrid',
    'PlacedView',
    'RedrawSummary',
    'VehicleDisc',
    'cells_looked_at',
    'load_map',
    'read_image',
    'save_map',
    'warm_up',
    'with_obstacles',
]


def warm_up() -> None:
    """Compile every kernel of the package, so that no later call waits for the compiler."""
    grid = OccupancyGrid()
    scan = LaserScan(0.0, 0.0, 0.1, np.array([1.0, 2.0], np.float32), 0.0, 10.0)
    grid.insert_scan(IDENTITY, scan, [(1.0, 0.0, 0.2)])
    bits = np.ones(1, np.uint16)
    view = ObstacleView(0.0, np.zeros((1, 2), np.int16), bits, bits)
    ObstacleGrid().insert(PlacedView(IDENTITY, view))
