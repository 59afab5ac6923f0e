"""Validation of what is recorded in the graph; all checks precede any change of it."""

import numpy as np
from numpy.typing import ArrayLike

from explore_slam.errors import SlamError
from explore_slam.geometry import Array
from explore_slam.slam.graph.factors import Integers

# m, rad: minimum standard deviation of a measurement, so that exact knowledge (a vehicle at rest,
# a start that defines the map) leaves the information matrix well conditioned
EXACT_DEVIATION = 1e-6
SYMMETRY = 1e-6  # of the largest entry: what rounding may have done to a symmetric matrix
ROUNDING = 1e-9  # of the largest entry: an eigenvalue this far below zero is zero


def matrix(what: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return finite numbers in this shape as a new array."""
    try:
        found = np.array(values, np.float64)
    except (TypeError, ValueError) as error:
        raise SlamError(f'{what}: {error}, expected numbers of shape {shape}') from error
    if found.shape != shape:
        raise SlamError(f'{what} has shape {found.shape}, expected {shape}')
    if not np.isfinite(found).all():
        raise SlamError(f'{what} is {found.tolist()}, expected finite values')
    return found


def integers(what: str, values: ArrayLike) -> Integers:
    """Return a new array (n,) of numbers that are whole and not negative."""
    found = np.array(values)
    if found.size == 0:
        return np.empty(0, np.int64)
    if found.ndim != 1 or found.dtype.kind not in 'iu' or found.min() < 0:
        raise SlamError(f'{what} is {found.tolist()}, expected a list of whole numbers from 0')
    return found.astype(np.int64)


def symmetric(what: str, values: ArrayLike, size: int) -> Array:
    """Return a symmetric matrix (size, size) without eigenvalues below zero."""
    found = matrix(what, values, (size, size))
    scale = max(float(np.abs(found).max()), 1e-300)
    if np.abs(found - found.T).max() > SYMMETRY * scale:
        raise SlamError(f'{what} is {found.tolist()}, expected a symmetric matrix')
    found = 0.5 * (found + found.T)
    least = float(np.linalg.eigvalsh(found)[0])
    if least < -max(ROUNDING * scale, EXACT_DEVIATION**2):  # below both it is rounding
        raise SlamError(f'{what} has the eigenvalue {least:.3g}, expected none below 0')
    return found


def information(what: str, covariance: ArrayLike | None, size: int = 3) -> Array:
    """Return the inverse of a covariance, which may be zero; None: exactly known."""
    if covariance is None:
        return EXACT_DEVIATION**-2 * np.eye(size)
    eigenvalues, vectors = np.linalg.eigh(symmetric(what, covariance, size))
    # of a nearly singular matrix, the ordinary inverse may have eigenvalues below zero
    weights = 1.0 / (np.maximum(eigenvalues, 0.0) + EXACT_DEVIATION**2)
    inverse: Array = (vectors * weights) @ vectors.T
    return 0.5 * (inverse + inverse.T)


def bounded_information(what: str, values: ArrayLike, size: int = 3) -> Array:
    """Return an information matrix, which may be singular but not more than exact."""
    found = symmetric(what, values, size)
    largest = float(np.linalg.eigvalsh(found)[-1])
    if largest > EXACT_DEVIATION**-2:
        raise SlamError(
            f'{what} has the eigenvalue {largest:.3g}, expected at most '
            f'{EXACT_DEVIATION**-2:.3g}, a deviation of {EXACT_DEVIATION:.0e}'
        )
    return found


def packed_information(what: str, R: ArrayLike, count: int) -> Array:
    """Return the inverses (n, 6) of covariances (n, 6), both as xx xy xz yy yz zz."""
    packed = matrix(what, R, (count, 6))
    full = packed[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    eigenvalues = np.linalg.eigvalsh(full)
    bad = np.flatnonzero(eigenvalues[:, 0] <= 1e-10 * np.maximum(eigenvalues[:, 2], 1e-300))
    if len(bad):
        raise SlamError(
            f'{what}: covariance {bad[0]} is {packed[bad[0]].tolist()} with the smallest '
            f'eigenvalue {eigenvalues[bad[0], 0]:.3g}, expected a positive definite matrix'
        )
    full += EXACT_DEVIATION**2 * np.eye(3)
    inverse: Array = np.linalg.inv(full).reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]]
    return inverse
