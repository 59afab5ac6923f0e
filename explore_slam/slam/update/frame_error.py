"""The pose of a vehicle whose observations have an error in common."""

import numpy as np

from explore_slam.geometry import Array, between, compose
from explore_slam.slam.particles.resampling import stratified_normals


def without_frame_error(
    predicted: Array, seen_from: Array, P: Array, error: Array | None, random: np.random.Generator
) -> Array:
    """Sample the vehicle poses (M, 3) given poses that include the frame error.

    The observations constrain only the latter. Given these, the vehicle pose has the conditional
    distribution of one term of a sum of two independent Gaussians.

    predicted (M, 3): vehicle poses with the covariance P (3, 3). seen_from (M, 3): poses including
    the frame error, sampled given the observations. error (3, 3): covariance of the frame error;
    None: there is none, and the poses are the same.
    """
    if error is None:
        return seen_from
    gain = np.linalg.solve(P + error, P).T
    rest = P - gain @ P
    values, vectors = np.linalg.eigh(0.5 * (rest + rest.T))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    normals = stratified_normals(random, len(predicted), 3)
    return compose(predicted, between(predicted, seen_from) @ gain.T + normals @ root.T)
