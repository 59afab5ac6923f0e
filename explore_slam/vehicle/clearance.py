"""Free distance of a disc along an arc between points, e.g. laser returns."""

import math

import numpy as np

from explore_slam.data import LaserScan
from explore_slam.geometry import Array, Pose2, to_world

_STRAIGHT = 1e-3  # 1/m, curvature below which an arc counts as a straight line


def scan_points(scan: LaserScan, laser: Pose2) -> Array:
    """Return the returns of a scan as points (N, 2) m in the vehicle frame.

    laser: pose of the laser in the vehicle frame. NaN and +inf are no returns; -inf (too close,
    REP-117) counts as a return at range_min.
    """
    ranges = scan.ranges.astype(np.float64)
    ranges = np.where(np.isneginf(ranges), scan.range_min, ranges)
    hit = np.isfinite(ranges) & (ranges >= scan.range_min) & (ranges <= scan.range_max)
    angles = scan.angles[hit]
    points = ranges[hit, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    return to_world(laser, points)


def free_distance(points: Array, curvature: float, radius: float, forward: bool = True) -> float:
    """Return the arc length (m) after which a disc touches one of the points (N, 2) m.

    The disc's centre starts at the origin, heading along +x (-x if not forward), with constant
    curvature (1/m, left positive). Returns inf if nothing is touched within half a turn, and 0
    if a point inside the disc lies ahead of its centre.
    """
    if len(points) == 0:
        return math.inf
    x = points[:, 0] if forward else -points[:, 0]
    y = points[:, 1]
    inside = x * x + y * y <= radius * radius
    if bool(np.any(inside & (x > 0.0))):
        return 0.0
    x, y = x[~inside], y[~inside]
    if abs(curvature) < _STRAIGHT:
        ahead = (np.abs(y) < radius) & (x > 0.0)
        if not ahead.any():
            return math.inf
        return float(np.min(x[ahead] - np.sqrt(radius**2 - y[ahead] ** 2)))
    return _free_arc(x, y if curvature > 0.0 else -y, 1.0 / abs(curvature), radius)


def _free_arc(x: Array, y: Array, turn: float, radius: float) -> float:
    """Return the free distance on the left arc of radius `turn` (m) around (0, turn)."""
    distance = np.hypot(x, y - turn)
    touched = (np.abs(distance - turn) < radius) & (distance > 1e-9)
    if not touched.any():
        return math.inf
    x, y, distance = x[touched], y[touched], distance[touched]
    cosine = (distance**2 + turn**2 - radius**2) / (2.0 * distance * turn)
    half = np.arccos(np.clip(cosine, -1.0, 1.0))
    angle = np.mod(np.arctan2(x, turn - y), 2.0 * np.pi)  # from the start, along the arc
    contact = np.mod(angle - half, 2.0 * np.pi)
    contact = contact[contact < np.pi]
    return float(np.min(contact) * turn) if contact.size else math.inf
