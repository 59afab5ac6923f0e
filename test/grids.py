"""Occupancy grids compared."""

import numpy as np


def same_grid(one, other):
    """Return whether extent and evidence of two occupancy grids are equal bit for bit."""
    return one.origin == other.origin and np.array_equal(one.evidence(), other.evidence())
