"""The pose of a vehicle whose observations share an error of their frame."""

import numpy as np

from explore_slam.geometry import Array, between, compose
from explore_slam.slam.particles.resampling import stratified_normals


def without_frame_error(
    predicted: Array, seen_from: Array, P: Array, error: Array | None, random: np.random.Generator
) -> Array:
    """Return samples (M, 3) of the poses of a vehicle whose frame seems seen from others.

    predicted (M, 3) with the covariance P (3, 3); seen_from (M, 3): the same with the common
    error (3, 3) of the frame, sampled given the observations; None: there is no such error. What
    the observations say of the pose, they say by way of seen_from: the pose given seen_from is
    that of two Gaussians added.
    """
    if error is None:
        return seen_from
    gain = np.linalg.solve(P + error, P).T
    rest = P - gain @ P
    values, vectors = np.linalg.eigh(0.5 * (rest + rest.T))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    normals = stratified_normals(random, len(predicted), 3)
    return compose(predicted, between(predicted, seen_from) @ gain.T + normals @ root.T)
