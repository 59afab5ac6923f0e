"""The rays of a depth image in a frame that looks ahead along the floor."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import Intrinsics
from explore_slam.geometry import Array
from explore_slam.vision.depth import camera_rays

_LEAST_FORWARD = 0.1  # of a ray, horizontally; steeper ones are left out
# Tangent of the bearing (80 degrees) up to which rays are used. The widest depth cameras reach 60
# (Azure Kinect, wide field of view). Beyond, tangents grow without bound, and the view with them.
WIDEST = math.tan(math.radians(80.0))


class Rays(NamedTuple):
    """Rays of an image (W, H), column by column, in a frame that looks ahead along the floor.

    ahead: per metre of depth, 0 where a ray is too steep or too far to the side; tangent of the
    bearing to the left; slope upwards per metre ahead.
    """

    ahead: NDArray[np.float32]
    tangent: NDArray[np.float32]
    slope: NDArray[np.float32]


class Band(NamedTuple):
    """Heights (m): lowest and highest of obstacles, step; noise (1/m) of depth."""

    lowest: float
    highest: float
    step: float
    noise: float


def level_rays(camera: Intrinsics, stride: int, rotation: Array, heading: float) -> Rays:
    """Return the rays of every stride-th pixel.

    rotation (3, 3): from the optical to the vehicle frame; heading (rad): of the camera in it.
    """
    u, v = np.mgrid[0 : camera.width : stride, 0 : camera.height : stride]
    pixels = np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float64)
    flat = camera_rays(pixels, camera)
    cos, sin = math.cos(heading), math.sin(heading)
    turn = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    rays = np.column_stack([flat, np.ones(len(flat))]) @ (turn @ rotation).T
    usable = (rays[:, 0] > _LEAST_FORWARD) & (np.abs(rays[:, 1]) <= WIDEST * rays[:, 0])
    ahead = np.where(usable, rays[:, 0], 1.0)
    columns = (ahead, rays[:, 1] / ahead, rays[:, 2] / ahead)
    return Rays(
        *(np.where(usable, column, 0.0).astype(np.float32).reshape(u.shape) for column in columns)
    )
