"""Angles in compiled functions."""

import math

from explore_slam.compiled import kernel


@kernel
def wrapped(angle: float) -> float:
    """Return an angle (rad) wrapped into [-pi, pi).

    `explore_slam.slam.graph.se2.wrapped`, a layer above, keeps the bits of angles in range; this
    one rounds them, and scan matching would change in the last bit with the other.
    """
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
