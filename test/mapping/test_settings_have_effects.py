"""Every setting of the occupancy grid changes it; a new one without a test fails here."""

import numpy as np
import pytest

from explore_slam.data import LaserScan
from explore_slam.geometry import Pose2
from explore_slam.mapping import GridConfig, LaserMap, OccupancyGrid
from explore_slam.settings import settings_of, with_values


def scan():
    """Beams that end on walls near and far, and beams without return."""
    ranges = np.tile(np.array([2.02, 9.0, 25.0, np.inf], np.float32), 10)
    return LaserScan(0.0, -1.0, 0.05, ranges, 0.1, 30.0)


def drawn(config, scans=40):
    """Draw the same scan again and again."""
    grid = OccupancyGrid(config)
    for _ in range(scans):
        grid.insert_scan(Pose2(0.0, 0.0, 0.3), scan())
    return grid


def grid_of_one_scan(config):
    grid = drawn(config, scans=1)
    return grid.probability().tobytes(), grid.known().tobytes()


def grid_of_many_scans(config):
    return drawn(config).probability().tobytes()


def map_in_three_values(config):
    """Return free, occupied and unknown cells where probabilities are between the extremes."""
    probability = np.linspace(0.05, 0.95, 91)[None]
    return (
        OccupancyGrid.from_probability(
            probability, np.ones(probability.shape, np.bool_), (0.0, 0.0), config
        )
        .to_trinary()
        .tolist()
    )


def laser_map_of_a_long_drive(config):
    """Return how many scans lie too far out, and how many a late change draws again."""
    laser_map, path = LaserMap(config), np.zeros((48, 3))
    path[:, 0] = np.arange(48)
    for keyframe in range(48):
        laser_map.add(keyframe, 'a', scan())
    first = laser_map.redraw(path)
    path[-1, 1] = 0.5
    return first.refused, laser_map.redraw(path).drawn


def laser_map_without_long_beams(config):
    """Return which cells are known where many beams have no return and none is long."""
    laser_map = LaserMap(config)
    ranges = np.tile(np.array([2.02, 3.0, 1.0, np.inf], np.float32), 200)
    laser_map.add(0, 'a', LaserScan(0.0, -1.0, 0.005, ranges, 0.1, 30.0))
    laser_map.redraw(np.zeros((1, 3)))
    return laser_map.grid.known().tobytes()


EFFECTS = {
    'resolution': (0.1, grid_of_one_scan),
    'max_laser_range': (5.0, grid_of_one_scan),
    'no_return_range': (4.0, grid_of_one_scan),
    'no_return_meaning': ('free', laser_map_without_long_beams),
    'hit_probability': (0.9, grid_of_one_scan),
    'miss_probability': (0.2, grid_of_one_scan),
    'clamp_low': (0.1, grid_of_many_scans),
    'clamp_high': (0.9, grid_of_many_scans),
    'map_free_threshold': (0.3, map_in_three_values),
    'map_occupied_threshold': (0.8, map_in_three_values),
    'maximum_map_side': (30.0, laser_map_of_a_long_drive),
    'snapshot_memory': (0.0, laser_map_of_a_long_drive),
}


@pytest.mark.parametrize('name', [info.name for info, _ in settings_of(GridConfig())])
def test_every_setting_changes_the_grid(name):
    value, experiment = EFFECTS[name]
    usual = GridConfig()
    assert experiment(usual) == experiment(usual)
    assert experiment(usual) != experiment(with_values(usual, {name: value}))


def test_no_effect_is_listed_for_a_setting_that_does_not_exist():
    assert EFFECTS.keys() == {info.name for info, _ in settings_of(GridConfig())}
