"""Polylines in the plane: arc length along them, points at arc lengths, what lies ahead."""

import numpy as np

from explore_slam.geometry import Array


def arc_lengths(points: Array) -> Array:
    """Return the arc length (W,) m at each vertex of a polyline (W, 2) m."""
    steps = np.hypot(*np.diff(points, axis=0).T) if len(points) > 1 else np.empty(0)
    return np.concatenate([[0.0], np.cumsum(steps)])


def points_at(points: Array, lengths: Array, at: Array) -> Array:
    """Return the points (N, 2) m of a polyline at arc lengths (N,) m, clamped to its ends.

    points: (W, 2) vertices; lengths: (W,) their arc lengths.
    """
    return np.stack(
        [np.interp(at, lengths, points[:, 0]), np.interp(at, lengths, points[:, 1])], axis=1
    )


def sample(points: Array, spacing: float) -> Array:
    """Return points (N, 2) m at a spacing (m) along a polyline (W, 2) m, and its end."""
    lengths = arc_lengths(points)
    at = np.append(np.arange(0.0, lengths[-1], spacing), lengths[-1])
    return points_at(points, lengths, at)


def truncated(points: Array, limit: float) -> Array:
    """Return the part of a polyline (W, 2) m up to an arc length (m)."""
    lengths = arc_lengths(points)
    if limit >= lengths[-1]:
        return points
    keep = points[lengths < limit]
    return np.vstack([keep, points_at(points, lengths, np.array([limit]))])


def project(points: Array, position: Array) -> tuple[int, float, float]:
    """Project a position (2,) m onto a polyline (W, 2) m with at least two vertices.

    Returns the index of the nearest segment (the first of equally near ones), the fraction 0..1 of
    that segment before the nearest point, and the distance (m) to it.
    """
    first, step = points[:-1], np.diff(points, axis=0)
    squared = np.maximum((step**2).sum(axis=1), 1e-12)
    share = np.clip(((position - first) * step).sum(axis=1) / squared, 0.0, 1.0)
    gaps = np.linalg.norm(first + share[:, None] * step - position, axis=1)
    nearest = int(np.argmin(gaps))
    return nearest, float(share[nearest]), float(gaps[nearest])


def remaining_path(position: Array, waypoints: Array) -> Array:
    """Return the part of a path (W, 2) m ahead of a position (2,) m, which becomes its start."""
    if len(waypoints) < 2:
        return np.vstack([position, waypoints])
    nearest, _, _ = project(waypoints, position)
    return np.vstack([position, waypoints[nearest + 1 :]])
