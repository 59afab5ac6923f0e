"""Weights of particles: normalization, moments, effective sample size, resampling."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from explore_slam.geometry import Array, Pose2, wrap_angles

_KIN = 8  # particles in a row that share the strata of a draw


def normalized(log_weights: Array) -> tuple[Array, Array]:
    """Return log weights shifted so that the weights sum to one, and these weights, both (M,)."""
    shifted = log_weights - log_weights.max()
    weights = np.exp(shifted)
    total = weights.sum()
    return shifted - np.log(total), weights / total


def effective_particles(weights: Array) -> float:
    """Return 1 / Σ w² of normalized weights (M,): between 1 and M."""
    return float(1.0 / np.sum(weights * weights))


def mean_and_covariance(poses: Array, weights: Array) -> tuple[Pose2, Array]:
    """Return mean and covariance (3, 3) of poses (M, 3) of normalized weights (M,)."""
    c, s = weights @ np.cos(poses[:, 2]), weights @ np.sin(poses[:, 2])
    mean = np.array([weights @ poses[:, 0], weights @ poses[:, 1], math.atan2(s, c)])
    off = poses - mean
    off[:, 2] = wrap_angles(off[:, 2])
    return Pose2.from_array(mean), (off * weights[:, None]).T @ off


def stratified_normals(random: np.random.Generator, particles: int, dimensions: int) -> Array:
    """Return standard normal samples (M, D), each dimension evenly covered: a Latin hypercube.

    So are any _KIN particles in a row, from coarse strata: particles that descend from one are
    neighbours, and spread out. Less of the estimate's variance comes from the draw than with
    independent samples.
    """
    groups = -(-particles // _KIN)
    uniform = np.empty((groups * _KIN, dimensions))
    coarse_first = np.tile(np.arange(_KIN), (groups, 1))
    fine_first = np.tile(np.arange(groups), (_KIN, 1))
    for dimension in range(dimensions):
        coarse = random.permuted(coarse_first, axis=1)
        fine = random.permuted(fine_first, axis=1)[coarse, np.arange(groups)[:, None]]
        uniform[:, dimension] = (coarse * groups + fine).ravel()
    uniform = (uniform + random.random(uniform.shape)) / len(uniform)
    normals: Array = ndtri(np.clip(uniform[:particles], 1e-12, 1.0 - 1e-12))
    return normals


def systematic_ancestors(
    weights: Array, offset: float, particles: int | None = None
) -> NDArray[np.int32]:
    """Return the ancestor (M,) of each particle after systematic resampling, in ascending order.

    offset is uniform in [0, 1). Without a number of particles there are as many as before. The
    order keeps the descendants of one particle together.
    """
    count = len(weights) if particles is None else particles
    edges = np.cumsum(weights)
    edges /= edges[-1]
    points = (np.arange(count) + offset) / count
    chosen = np.searchsorted(edges, points, side='right')
    return np.minimum(chosen, len(weights) - 1).astype(np.int32)
