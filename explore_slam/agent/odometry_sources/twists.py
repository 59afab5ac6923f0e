"""Motion at constant velocity in the plane: exponential and logarithm of SE(2), and adjoints."""

import math

import numpy as np

from explore_slam.geometry import Array, Pose2, wrap_angle

_SMALL = 1e-6  # rad; a turn below which the series is exact to rounding


def exponential(twist: Array) -> Pose2:
    """Return the motion of a velocity (m/s, m/s, rad/s in the vehicle frame) over one second."""
    vx, vy, turn = twist.tolist()
    if abs(turn) < _SMALL:
        s, c = 1.0 - turn * turn / 6.0, 0.5 * turn
    else:
        s, c = math.sin(turn) / turn, (1.0 - math.cos(turn)) / turn
    return Pose2(s * vx - c * vy, c * vx + s * vy, wrap_angle(turn))


def logarithm(motion: Pose2) -> Array:
    """Return the velocity (3,) that leads to a motion in one second; its turn is below π."""
    turn = motion.theta
    half = 0.5 * turn
    factor = 1.0 - turn * turn / 12.0 if abs(turn) < _SMALL else half / math.tan(half)
    return np.array(
        [factor * motion.x + half * motion.y, factor * motion.y - half * motion.x, turn]
    )


def moved_error(motion: Pose2) -> Array:
    """Return the matrix (3, 3) that carries an error of a pose, in its frame, over a motion.

    It is the adjoint of the inverse motion.
    """
    back = motion.inverse()
    c, s = math.cos(back.theta), math.sin(back.theta)
    return np.array([[c, -s, back.y], [s, c, -back.x], [0.0, 0.0, 1.0]])
