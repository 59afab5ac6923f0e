"""The simulated base: differential drive with limited accelerations, and noisy wheel odometry.

Odometry noise is that of the paper (table I): a step of 0.5 m has the standard deviations
5/100 * 0.5 m * sigma along x and 3 pi / 180 * sigma in heading, with sigma = 0.5. Variances of
independent steps add up, so per metre they are (0.0125 m)² / 0.5 m = 3.125e-4 m² and
(0.0262 rad)² / 0.5 m = 1.371e-3 rad². A rotation by pi / 2 has the same heading deviation:
(0.0262 rad)² / (pi / 2) = 4.363e-4 rad² per rad.
"""

import math

import numpy as np

from explore_slam.geometry import IDENTITY, Array, Pose2
from explore_slam.simulation.config import SimulatedBaseConfig, SimulatedOdometryConfig


def arc(linear: float, angular: float, seconds: float) -> Pose2:
    """Return the increment of a motion with constant speed (m/s) and turn rate (rad/s)."""
    turn, distance = angular * seconds, linear * seconds
    if abs(turn) < 1e-9:
        return Pose2(distance, 0.0, turn)
    radius = distance / turn
    return Pose2(radius * math.sin(turn), radius * (1.0 - math.cos(turn)), turn)


class DifferentialDrive:
    """Speed and turn rate that follow commands within limits of velocity and acceleration."""

    def __init__(self, config: SimulatedBaseConfig) -> None:
        self._config = config
        self._target = (0.0, 0.0)
        self.linear = 0.0
        self.angular = 0.0

    def command(self, linear: float, angular: float) -> None:
        """Set target speed (m/s) and turn rate (rad/s); both are clamped to the limits."""
        fastest, turn = self._config.simulated_max_speed, self._config.simulated_max_turn_rate
        self._target = (
            min(max(linear, -fastest), fastest),
            min(max(angular, -turn), turn),
        )

    def advance(self, seconds: float) -> Pose2:
        """Integrate over a time step (s); return the increment in the vehicle frame."""
        config = self._config
        self.linear = _towards(
            self.linear, self._target[0], config.simulated_acceleration * seconds
        )
        self.angular = _towards(
            self.angular, self._target[1], config.simulated_turn_acceleration * seconds
        )
        return arc(self.linear, self.angular, seconds)

    def stall(self) -> None:
        """Set the speed to zero: an obstacle stopped the vehicle."""
        self.linear = 0.0


def _towards(value: float, target: float, change: float) -> float:
    return min(max(target, value - change), value + change)


class WheelOdometry:
    """Pose integrated from noisy increments, with its covariance (3, 3) in the odometry frame."""

    def __init__(self, config: SimulatedOdometryConfig, rng: np.random.Generator) -> None:
        self._config = config
        self._rng = rng
        self.pose = IDENTITY
        self.covariance: Array = np.zeros((3, 3))

    def move(self, increment: Pose2) -> None:
        """Add the true increment of one time step, with noise."""
        config = self._config
        distance = math.hypot(increment.x, increment.y)
        if distance == 0.0 and increment.theta == 0.0:
            return
        distance_variance = config.simulated_distance_variance * distance
        heading_variance = config.simulated_drift_variance * distance
        heading_variance += config.simulated_turn_variance * abs(increment.theta)
        along, turned = self._rng.standard_normal(2)
        measured = Pose2(
            increment.x + float(along) * math.sqrt(distance_variance),
            increment.y,
            increment.theta + float(turned) * math.sqrt(heading_variance),
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
