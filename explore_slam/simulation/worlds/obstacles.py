"""Clearance of a point: distance to the nearest solid of a world, seen from above."""

import numpy as np

from explore_slam.geometry import Array
from explore_slam.simulation.worlds.world import World


class Obstacles:
    """The footprints of all solids of a world as arrays.

    height: of a vehicle (m); what hangs lower, and pits, count as well. 0: solids alone.
    """

    def __init__(self, world: World, height: float = 0.0) -> None:
        footprints = (*world.blocks, *(world.hazards(height) if height > 0.0 else ()))
        blocks = np.array([block[:5] for block in footprints], dtype=np.float64).reshape(-1, 5)
        self._center, self._half = blocks[:, :2], blocks[:, 2:4]
        self._cos, self._sin = np.cos(blocks[:, 4]), np.sin(blocks[:, 4])
        pillars = np.array([p[:3] for p in world.pillars], dtype=np.float64).reshape(-1, 3)
        self._axes, self._radii = pillars[:, :2], pillars[:, 2]

    def clearance(self, x: float, y: float) -> float:
        """Return the signed distance (m) from a point to the nearest solid; negative inside."""
        nearest = np.inf
        if len(self._center):
            nearest = min(nearest, float(self._to_blocks(x, y).min()))
        if len(self._axes):
            dx, dy = x - self._axes[:, 0], y - self._axes[:, 1]
            nearest = min(nearest, float((np.hypot(dx, dy) - self._radii).min()))
        return nearest

    def _to_blocks(self, x: float, y: float) -> Array:
        """Return the signed distances (B,) m from a point to all rectangles."""
        dx, dy = x - self._center[:, 0], y - self._center[:, 1]
        u = np.abs(self._cos * dx + self._sin * dy) - self._half[:, 0]
        v = np.abs(self._cos * dy - self._sin * dx) - self._half[:, 1]
        outside: Array = np.hypot(np.maximum(u, 0.0), np.maximum(v, 0.0))
        return outside + np.minimum(np.maximum(u, v), 0.0)
