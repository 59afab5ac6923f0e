"""Short paths of two vehicles with the simulated Kinect, rendered once."""

import pytest

from explore_slam.simulation import world_path
from explore_slam.studies.experiments.kinect_walks import Walk, record_walk


@pytest.fixture(scope='session')
def small_walks() -> list[Walk]:
    world = world_path('small')
    return [
        record_walk(world, 'robot1', [(0.8, 2.0), (1.8, 2.0)], 0.5),
        record_walk(world, 'robot2', [(1.8, 2.2), (0.8, 2.2)], 0.5),
    ]
