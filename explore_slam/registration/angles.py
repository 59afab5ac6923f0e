"""Angles in compiled functions."""

import math

from explore_slam.compiled import kernel


@kernel
def wrapped(angle: float) -> float:
    """Return an angle (rad) wrapped into [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
