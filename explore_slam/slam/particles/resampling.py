"""Weights of particles: normalization, moments, effective sample size, resampling."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from explore_slam.geometry import Array, Pose2, wrap_angles

# Consecutive particles that share the coarse strata: in the order of the number of copies that a
# resampling makes of one particle.
STRATUM_SIZE = 8
_MINIMUM_PROBABILITY = 1e-12  # samples are cut at 7 sigma, so that none is infinite


def normalized(log_weights: Array) -> tuple[Array, Array]:
    """Return log weights shifted so that the weights sum to one, and these weights, both (M,)."""
    shifted = log_weights - log_weights.max()
    weights = np.exp(shifted)
    total = weights.sum()
    return shifted - np.log(total), weights / total


def effective_particles(weights: Array) -> float:
    """Return the effective sample size 1 / Σ w² of normalized weights (M,), 1 to M (Liu, 1996)."""
    return float(1.0 / np.sum(weights * weights))


def mean_and_covariance(poses: Array, weights: Array) -> tuple[Pose2, Array]:
    """Return mean and covariance (3, 3) of poses (M, 3) with normalized weights (M,)."""
    c, s = weights @ np.cos(poses[:, 2]), weights @ np.sin(poses[:, 2])
    mean = np.array([weights @ poses[:, 0], weights @ poses[:, 1], math.atan2(s, c)])
    off = poses - mean
    off[:, 2] = wrap_angles(off[:, 2])
    return Pose2.from_array(mean), (off * weights[:, None]).T @ off


def stratified_normals(random: np.random.Generator, particles: int, dimensions: int) -> Array:
    """Return standard normal samples (M, D) from a Latin hypercube (McKay et al., 1979).

    Each dimension is covered evenly by all particles and, in coarse strata, by any STRATUM_SIZE
    consecutive ones: the copies of one particle are neighbours, and spread out. Less of the
    estimate's variance comes from sampling than with independent samples.
    """
    groups = -(-particles // STRATUM_SIZE)
    uniform = np.empty((groups * STRATUM_SIZE, dimensions))
    coarse_first = np.tile(np.arange(STRATUM_SIZE), (groups, 1))
    fine_first = np.tile(np.arange(groups), (STRATUM_SIZE, 1))
    for dimension in range(dimensions):
        coarse = random.permuted(coarse_first, axis=1)
        fine = random.permuted(fine_first, axis=1)[coarse, np.arange(groups)[:, None]]
        uniform[:, dimension] = (coarse * groups + fine).ravel()
    uniform = (uniform + random.random(uniform.shape)) / len(uniform)
    normals: Array = ndtri(
        np.clip(uniform[:particles], _MINIMUM_PROBABILITY, 1.0 - _MINIMUM_PROBABILITY)
    )
    return normals


def systematic_ancestors(
    weights: Array, offset: float, particles: int | None = None
) -> NDArray[np.int32]:
    """Return the ancestors (M,) of systematic resampling (Kitagawa, 1996), in ascending order.

    offset is uniform in [0, 1); particles: their number, by default as many as before. The order
    keeps the descendants of one particle together.
    """
    count = len(weights) if particles is None else particles
    edges = np.cumsum(weights)
    edges /= edges[-1]
    points = (np.arange(count) + offset) / count
    chosen = np.searchsorted(edges, points, side='right')
    return np.minimum(chosen, len(weights) - 1).astype(np.int32)
