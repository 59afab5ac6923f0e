"""Poses in the plane, SE(2), alone and in arrays; metres and radians, angles in (-pi, pi]."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def wrap_angle(angle: float) -> float:
    """Return the angle (rad) brought into (-pi, pi]."""
    wrapped = math.remainder(angle, math.tau)
    return math.pi if wrapped == -math.pi else wrapped


def wrap_angles(angles: ArrayLike) -> Array:
    """Return angles (rad, any shape) brought into (-pi, pi]."""
    values = np.asarray(angles, dtype=np.float64)
    wrapped: Array = np.pi - np.mod(np.pi - values, 2.0 * np.pi)
    return wrapped


class Pose2(NamedTuple):
    """A pose, or an increment between poses, in the plane: x (m), y (m), theta (rad)."""

    x: float
    y: float
    theta: float

    def compose(self, increment: 'Pose2') -> 'Pose2':
        """Return this pose moved by an increment given in its own frame (self ⊕ increment)."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        return Pose2(
            self.x + c * increment.x - s * increment.y,
            self.y + s * increment.x + c * increment.y,
            wrap_angle(self.theta + increment.theta),
        )

    def inverse(self) -> 'Pose2':
        """Return the pose p with self ⊕ p = identity."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        return Pose2(-c * self.x - s * self.y, s * self.x - c * self.y, wrap_angle(-self.theta))

    def between(self, other: 'Pose2') -> 'Pose2':
        """Return the increment u with self ⊕ u = other."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        dx, dy = other.x - self.x, other.y - self.y
        return Pose2(c * dx + s * dy, -s * dx + c * dy, wrap_angle(other.theta - self.theta))

    def is_finite(self) -> bool:
        """Tell whether no coordinate is NaN or infinite."""
        return all(map(math.isfinite, self))

    @classmethod
    def from_array(cls, values: ArrayLike) -> 'Pose2':
        """Make a pose of an array of shape (3,)."""
        x, y, theta = np.asarray(values, dtype=np.float64)
        return cls(float(x), float(y), wrap_angle(float(theta)))


IDENTITY = Pose2(0.0, 0.0, 0.0)


def compose(poses: ArrayLike, increments: ArrayLike) -> Array:
    """Compose poses (..., 3) with increments (..., 3), broadcasting; see Pose2.compose."""
    a, b = np.asarray(poses, dtype=np.float64), np.asarray(increments, dtype=np.float64)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack(
        [
            a[..., 0] + c * b[..., 0] - s * b[..., 1],
            a[..., 1] + s * b[..., 0] + c * b[..., 1],
            wrap_angles(a[..., 2] + b[..., 2]),
        ],
        axis=-1,
    )


def between(poses: ArrayLike, others: ArrayLike) -> Array:
    """Return the increments (..., 3) that lead from poses (..., 3) to others (..., 3)."""
    a, b = np.asarray(poses, dtype=np.float64), np.asarray(others, dtype=np.float64)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    dx, dy = b[..., 0] - a[..., 0], b[..., 1] - a[..., 1]
    return np.stack([c * dx + s * dy, c * dy - s * dx, wrap_angles(b[..., 2] - a[..., 2])], -1)


def to_world(pose: ArrayLike, points: ArrayLike) -> Array:
    """Move points (N, 2) or (N, 3) from the frame of one pose (3,) to the world; z is kept."""
    x, y, theta = np.asarray(pose, dtype=np.float64)
    moved = np.array(points, dtype=np.float64)
    c, s = math.cos(theta), math.sin(theta)
    px, py = moved[:, 0].copy(), moved[:, 1].copy()
    moved[:, 0] = x + c * px - s * py
    moved[:, 1] = y + s * px + c * py
    return moved


def rotation_matrix(roll: float, pitch: float, yaw: float) -> Array:
    """Return the rotation (3, 3) for fixed-axis roll, pitch, yaw (rad; REP-103)."""
    cr, sr = math.cos(roll), math.sin(roll)
    cp, sp = math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
