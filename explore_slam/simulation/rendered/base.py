"""The simulated base: differential drive with limited accelerations."""

import math

from explore_slam.geometry import Pose2
from explore_slam.simulation.config import SimulatedBaseConfig


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
