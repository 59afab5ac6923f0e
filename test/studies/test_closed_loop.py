"""Closed loop in one process: reproducibility, accuracy; coverage of the reachable area."""

from pathlib import Path

import numpy as np
import pytest
from grid_worlds import drawn_world
from grids import same_grid

from explore_slam.errors import EvaluationError
from explore_slam.geometry import Pose2
from explore_slam.results.reachable_area import ReachableArea
from explore_slam.settings import with_values
from explore_slam.studies.closed_loop import ClosedLoop, ClosedLoopConfig

SMALL = Path(__file__).resolve().parents[2] / 'config' / 'worlds' / 'small.yaml'
CONFIG = with_values(
    ClosedLoopConfig(),
    {'particles': 60, 'time_limit': 8.0, 'feature_orientation': 'upright'},
)


def test_the_same_seed_gives_the_same_run():
    short = with_values(CONFIG, {'time_limit': 2.5})
    first, second = (ClosedLoop(SMALL, short, vehicles=2, seed=3).run() for _ in range(2))
    assert len(first.landmarks.means) > 20
    assert first.metrics == second.metrics
    assert same_grid(first.grid, second.grid)
    np.testing.assert_array_equal(first.landmarks.means, second.landmarks.means)


def test_vehicles_drive_map_and_know_where_they_are():
    metrics = ClosedLoop(SMALL, CONFIG, vehicles=2, seed=3).run().metrics
    assert metrics['collisions'] == {'robot1': 0, 'robot2': 0}
    assert metrics['coverage'] > 0.5
    assert metrics['mean_online_position_rms'] < 0.05
    assert sum(found['distance'] for found in metrics['vehicles'].values()) > 0.7


def test_reachable_area_is_what_the_vehicle_can_cover():
    world = drawn_world(['########', '#   #  #', '#   #  #', '#   #  #', '########'])
    area = ReachableArea(world, [Pose2(1.0, 1.0, 0.0)], radius=0.2)
    assert area.area == pytest.approx(1.5 * 1.5, abs=0.1)
    known = np.ones((50, 80), np.bool_)
    assert area.explored_fraction(known, 0.05, (0.0, 0.0)) == 1.0
    known[:, :25] = False  # everything left of x = 1.25 m
    assert area.explored_fraction(known, 0.05, (0.0, 0.0)) == pytest.approx(0.5, abs=0.05)
    assert area.explored_fraction(known[:0], 0.05, (0.0, 0.0)) == 0.0
    with pytest.raises(EvaluationError, match='no start pose'):
        ReachableArea(world, [], radius=0.2)
