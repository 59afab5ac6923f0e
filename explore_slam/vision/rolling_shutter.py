"""Features in the images of a rolling shutter.

The rows of an image are exposed one after another (Kinect v1: Ringaby and Forssén, "Scan
rectification for structured light range sensors with rolling shutters", ICCV 2011). While the
vehicle moves, each feature is measured from another pose than that at the stamp, which is taken
for the middle row's: a turn of 0.5 rad/s displaces the first and the last row of a Kinect by 3.6
pixels.
"""

import math
from dataclasses import replace

import numpy as np

from explore_slam.data import LandmarkObservations
from explore_slam.geometry import Array

# Fraction of the motion within an image that remains when it has been undone: the velocity of a
# vehicle at a moment, from wheels that are read 20 times a second, is known to 10 % in the
# simulators, and changes within an image.
_REMAINING = 0.2


def row_delays(rows: Array, height: int, readout_time: float) -> Array:
    """Return the times (K,) s from the stamp of an image to the exposure of rows (K,) px of it.

    height: of the image (px), whose middle row is exposed at the stamp.
    """
    delays: Array = (rows / max(height - 1, 1) - 0.5) * readout_time
    return delays


def at_the_stamp(
    observations: LandmarkObservations, velocity: Array, readout_time: float
) -> LandmarkObservations:
    """Return observations as if all had been measured at the stamp.

    velocity (3,): of the vehicle in its own frame, m/s, m/s, rad/s. readout_time (s): from the
    first row to the last. In the vehicle frame a point p moves by -(v + ω x p). Where delays are
    known, that is undone, and a part of it remains in the covariance. Where they are not, rows are
    spread evenly over the readout, with a deviation of readout_time / √12, and features over the
    rows.
    """
    known = observations.delays is not None
    if not len(observations) or not (known or readout_time) or not np.any(velocity):
        return replace(observations, delays=None) if known else observations
    motion = np.zeros_like(observations.positions)
    motion[:, 0] = velocity[0] - velocity[2] * observations.positions[:, 1]
    motion[:, 1] = velocity[1] + velocity[2] * observations.positions[:, 0]
    positions = observations.positions
    if observations.delays is None:
        unknown = motion * (readout_time / math.sqrt(12.0))
    else:
        motion *= observations.delays[:, None]
        positions, unknown = positions + motion, _REMAINING * motion
    covariances = observations.covariances + unknown[:, :, None] * unknown[:, None, :]
    return replace(observations, positions=positions, covariances=covariances, delays=None)
