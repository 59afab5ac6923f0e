"""Sonar rings of a Pioneer 3-DX: readings to points in the vehicle frame."""

import math
from collections.abc import Mapping

import numpy as np

from explore_slam.geometry import Array, Pose2

# x, y (mm), bearing (°) of transducers 0-7 (front) and 8-15 (rear): SonarUnit lines of the robot
# parameter file p3dx.p of ARIA
_FRONT_RING = (
    (69, 136, 90), (114, 119, 50), (148, 78, 30), (166, 27, 10),
    (166, -27, -10), (148, -78, -30), (114, -119, -50), (69, -136, -90),
)  # fmt: skip
_REAR_RING = (
    (-157, -136, -90), (-203, -119, -130), (-237, -78, -150), (-255, -27, -170),
    (-255, 27, 170), (-237, 78, 150), (-203, 119, 130), (-157, 136, 90),
)  # fmt: skip
SONAR_POSES = tuple(
    Pose2(0.001 * x, 0.001 * y, math.radians(bearing))
    for x, y, bearing in _FRONT_RING + _REAR_RING
)
SONAR_RANGE = 5.0  # m, reading of ARCOS without an echo


def sonar_points(readings: Mapping[int, float]) -> Array:
    """Return the echoes (N, 2) m in the vehicle frame for transducer index -> range (m)."""
    points = [
        SONAR_POSES[index].compose(Pose2(distance, 0.0, 0.0))[:2]
        for index, distance in readings.items()
        if index < len(SONAR_POSES) and 0.0 < distance < SONAR_RANGE
    ]
    return np.array(points, dtype=np.float64).reshape(-1, 2)
