"""Noisy wheel odometry of the simulators.

The noise is that of the paper (table I): a step of 0.5 m has the standard deviations
5/100 * 0.5 m * sigma along x and 3 pi / 180 * sigma in heading, with sigma = 0.5. Variances of
independent steps add up, so per metre they are (0.0125 m)² / 0.5 m = 3.125e-4 m² and
(0.0262 rad)² / 0.5 m = 1.371e-3 rad². A rotation by pi / 2 has the same heading deviation:
(0.0262 rad)² / (pi / 2) = 4.363e-4 rad² per rad.
"""

import math

import numpy as np

from explore_slam.geometry import IDENTITY, Array, Pose2
from explore_slam.simulation.config import SimulatedOdometryConfig


class WheelOdometry:
    """Pose integrated from noisy increments, with its covariance (3, 3) in the odometry frame."""

    def __init__(self, config: SimulatedOdometryConfig, rng: np.random.Generator) -> None:
        self._config = config
        self._rng = rng
        self.pose = IDENTITY
        self.covariance: Array = np.zeros((3, 3))

    def move(self, increment: Pose2) -> None:
        """Add the true increment of one time step, with its systematic errors and noise."""
        config = self._config
        distance = math.hypot(increment.x, increment.y)
        if distance == 0.0 and increment.theta == 0.0:
            return
        distance_variance = config.simulated_distance_variance * distance
        heading_variance = config.simulated_drift_variance * distance
        heading_variance += config.simulated_turn_variance * abs(increment.theta)
        along, turned = self._rng.standard_normal(2)
        scale = 1.0 + config.simulated_distance_scale
        turn = increment.theta * (1.0 + config.simulated_turn_scale)
        turn += config.simulated_heading_drift * increment.x
        measured = Pose2(
            increment.x * scale + float(along) * math.sqrt(distance_variance),
            increment.y * scale,
            turn + float(turned) * math.sqrt(heading_variance),
        )
        cos, sin = math.cos(self.pose.theta), math.sin(self.pose.theta)
        moved = self.pose.compose(measured)
        jacobian = np.eye(3)
        jacobian[0, 2], jacobian[1, 2] = self.pose.y - moved.y, moved.x - self.pose.x
        added = np.zeros((3, 3))
        axis = np.array([cos, sin])
        added[:2, :2] = distance_variance * np.outer(axis, axis)
        added[2, 2] = heading_variance
        self.covariance = jacobian @ self.covariance @ jacobian.T + added
        self.pose = moved
