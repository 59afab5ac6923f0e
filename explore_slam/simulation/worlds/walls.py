"""Exact ray casting on walls that are line segments."""

import numpy as np

from explore_slam.geometry import Array

Point = tuple[float, float]


def line(*corners: Point) -> Array:
    """Return the segments (n, 4) x0, y0, x1, y1 (m) of a line through corners."""
    points = np.array(corners)
    return np.concatenate([points[:-1], points[1:]], axis=1)


def box(x: float, y: float, width: float, depth: float) -> Array:
    """Return the sides (4, 4) of a rectangle from its lower left corner (m)."""
    right, far = x + width, y + depth
    return line((x, y), (right, y), (right, far), (x, far), (x, y))


def distances_along(walls: Array, origins: Array, headings: Array) -> Array:
    """Return the distances (B,) m to the walls (n, 4) along beams; inf: none.

    origins (B, 2) m, or (1, 2) of all beams; headings (B,) rad.
    """
    directions = np.stack([np.cos(headings), np.sin(headings)], axis=1)
    edges = walls[:, 2:] - walls[:, :2]
    starts = walls[None, :, :2] - origins[:, None]
    across = np.outer(directions[:, 0], edges[:, 1]) - np.outer(directions[:, 1], edges[:, 0])
    with np.errstate(divide='ignore', invalid='ignore'):
        far = (starts[..., 0] * edges[:, 1] - starts[..., 1] * edges[:, 0]) / across
        along = (
            directions[:, 1, None] * starts[..., 0] - directions[:, 0, None] * starts[..., 1]
        ) / across
    hit = (far > 0.0) & (along >= 0.0) & (along <= 1.0)
    found: Array = np.where(hit, far, np.inf).min(axis=1)
    return found


def distances_from(walls: Array, points: Array) -> Array:
    """Return the distances (N,) m of points (N, 2) from the nearest of the walls (n, 4)."""
    edges = walls[:, 2:] - walls[:, :2]
    off = points[:, None] - walls[None, :, :2]
    share = (off * edges).sum(axis=2) / (edges**2).sum(axis=1)
    nearest = off - np.clip(share, 0.0, 1.0)[..., None] * edges
    found: Array = np.sqrt((nearest**2).sum(axis=2)).min(axis=1)
    return found
