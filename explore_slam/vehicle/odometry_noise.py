"""Covariance of the odometry pose, compounded reading by reading."""

import math

import numpy as np

from explore_slam.geometry import Array, Pose2
from explore_slam.vehicle.driver_config import BaseNoiseConfig


class OdometryCovariance:
    """Grows with what was driven: variance proportional to distance and turn.

    Kept in the frame of the vehicle's present pose (error of the pose as seen from it), where a
    heading error moves positions sideways only when more is driven.
    """

    def __init__(self, config: BaseNoiseConfig) -> None:
        self._config = config
        self._covariance = np.zeros((3, 3))

    def drive(self, increment: Pose2) -> None:
        """Take the increment (vehicle frame) of one reading."""
        c = self._config
        distance = math.hypot(increment.x, increment.y)
        turn = abs(increment.theta)
        if distance == 0.0 and turn == 0.0:
            return
        cosine, sine = math.cos(increment.theta), math.sin(increment.theta)
        # error e = truth ⊖ estimate in the vehicle frame: e' = Ad(u^-1) e + noise
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
                0.1 * c.base_distance_variance * distance,
                c.base_heading_variance_turn * turn + c.base_heading_variance_distance * distance,
            ]
        )
        self._covariance = f @ self._covariance @ f.T + noise

    def value(self, pose: Pose2) -> Array:
        """Return the covariance (3, 3) of x, y (m²) and heading (rad²) in the odometry frame."""
        cosine, sine = math.cos(pose.theta), math.sin(pose.theta)
        rotation = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        turned: Array = rotation @ self._covariance @ rotation.T
        return turned
