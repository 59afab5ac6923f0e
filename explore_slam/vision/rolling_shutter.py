"""Uncertainty of features in the images of a rolling shutter.

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


def with_readout_noise(
    observations: LandmarkObservations, velocity: Array, readout_time: float
) -> LandmarkObservations:
    """Return observations with the covariance of moments of exposure that are not known.

    velocity (3,): of the vehicle in its own frame, m/s, m/s, rad/s. readout_time (s): from the
    first row to the last. Rows are spread evenly over it, with a deviation of readout_time / √12,
    and features over the rows. A point p moves by -(v + ω x p) in the vehicle frame.
    """
    if not len(observations) or readout_time == 0.0 or not np.any(velocity):
        return observations
    moving = np.zeros_like(observations.positions)
    moving[:, 0] = velocity[0] - velocity[2] * observations.positions[:, 1]
    moving[:, 1] = velocity[1] + velocity[2] * observations.positions[:, 0]
    moving *= readout_time / math.sqrt(12.0)
    covariances = observations.covariances + moving[:, :, None] * moving[:, None, :]
    return replace(observations, covariances=covariances)
