"""The blacklist: radius, expiry, giving up, forgiveness."""

import numpy as np

from explore_slam.exploration.blacklist import Blacklist
from explore_slam.exploration.config import BlacklistConfig
from explore_slam.mapping import OccupancyGrid


def grid_with(share):
    known = np.zeros((60, 60), bool)
    known[:, : int(60 * share)] = True
    return OccupancyGrid.from_probability(np.full((60, 60), 0.1), known)


def blacklist(**values):
    return Blacklist(BlacklistConfig(**{'blacklist_expiry': 10.0, **values}))


PLACE = (1.5, 1.5)


def test_targets_within_the_radius_are_left_alone_until_they_expire():
    entries, grid = blacklist(blacklist_radius=0.4), grid_with(0.5)
    entries.add(PLACE, 100.0, grid, grid.known())
    assert entries.blocks(PLACE, 105.0)
    assert entries.blocks((1.8, 1.5), 105.0)
    assert not entries.blocks((2.0, 1.5), 105.0)
    assert not entries.blocks(PLACE, 110.0)


def test_every_failure_doubles_the_time_and_after_some_it_is_given_up():
    entries, grid = blacklist(maximum_attempts=3), grid_with(0.5)
    entries.add(PLACE, 0.0, grid, grid.known())
    entries.add(PLACE, 10.0, grid, grid.known())
    assert entries.blocks(PLACE, 29.0)
    assert not entries.blocks(PLACE, 30.0)
    assert not entries.gave_up(PLACE)
    entries.add(PLACE, 30.0, grid, grid.known())
    assert entries.gave_up(PLACE)
    assert entries.blocks(PLACE, 1e9)


def test_a_change_of_the_map_there_is_forgiveness_and_one_elsewhere_is_not():
    entries, grid = blacklist(maximum_attempts=1), grid_with(0.5)
    entries.add(PLACE, 0.0, grid, grid.known())
    far = grid_with(0.5).known().copy()
    far[0, 59] = True
    entries.refresh(grid, far)
    assert entries.gave_up(PLACE)
    entries.refresh(grid, grid_with(0.6).known())
    assert not entries.blocks(PLACE, 1.0)


def test_success_is_forgiveness():
    entries, grid = blacklist(), grid_with(0.5)
    entries.add(PLACE, 0.0, grid, grid.known())
    entries.clear((1.6, 1.5))
    assert len(entries) == 0
