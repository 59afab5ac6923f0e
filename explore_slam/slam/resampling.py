"""Weights of particles: normalization, effective sample size, systematic resampling."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from explore_slam.geometry import Array


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
    """Return standard normal samples (M, D), a Latin hypercube: each dimension evenly covered.

    Less of the estimate's variance comes from the draw than with independent samples.
    """
    strata = np.tile(np.arange(particles), (dimensions, 1))
    uniform = (random.permuted(strata, axis=1) + random.random(strata.shape)) / particles
    normals: Array = np.ascontiguousarray(ndtri(np.clip(uniform, 1e-12, 1.0 - 1e-12)).T)
    return normals


def systematic_ancestors(weights: Array, offset: float) -> NDArray[np.int32]:
    """Return the ancestor (M,) of each particle after systematic resampling, in ascending order.

    offset is uniform in [0, 1). The order keeps the descendants of one particle together, on
    which Genealogy relies.
    """
    count = len(weights)
    edges = np.cumsum(weights)
    edges /= edges[-1]
    points = (np.arange(count) + offset) / count
    chosen = np.searchsorted(edges, points, side='right')
    return np.minimum(chosen, count - 1).astype(np.int32)
