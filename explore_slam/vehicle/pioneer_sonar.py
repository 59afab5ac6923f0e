"""Sonar of a Pioneer: readings to points in the vehicle frame."""

from collections.abc import Mapping, Sequence

import numpy as np

from explore_slam.geometry import Array, Pose2
from explore_slam.vehicle.pioneer_models import MODELS

SONAR_POSES = MODELS['p3dx'].sonar
SONAR_RANGE = 5.0  # m, reading of ARCOS without an echo


def sonar_points(readings: Mapping[int, float], poses: Sequence[Pose2] = SONAR_POSES) -> Array:
    """Return the echoes (N, 2) m in the vehicle frame for transducer index -> range (m).

    poses: of the transducers, by index; readings of others are left out.
    """
    points = [
        poses[index].compose(Pose2(distance, 0.0, 0.0))[:2]
        for index, distance in readings.items()
        if index < len(poses) and 0.0 < distance < SONAR_RANGE
    ]
    return np.array(points, dtype=np.float64).reshape(-1, 2)
