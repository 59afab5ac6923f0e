"""After warm_up no planning cycle and no scan waits for the compiler."""

import importlib
import pkgutil
from dataclasses import replace

import numpy as np
import pytest
from exploration_maps import grid_of, point_of

from explore_slam import exploration, mapping
from explore_slam.data import LaserScan
from explore_slam.exploration import (
    ExplorationConfig,
    Planner,
    VehicleSnapshot,
    make_cost_map,
)
from explore_slam.exploration.camera_views import find_unviewed
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.mapping import OccupancyGrid
from explore_slam.settings import with_values

HALL = """
????????????????????????
########...#############
#......................#
#......................?
#......................?
########################
"""


def signatures():
    found = {}
    for room in (exploration, mapping):
        for item in pkgutil.iter_modules(room.__path__):
            module = importlib.import_module(f'{room.__name__}.{item.name}')
            for name, value in vars(module).items():
                if hasattr(value, 'signatures'):
                    found[f'{module.__name__}.{name}'] = [str(s) for s in value.signatures]
    return found


@pytest.mark.parametrize('strategy', ['default', 'paper', 'nearest'])
def test_nothing_is_compiled_after_warm_up(strategy):
    exploration.warm_up()
    mapping.warm_up()
    before = signatures()
    assert len(before) > 15
    grid = grid_of(HALL, cells_per_letter=4)
    config = with_values(ExplorationConfig(), {'strategy': strategy})
    vehicles = {
        name: VehicleSnapshot(Pose2(*point_of(3, col, HALL, cells_per_letter=4), 0.0))
        for name, col in {'a': 3, 'b': 8, 'c': 14}.items()
    }
    assert Planner(config).plan(grid, 0.0, vehicles).plans
    unviewed = np.ones(grid.shape, np.bool_)
    for side in (8, 80):  # an area that is visited as a whole, and one in pieces
        unviewed[8 : 8 + side, 8 : 8 + side] = False
        costs = make_cost_map(grid, config.paths)
        reach = np.isfinite(costs.cost)
        settings = replace(config.frontiers, min_unviewed_area=1.0)
        assert find_unviewed(grid, costs, unviewed, reach, settings)
    scan = LaserScan(0.0, 0.0, 0.1, np.array([2.0, np.inf], np.float32), 0.1, 30.0)
    drawn = OccupancyGrid()
    drawn.insert_scan(IDENTITY, scan)
    drawn.insert_scan(IDENTITY, scan, [(2.0, 0.0, 0.3)])
    new = {
        name: found for name, found in signatures().items() if not set(found) <= set(before[name])
    }
    # Loops that are only called by other loops are compiled with these.
    assert not [name for name in new if before[name]]
