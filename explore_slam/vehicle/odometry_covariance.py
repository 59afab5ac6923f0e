"""Covariance of the odometry pose, propagated from reading to reading."""

import math

import numpy as np

from explore_slam.geometry import Array, Pose2, rotated
from explore_slam.vehicle.driver_config import BaseNoiseConfig

_SIDEWAYS = 0.1  # variance across the direction of travel relative to that along it: wheels slip


class OdometryCovariance:
    """Covariance of the pose error, with variances proportional to distance and rotation.

    It is kept in the vehicle frame, where a heading error turns into a position error only as the
    vehicle drives on.
    """

    def __init__(self, config: BaseNoiseConfig) -> None:
        self._config = config
        self._covariance = np.zeros((3, 3))

    def propagate(self, increment: Pose2) -> None:
        """Propagate by the increment between two readings (vehicle frame)."""
        c = self._config
        distance = math.hypot(increment.x, increment.y)
        turn = abs(increment.theta)
        if distance == 0.0 and turn == 0.0:
            return
        cosine, sine = math.cos(increment.theta), math.sin(increment.theta)
        # the error transforms with the adjoint of the inverse increment: e' = Ad(u⁻¹) e + noise
        f = np.array(
            [
                [cosine, sine, cosine * -increment.y + sine * increment.x],
                [-sine, cosine, sine * increment.y + cosine * increment.x],
                [0.0, 0.0, 1.0],
            ]
        )
        noise = np.diag(
            [
                c.base_distance_variance * distance,
                _SIDEWAYS * c.base_distance_variance * distance,
                c.base_heading_variance_turn * turn + c.base_heading_variance_distance * distance,
            ]
        )
        self._covariance = f @ self._covariance @ f.T + noise

    @property
    def in_vehicle_frame(self) -> Array:
        """Covariance (3, 3) in the vehicle frame, by which it can be restored."""
        return self._covariance

    def restore(self, covariance: Array) -> None:
        """Continue from a covariance (3, 3) in the vehicle frame."""
        self._covariance = covariance.copy()

    def value(self, pose: Pose2) -> Array:
        """Return the covariance (3, 3) of x, y (m²) and heading (rad²) in the odometry frame."""
        return rotated(self._covariance, -pose.theta)
