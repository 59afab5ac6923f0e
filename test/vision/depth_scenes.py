"""Depth images of floors, tables, pits and walls, cast exactly."""

from functools import partial

import numpy as np

from explore_slam.data import Intrinsics, RgbdFrame
from explore_slam.vision import CameraMount

CAMERA = Intrinsics(320, 240, 290.0, 290.0, 159.5, 119.5)
MOUNT = CameraMount(0.1, 0.0, 0.4)
FAR = 9.0  # m ahead, where the scenes end with a wall
TABLE = (1.6, 2.6, -0.6, 0.6, 0.67)  # x and y of the edges, height of the lower side


def cast(mount=MOUNT, tables=(), pit=None, wall=FAR, noise=0.0, limit=8.0):
    """Return the depth (H, W) m of a floor with tables above and a pit in it, before a wall."""
    v, u = np.mgrid[0:240, 0:320]
    flat = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy], axis=-1)
    optical = np.concatenate([flat, np.ones((240, 320, 1))], axis=-1)
    x, y, z = np.moveaxis(optical @ mount.rotation.T, -1, 0)  # per metre of depth
    depth = np.where(x > 0.0, (wall - mount.x) / np.maximum(x, 1e-9), np.inf)

    def level(height, inside):
        """Let rays end on a horizontal surface where it is."""
        nonlocal depth
        with np.errstate(divide='ignore', invalid='ignore'):
            d = (height - mount.z) / z
            ends = (d > 0.0) & inside(mount.x + d * x, mount.y + d * y)
        depth = np.where(ends, np.minimum(depth, d), depth)

    if pit is None:
        level(0.0, lambda px, _: px < wall)
    else:
        begin, drop = pit
        level(0.0, lambda px, _: px < begin)
        level(-drop, lambda px, _: (px >= begin) & (px < wall))
    for x0, x1, y0, y1, height in tables:
        level(height, partial(_within, x0, x1, y0, y1))
    measured = depth + noise * depth**2 * np.random.default_rng(5).standard_normal(depth.shape)
    return np.where(measured < limit, measured, 0.0).astype(np.float32)


def _within(x0, x1, y0, y1, x, y):
    return (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)


def frame(depth, stamp=1.0):
    return RgbdFrame(stamp, np.zeros((240, 320), np.uint8), depth, CAMERA)
