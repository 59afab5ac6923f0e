"""The blacklist: radius, expiry, giving up, forgiveness."""

import numpy as np

from explore_slam.exploration.blacklist import Blacklist
from explore_slam.exploration.sections import BlacklistConfig
from explore_slam.mapping import OccupancyGrid


def grid_with(share):
    known = np.zeros((60, 60), bool)
    known[:, : int(60 * share)] = True
    return OccupancyGrid.from_probability(np.full((60, 60), 0.1), known)


def blacklist(**values):
    return Blacklist(BlacklistConfig(**{'blacklist_expiry': 10.0, **values}))


PLACE = (1.5, 1.5)


def fail(entries, now, grid, **how):
    entries.report(PLACE, **how)
    entries.update(now, grid, grid.known())


def test_targets_within_the_radius_are_left_alone_until_they_expire():
    entries, grid = blacklist(blacklist_radius=0.4), grid_with(0.5)
    fail(entries, 100.0, grid)
    assert entries.blocks(PLACE, 105.0)
    assert entries.blocks((1.8, 1.5), 105.0)
    assert not entries.blocks((2.0, 1.5), 105.0)
    assert not entries.blocks(PLACE, 110.0)


def test_every_failure_doubles_the_time_and_after_some_it_is_given_up():
    entries, grid = blacklist(maximum_attempts=3), grid_with(0.5)
    fail(entries, 0.0, grid)
    fail(entries, 10.0, grid)
    assert entries.blocks(PLACE, 29.0)
    assert not entries.blocks(PLACE, 30.0)
    assert not entries.gave_up(PLACE)
    fail(entries, 30.0, grid)
    assert entries.gave_up(PLACE)
    assert entries.blocks(PLACE, 1e9)


def test_a_change_of_the_map_there_is_forgiveness_and_one_elsewhere_is_not():
    entries, grid = blacklist(maximum_attempts=1), grid_with(0.5)
    fail(entries, 0.0, grid)
    far = grid_with(0.5).known().copy()
    far[0, 59] = True
    entries.update(0.0, grid, far)
    assert entries.gave_up(PLACE)
    entries.update(0.0, grid, grid_with(0.6).known())
    assert not entries.blocks(PLACE, 1.0)


def test_success_is_forgiveness():
    entries, grid = blacklist(), grid_with(0.5)
    fail(entries, 0.0, grid)
    entries.clear((1.6, 1.5))
    assert len(entries) == 0


def test_a_final_failure_is_given_up_at_once():
    entries, grid = blacklist(maximum_attempts=3), grid_with(0.5)
    fail(entries, 0.0, grid, final=True)
    assert entries.gave_up(PLACE)
    assert entries.blocks(PLACE, 1e9)


def test_a_report_counts_from_the_next_update_on_and_once():
    entries, grid = blacklist(), grid_with(0.5)
    entries.report(PLACE)
    assert not entries.blocks(PLACE, 0.0)
    for _ in range(5):
        entries.update(0.0, grid, grid.known())
    assert entries.blocks(PLACE, 9.9)
    assert not entries.blocks(PLACE, 10.0)


def test_of_several_failures_near_a_place_the_worst_one_counts():
    entries, grid = blacklist(blacklist_radius=0.5, maximum_attempts=2), grid_with(0.5)
    far, near = (1.0, 1.5), (1.6, 1.5)
    for place in (near, far, far):
        entries.report(place)
        entries.update(0.0, grid, grid.known())
    assert len(entries) == 2
    assert entries.gave_up((1.4, 1.5))
    assert entries.gave_up((0.6, 1.5))
    assert not entries.gave_up((1.9, 1.5))


def test_a_small_change_of_the_map_is_no_forgiveness_and_the_area_grows_with_the_radius():
    grid = grid_with(0.5)
    for radius, cells, kept in (
        (0.4, 21, True),
        (0.4, 22, False),
        (0.8, 84, True),
        (0.8, 85, False),
    ):
        entries = blacklist(blacklist_radius=radius)
        fail(entries, 0.0, grid)
        free = grid.known().copy()
        half = round(2.0 * radius / 0.05)
        low = max(0, 30 - half)
        window = free[low : 30 + half + 1, low : 30 + half + 1]
        window[tuple(np.argwhere(~window)[:cells].T)] = True
        entries.update(1.0, grid, free)
        assert (len(entries) == 1) is kept


def test_what_one_vehicle_cannot_reach_is_left_to_the_others():
    entries, grid = blacklist(maximum_attempts=1), grid_with(1.0)
    fail(entries, 0.0, grid, vehicle='a')
    assert entries.gave_up(PLACE, 'a')
    assert not entries.gave_up(PLACE, 'b')
    assert not entries.blocks(PLACE, 1.0, 'b')
    assert entries.blocks(PLACE, 1.0)  # for some vehicle
    fail(entries, 1.0, grid, final=True)
    assert entries.gave_up(PLACE, 'b')
