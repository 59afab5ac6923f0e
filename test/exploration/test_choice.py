"""What the choice by tours pays for waiting, and when it drops the tours in force."""

import numpy as np
import pytest

from explore_slam.exploration import ExplorationConfig
from explore_slam.exploration.choice import Chooser
from explore_slam.exploration.clearance import tight_factor
from explore_slam.settings import with_values

GAINS = np.array([0.5, 4.0, 50.0])


def chooser(**values):
    return Chooser(with_values(ExplorationConfig(), values))


def test_waiting_costs_its_weight_for_each_vehicle_whatever_there_is_to_gain():
    for vehicles in (1, 3):
        paid = chooser(waiting_weight=0.7)._urgency(GAINS, vehicles)
        assert paid.sum() == pytest.approx(0.7 * vehicles)
        assert (np.diff(paid) > 0.0).all()


def test_the_floor_makes_targets_alike_and_large_gains_are_cut():
    def spread(**values):
        paid = chooser(**values)._urgency(GAINS, 1)
        return paid[2] / paid[0]

    assert spread(urgency_floor=20.0) < spread(urgency_floor=2.0)
    assert spread(urgent_gain=3.0) < spread(urgent_gain=30.0)
    cut = chooser(urgent_gain=3.0)._urgency(GAINS, 1)
    assert cut[1] == pytest.approx(cut[2])


def test_tours_in_force_are_dropped_for_much_better_ones_only():
    # The vehicle is on its way to 0, and 1 lies a little aside of where it is now.
    starts, zero = np.array([[6.0, 1.0]]), np.zeros(2)
    between = np.array([[0.0, 6.5], [6.5, 0.0]])
    for margin, first in ((10.0, 0), (1.0, 1)):
        tours = chooser(longest_weight=0.0)._solve(
            starts, between, zero, zero, zero, np.array([0]), [[0, 1]], margin
        )
        assert tours.orders[0][0] == first
        assert sorted(tours.orders[0]) == [0, 1]


def test_the_middle_of_a_gap_is_the_cheapest():
    prices = tight_factor(np.array([0.0, 1.0, 2.0, 3.0]), 3.0)
    assert prices.dtype == np.float32
    assert (np.diff(prices) < 0.0).all()
    assert prices[-1] > 1.0
