"""Sonar readings of a Pioneer as points in the vehicle frame."""

import numpy as np
import pytest

from explore_slam.vehicle.pioneer_sonar import sonar_points


def test_sonar_readings_become_points_by_transducer():
    assert sonar_points({}).shape == (0, 2)
    assert sonar_points({0: 1.0}) == pytest.approx(np.array([[0.069, 1.136]]))
    assert sonar_points({8: 2.0}) == pytest.approx(np.array([[-0.157, -2.136]]))
    assert len(sonar_points({15: 0.5, 16: 0.5, 1: 0.0, 2: 5.0, 3: 4.99})) == 2
