"""Going back to known places: what it is expected to save, when it begins, and when it ends."""

import math

import numpy as np
import pytest
from exploration_maps import grid_of, point_of

from explore_slam.exploration import ExplorationConfig, KnownPlace, Planner, VehicleSnapshot
from explore_slam.exploration.loop_seeking import loop_savings
from explore_slam.geometry import Pose2
from explore_slam.settings import with_values

CORRIDOR = """
########################################????????
#.......................................????????
#.......................................????????
#.......................................????????
########################################????????
"""
SIDE = 2  # cells of 0.25 m per letter


def place(col):
    return point_of(2, col, CORRIDOR, cells_per_letter=SIDE)


class Corridor:
    """A vehicle in a corridor whose right end is unknown, and the planner that sends it there."""

    def __init__(self, **settings):
        self.planner = Planner(with_values(ExplorationConfig(), {'loop_seeking': True} | settings))
        self.grid = grid_of(CORRIDOR, cells_per_letter=SIDE)
        self.now = 0.0
        self.at = 34

    def goal(self, *places):
        """Return x (m) of the goal, with places (column, deviation in m) that are known."""
        known = tuple(KnownPlace(place(col), deviation) for col, deviation in places)
        snapshot = VehicleSnapshot(Pose2(*place(self.at), 0.0), known_places=known)
        result = self.planner.plan(self.grid, self.now, {'a': snapshot})
        self.now += 2.0
        return result.plans['a'].goal.x


FRONTIER = place(38)[0]  # m; goals beyond lie at the unknown end


def test_savings_are_what_they_are_by_hand():
    saved = loop_savings(
        np.array([5.0, 5.0]), np.array([9.0, 9.0]), 4.0, np.array([0.2, 1e-3]), 0.2
    )
    assert saved[0] == pytest.approx(math.exp(-0.5) * 18.0 - 10.0)
    assert saved[1] == pytest.approx(-10.0)


def test_with_accurate_localization_nothing_changes():
    with_places, without = Corridor(), Corridor()
    for col in (34, 35, 36):
        with_places.at = without.at = col
        assert with_places.goal((24, 0.05), (18, 0.19)) == without.goal()


def test_a_doubtful_place_is_visited_until_the_loop_is_closed():
    corridor = Corridor()
    assert corridor.goal((24, 0.5)) == pytest.approx(place(24)[0], abs=0.3)
    corridor.at = 30
    assert corridor.goal((24, 0.5)) == pytest.approx(place(24)[0], abs=0.3)
    assert corridor.goal((24, 0.05)) > FRONTIER  # closed on the way
    assert corridor.goal((24, 0.05)) > FRONTIER


def test_a_place_visited_in_vain_is_left_until_the_doubt_has_grown():
    corridor = Corridor()
    assert corridor.goal((24, 0.5)) < FRONTIER
    corridor.at = 24
    assert corridor.goal((24, 0.5)) > FRONTIER
    corridor.at = 34
    assert corridor.goal((24, 0.6), (22, 0.6)) > FRONTIER
    assert corridor.goal((24, 0.8)) < FRONTIER


def test_a_vehicle_that_does_not_get_there_gives_up():
    corridor = Corridor()
    goals = [corridor.goal((24, 0.5)) for _ in range(60)]
    assert goals[0] < FRONTIER < goals[-1]


def test_a_way_that_is_too_long_or_saves_nothing_is_not_driven():
    assert Corridor(loop_reach=3.0).goal((24, 0.5)) > FRONTIER
    assert Corridor(loop_seeking=False).goal((24, 0.5)) > FRONTIER
    assert Corridor(map_tolerance=2.0).goal((24, 0.5)) > FRONTIER
    assert Corridor(loop_deviation=0.6).goal((24, 0.5)) > FRONTIER


def test_the_vehicle_drives_on_into_the_known_part():
    places = [(col, 0.5) for col in range(6, 31)]
    # the nearest lies 2 m off; scans overlap 6 m beyond
    assert Corridor().goal(*places) == pytest.approx(place(34)[0] - 8.0, abs=0.8)
