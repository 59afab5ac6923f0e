"""Kalman filter of pose and velocity of a vehicle that moves at nearly constant velocity.

The acceleration is white noise (Bar-Shalom, Li and Kirubarajan, "Estimation with applications to
tracking and navigation", 2001, section 6.2.2), in the vehicle frame: at constant velocity a
vehicle follows an arc. The state is the error of pose and velocity, (6,) with its covariance.
"""

import numpy as np

from explore_slam.agent.odometry_sources.twists import exponential, moved_error
from explore_slam.geometry import Array, Pose2

# Spectral densities of the acceleration: m²/s³ along and across, rad²/s³. A vehicle reaches 0.2
# m/s and 0.6 rad/s within the 0.2 s between two scans of a slow lidar: a TurtleBot3 Burger its
# maximum of 0.22 m/s, accelerating by 2.5 m/s², and 3.2 rad/s² in its turn.
_ACCELERATION = np.array([0.2, 0.2, 2.0])
# Largest velocity, m/s and rad/s: what vehicles indoors drive at (ISO 3691-4 takes walking pace,
# 1.2 m/s, as the limit beside people). Where nothing measures the velocity, that is two standard
# deviations, and its uncertainty does not grow beyond.
_FASTEST = np.array([1.2, 1.2, 2.0])
_LIMITS = 0.5 * _FASTEST
_CORRELATION = 0.999  # of pose and velocity at most, so that the covariance stays positive


class VelocityFilter:
    """Velocity (3,) in the vehicle frame, and covariance (6, 6) of pose and velocity.

    The pose is that of the newest scan relative to the map of scans; it is known to the caller.
    """

    def __init__(self) -> None:
        self.velocity = np.zeros(3)
        self.covariance = np.zeros((6, 6))
        self.forget_velocity()

    def forget_velocity(self) -> None:
        """Continue at rest, with a velocity that may be any."""
        self.velocity = np.zeros(3)
        self.covariance[3:] = self.covariance[:, 3:] = 0.0
        self.covariance[3:, 3:] = np.diag(_LIMITS**2)

    def forget_pose(self) -> None:
        """Continue with a map of scans that begins here."""
        self.covariance[:3] = self.covariance[:, :3] = 0.0

    def motion(self, duration: float) -> Pose2:
        """Return the motion in a time (s)."""
        return exponential(duration * self.velocity)

    def predicted(self, duration: float) -> Array:
        """Return the covariance (6, 6) after a time (s), in the vehicle frame there."""
        F = np.eye(6)
        F[:3, :3] = moved_error(self.motion(duration))
        F[:3, 3:] = duration * np.eye(3)
        Q = np.zeros((6, 6))
        Q[:3, :3] = np.diag(_ACCELERATION * duration**3 / 3.0)
        Q[:3, 3:] = Q[3:, :3] = np.diag(_ACCELERATION * duration**2 / 2.0)
        Q[3:, 3:] = np.diag(_ACCELERATION * duration)
        covariance: Array = F @ self.covariance @ F.T + Q
        return covariance

    def growth(self, duration: float) -> Array:
        """Return by which covariance (3, 3) the error of the pose grows in a time (s).

        An unknown velocity makes errors that do not average out: the variance grows with the
        square of time. Added up over all steps, these are the variance of the whole.
        """
        moved = moved_error(self.motion(duration))
        grown = self.predicted(duration)[:3, :3] - moved @ self.covariance[:3, :3] @ moved.T
        return positive(grown)

    def velocity_after(self, duration: float, shift: Array) -> Array:
        """Return the velocity after a time (s), at a pose that is shifted by (3,) as in update."""
        P = self.predicted(duration)
        gain = np.linalg.solve(P[:3, :3], P[:3, 3:]).T
        velocity: Array = np.clip(self.velocity + gain @ shift, -_FASTEST, _FASTEST)
        return velocity

    def update(self, duration: float, shift: Array, before: Array, posterior: Array) -> None:
        """Continue at a measured pose after a time (s).

        shift (3,): from the predicted pose to the one that a measurement and the prediction give
        together; before, posterior: covariances (3, 3) of the two. What that says of the velocity
        follows from its correlation with the pose.
        """
        P = self.predicted(duration)
        gain = np.linalg.solve(before, P[:3, 3:]).T
        self.velocity = np.clip(self.velocity + gain @ shift, -_FASTEST, _FASTEST)
        P[3:, 3:] -= gain @ (before - posterior) @ gain.T
        P[3:, :3] = gain @ posterior
        P[:3, 3:] = P[3:, :3].T
        P[:3, :3] = posterior
        self._limit(P)

    def wait(self, duration: float) -> None:
        """Continue at the predicted pose after a time (s) without a measurement."""
        self._limit(self.predicted(duration))

    def _limit(self, P: Array) -> None:
        """Take a covariance, with the velocity no more uncertain than it may be.

        Its covariance with the pose stays: a vehicle that drives at an unknown velocity gets as
        far as that takes it, and not on a random walk.
        """
        P = 0.5 * (P + P.T)
        scale = np.minimum(1.0, _LIMITS / np.sqrt(np.maximum(np.diag(P)[3:], 1e-12)))
        P[3:, 3:] *= np.outer(scale, scale)
        largest = _CORRELATION * np.sqrt(np.outer(np.diag(P)[:3], np.diag(P)[3:]).clip(0.0))
        P[:3, 3:] = np.clip(P[:3, 3:], -largest, largest)
        P[3:, :3] = P[:3, 3:].T
        self.covariance = positive(P)


def positive(covariance: Array) -> Array:
    """Return the nearest covariance without negative eigenvalues."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    nearest: Array = (vectors * values.clip(0.0)) @ vectors.T
    return nearest
