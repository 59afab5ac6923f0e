"""A small ray caster: worlds of line segments and the scans of them."""

import itertools
import math

import numpy as np

from explore_slam.data import LaserScan

BEAMS = 181


def polyline(*corners):
    """Return the segments (n, 4) of a line through corners."""
    return np.array([(*a, *b) for a, b in itertools.pairwise(corners)], dtype=float)


def box(x0, y0, x1, y1):
    """Return the segments of a rectangle."""
    return polyline((x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0))


def scan_of(
    segments, pose, noise=0.0, random=None, *, stamp=0.0, beams=BEAMS, sight=math.pi, farthest=30.0
):
    """Return the scan of a laser at a pose, with Gaussian range noise (m) of a generator."""
    angles = np.linspace(-sight / 2, sight / 2, beams)
    rays = np.stack([np.cos(angles + pose.theta), np.sin(angles + pose.theta)], axis=1)
    edges, starts = segments[:, 2:] - segments[:, :2], segments[:, :2] - (pose.x, pose.y)
    across = rays[:, None, 0] * edges[None, :, 1] - rays[:, None, 1] * edges[None, :, 0]
    with np.errstate(divide='ignore', invalid='ignore'):
        far = (starts[:, 0] * edges[:, 1] - starts[:, 1] * edges[:, 0]) / across
        part = starts[None, :, 0] * rays[:, None, 1] - starts[None, :, 1] * rays[:, None, 0]
        part = part / across
    hit = (far > 0.0) & (part >= 0.0) & (part <= 1.0)
    ranges = np.where(hit, far, np.inf).min(axis=1)
    if random is not None:
        ranges = ranges + noise * random.normal(size=beams)
    ranges[ranges > farthest] = np.inf
    step = sight / (beams - 1)
    return LaserScan(stamp, -sight / 2, step, ranges.astype(np.float32), 0.0, farthest)
