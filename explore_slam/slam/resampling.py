"""Weights of particles: normalization, effective sample size, systematic resampling."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from explore_slam.geometry import Array

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
