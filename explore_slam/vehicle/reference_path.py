"""The path of a plan as a function of arc length: projection, point ahead."""

import numpy as np

from explore_slam.geometry import Array
from explore_slam.polyline import points_at

_SHORTEST_STEP = 1e-6  # m; repeated waypoints have no direction and are dropped


class ReferencePath:
    """A polyline parameterized by arc length s (m); a single waypoint has length 0."""

    def __init__(self, waypoints: Array) -> None:
        points = np.asarray(waypoints, dtype=np.float64).reshape(-1, 2)
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        keep = np.concatenate(([True], steps > _SHORTEST_STEP))
        self.points = points[keep]
        self.s = np.concatenate(([0.0], np.cumsum(steps[steps > _SHORTEST_STEP])))

    @property
    def length(self) -> float:
        """Length of the path (m)."""
        return float(self.s[-1])

    def point_at(self, s: float) -> Array:
        """Return the point (2,) at arc length s, clamped to the ends."""
        point: Array = points_at(self.points, self.s, np.array([s]))[0]
        return point

    def project(self, position: Array, start: float, window: float) -> tuple[float, float]:
        """Return arc length and signed distance (m) of the point nearest to a position (2,) m.

        Only start <= s <= start + window (m) is searched, since paths may cross themselves. The
        distance is positive if the position lies left of the path.
        """
        if self.length == 0.0:
            return 0.0, float(np.linalg.norm(position - self.points[0]))
        first = max(int(np.searchsorted(self.s, start, side='right')) - 1, 0)
        last = int(np.searchsorted(self.s, start + window, side='left'))
        first = min(first, len(self.points) - 2)
        last = min(max(last, first + 1), len(self.points) - 1)
        a, b = self.points[first:last], self.points[first + 1 : last + 1]
        along = b - a
        lengths = np.linalg.norm(along, axis=1)
        offset = position - a
        t = np.clip(np.einsum('ij,ij->i', offset, along) / lengths**2, 0.0, 1.0)
        gaps = offset - t[:, None] * along
        distances = np.hypot(gaps[:, 0], gaps[:, 1])
        best = int(np.argmin(distances))
        side = along[best, 0] * offset[best, 1] - along[best, 1] * offset[best, 0]
        s = float(self.s[first + best] + t[best] * lengths[best])
        return max(s, start), float(np.copysign(distances[best], side))
