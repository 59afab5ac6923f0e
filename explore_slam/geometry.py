"""Poses in the plane, SE(2), one by one and in arrays, and rotations in space.

Lengths are in metres, angles in radians in (-pi, pi]. Quaternions are (x, y, z, w) as in
geometry_msgs.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Quaternion = tuple[float, float, float, float]  # x, y, z, w


def wrap_angle(angle: float) -> float:
    """Return an angle (rad) wrapped into (-pi, pi]."""
    wrapped = math.remainder(angle, math.tau)
    return math.pi if wrapped == -math.pi else wrapped


def wrap_angles(angles: ArrayLike) -> Array:
    """Return angles (rad, any shape) wrapped into (-pi, pi]."""
    values = np.asarray(angles, dtype=np.float64)
    wrapped: Array = np.pi - np.mod(np.pi - values, 2.0 * np.pi)
    return wrapped


class Pose2(NamedTuple):
    """A pose, or an increment between poses, in the plane: x (m), y (m), theta (rad)."""

    x: float
    y: float
    theta: float

    def compose(self, increment: 'Pose2') -> 'Pose2':
        """Return self ⊕ increment: this pose moved by an increment in its own frame."""
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
        """Return whether all coordinates are finite."""
        return all(map(math.isfinite, self))

    @classmethod
    def from_array(cls, values: ArrayLike) -> 'Pose2':
        """Return the pose of an array (3,)."""
        x, y, theta = np.asarray(values, dtype=np.float64)
        return cls(float(x), float(y), wrap_angle(float(theta)))


IDENTITY = Pose2(0.0, 0.0, 0.0)


def moved_enough(increment: Pose2, distance: float, heading: float) -> bool:
    """Return whether an increment reaches a distance (m) or a change of heading (rad)."""
    return math.hypot(increment.x, increment.y) >= distance or abs(increment.theta) >= heading


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


def interpolated(poses: ArrayLike, others: ArrayLike, fractions: ArrayLike) -> Array:
    """Return the poses (T, 3) at fractions (T,), 0 to 1, from poses (T, 3) to others (T, 3).

    Positions are interpolated along a straight line, headings along the shorter turn.
    """
    a, b = np.asarray(poses, dtype=np.float64), np.asarray(others, dtype=np.float64)
    step = b - a
    step[:, 2] = wrap_angles(step[:, 2])
    found: Array = a + np.asarray(fractions, dtype=np.float64)[:, None] * step
    found[:, 2] = wrap_angles(found[:, 2])
    return found


def planar_rotation(angle: float) -> Array:
    """Return the rotation (3, 3) by an angle (rad) about z.

    It rotates points in space, and vectors (x, y, theta) of SE(2), whose heading it keeps.
    """
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rotated(covariance: Array, angle: float) -> Array:
    """Return a pose covariance (3, 3) expressed in axes rotated by an angle (rad)."""
    T = planar_rotation(-angle)
    turned: Array = T @ covariance @ T.T
    return turned


def to_world(pose: ArrayLike, points: ArrayLike) -> Array:
    """Transform points (N, 2) or (N, 3) from the frame of a pose (3,) to the world; z is kept."""
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


def quaternion_from_yaw(yaw: float) -> Quaternion:
    """Return the unit quaternion of a rotation about z (rad)."""
    half = 0.5 * float(yaw)
    return (0.0, 0.0, math.sin(half), math.cos(half))


def yaw_from_quaternion(x: float, y: float, z: float, w: float) -> float:
    """Return the yaw (rad) of fixed-axis roll, pitch, yaw; any length but 0 will do."""
    return math.atan2(2 * (w * z + x * y), w**2 + x**2 - y**2 - z**2)


def rotation_from_quaternion(x: float, y: float, z: float, w: float) -> Array:
    """Return the rotation (3, 3) of a quaternion of any length but 0."""
    x, y, z, w = np.array([x, y, z, w]) / np.linalg.norm([x, y, z, w])
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def quaternion_from_rotation(rotation: ArrayLike) -> Quaternion:
    """Return the unit quaternion, w >= 0, of a rotation (3, 3).

    It is the eigenvector of the largest eigenvalue of a symmetric matrix (Bar-Itzhack, "New method
    for extracting the quaternion from a rotation matrix", 2000), which is stable at every angle
    and tolerates a matrix that is orthogonal up to rounding only.
    """
    m = np.asarray(rotation, dtype=np.float64)
    k = np.zeros((4, 4))
    k[:3, :3] = m + m.T
    k[range(4), range(4)] = [
        m[0, 0] - m[1, 1] - m[2, 2],
        m[1, 1] - m[0, 0] - m[2, 2],
        m[2, 2] - m[0, 0] - m[1, 1],
        m[0, 0] + m[1, 1] + m[2, 2],
    ]
    k[3, :3] = k[:3, 3] = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    largest = np.linalg.eigh(k)[1][:, -1]
    x, y, z, w = (largest * np.copysign(1.0, largest[3])).tolist()
    return (x, y, z, w)


def multiply_quaternions(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the Hamilton product a b: the rotation b followed by the rotation a."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


class Pose3(NamedTuple):
    """A pose in space: position (m) and unit quaternion."""

    position: tuple[float, float, float]
    quaternion: Quaternion

    @property
    def rotation(self) -> Array:
        """Rotation (3, 3) from the frame of the pose to the frame in which it is given."""
        return rotation_from_quaternion(*self.quaternion)

    def compose(self, other: 'Pose3') -> 'Pose3':
        """Return the pose of other, which is given in the frame of this pose."""
        position = np.array(self.position) + self.rotation @ np.array(other.position)
        x, y, z = position.tolist()
        return Pose3((x, y, z), multiply_quaternions(self.quaternion, other.quaternion))

    def inverse(self) -> 'Pose3':
        """Return the pose p with self ⊕ p = identity."""
        x, y, z = (-self.rotation.T @ np.array(self.position)).tolist()
        qx, qy, qz, qw = self.quaternion
        return Pose3((x, y, z), (-qx, -qy, -qz, qw))


def roll_pitch_yaw(rotation: ArrayLike) -> tuple[float, float, float]:
    """Return fixed-axis roll, pitch and yaw (rad) of a rotation (3, 3); see rotation_matrix."""
    m = np.asarray(rotation, dtype=np.float64)
    pitch = math.asin(min(max(-m[2, 0], -1.0), 1.0))
    if abs(m[2, 0]) > 1.0 - 1e-9:  # gimbal lock: roll and yaw turn about the same axis
        return 0.0, pitch, math.atan2(-m[0, 1], m[1, 1])
    return math.atan2(m[2, 1], m[2, 2]), pitch, math.atan2(m[1, 0], m[0, 0])
