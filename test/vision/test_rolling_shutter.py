"""Features seen by a rolling shutter in motion: covariances against drawn moments of exposure."""

import numpy as np
import pytest

from explore_slam.data import LandmarkObservations
from explore_slam.geometry import Pose2
from explore_slam.vision.rolling_shutter import with_readout_noise

READOUT = 0.03
VELOCITY = np.array([0.4, 0.05, 0.8])


def observations():
    random = np.random.default_rng(0)
    places = random.uniform([0.5, -2.0, 0.0], [3.0, 2.0, 1.5], (20, 3))
    covariances = np.broadcast_to(np.diag([4e-4, 1e-4, 1e-4]), (20, 3, 3))
    return LandmarkObservations(1.0, places, covariances, np.zeros((20, 128), np.float32))


def test_covariances_are_those_of_features_from_any_row():
    seen = observations()
    found = with_readout_noise(seen, VELOCITY, READOUT)
    drawn = []
    for late in READOUT * (np.linspace(0.0, 1.0, 2001) - 0.5):
        x, y, theta = VELOCITY * late
        moved = Pose2(x, y, theta).inverse()
        c, s = np.cos(moved.theta), np.sin(moved.theta)
        rows = seen.positions.copy()
        rows[:, :2] = seen.positions[:, :2] @ [[c, s], [-s, c]] + [moved.x, moved.y]
        drawn.append(rows - seen.positions)
    spread = np.einsum('kni,knj->nij', drawn, drawn) / len(drawn)
    np.testing.assert_allclose(found.covariances - seen.covariances, spread, atol=2e-6)
    assert spread.max() > 5e-5  # a turn tells
    np.testing.assert_array_equal(found.positions, seen.positions)


@pytest.mark.parametrize(('velocity', 'readout'), [(VELOCITY, 0.0), (np.zeros(3), READOUT)])
def test_at_rest_or_with_a_global_shutter_nothing_changes(velocity, readout):
    seen = observations()
    assert with_readout_noise(seen, velocity, readout) is seen


def test_no_features_stay_none():
    assert not len(with_readout_noise(LandmarkObservations.empty(1.0), VELOCITY, READOUT))
