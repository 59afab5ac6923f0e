"""Point clouds of laser scans: points with the normals of the surfaces that they lie on.

A cloud is in the frame of its vehicle at the stamp of the scan.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.data import LaserScan
from explore_slam.errors import RegistrationError
from explore_slam.geometry import IDENTITY, Array, Pose2

# Chosen on the Intel, ACES and Belgioioso logs; `benchmarks/laser_graph_slam.py` shows what a
# change does.
_MINIMUM_RANGE = 0.05  # m; nearer returns are the vehicle itself or dust on the window
# neighbours on one side that a line is fitted through
_BEAMS_EITHER_SIDE = 2
_LINE_REACH = 0.4  # m from a return to the neighbours of its line, at close range
_LINE_REACH_GROWTH = 0.09  # m per m of range: five beams of 1 degree
_MINIMUM_LINE_POINTS = 3  # two points are a line always, three show whether there is one
_STRAIGHTNESS = 0.1  # largest variance across a line, as a fraction of that along and across
# At grazing incidence a laser sees only what protrudes from a wall. To a vehicle that drives past,
# the wall then seems to lie farther away, and the vehicle to have driven too far: by 0.17 % in
# Willow Garage, whose walls are uneven by a cell of 0.05 m, and by 0.10 % with these.
_GRAZING = 0.2  # cosine of incidence of a return that counts half as much as one at a right angle
# m; farther returns all count the same: few but grazing ones show the heading in a long corridor
_GRAZING_RANGE = 5.0
_MAP_SPACING = 0.1  # m; two cells of the likelihood grid
_QUERY_SPACING = 0.2  # m; half the points find the same peak


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points (n, 2) m as measured at one moment, unit normals (n, 2), and weights (n,).

    The normal points towards the laser: the two faces of a thin wall differ. It is zero where
    the neighbouring returns do not form a line (edges, clutter, lone returns). The weight, from
    0 to 1, is that of the return in an alignment: low where the beam grazes its surface.
    """

    points: Array
    normals: Array
    weights: Array

    def __post_init__(self) -> None:
        count = len(self.points)
        for name, shape in (
            ('points', (count, 2)),
            ('normals', (count, 2)),
            ('weights', (count,)),
        ):
            values = getattr(self, name)
            if values.shape != shape:
                raise RegistrationError(
                    f'PointCloud: {name} has shape {values.shape}, expected {shape}'
                )
            if not np.isfinite(values).all():
                raise RegistrationError(f'PointCloud: {name} holds values that are not finite')

    def __len__(self) -> int:
        return len(self.points)

    @cached_property
    def on_surfaces(self) -> NDArray[np.bool_]:
        """Mask (n,) of the points that have a normal."""
        mask: NDArray[np.bool_] = (self.normals != 0.0).any(axis=1)
        return mask

    @cached_property
    def surfaces(self) -> tuple[Array, Array]:
        """Points (m, 2) that have a normal, and their normals (m, 2)."""
        return self.points[self.on_surfaces], self.normals[self.on_surfaces]

    @property
    def surface_weights(self) -> Array:
        """Weights (m,) of the points that have a normal."""
        return self.weights[self.on_surfaces]

    @cached_property
    def sparse_points(self) -> Array:
        """Points (k, 2), one for each occupied square of 0.1 m: the map of a correlation."""
        return thinned(self.points, _MAP_SPACING)

    @cached_property
    def query_points(self) -> Array:
        """Points (k, 2), one for each occupied square of 0.2 m: what is correlated with a map."""
        return thinned(self.points, _QUERY_SPACING)

    def moved(self, pose: Pose2) -> Self:
        """Return the cloud given in the frame of the pose in the frame that the pose is in."""
        c, s = math.cos(pose.theta), math.sin(pose.theta)
        turn = np.array([[c, s], [-s, c]])
        points = self.points @ turn + (pose.x, pose.y)
        result = replace(self, points=points, normals=self.normals @ turn)
        # the choice of points for correlation does not depend on the frame
        result.__dict__['sparse_points'] = self.sparse_points @ turn + (pose.x, pose.y)
        return result

    def masked(self, discs: Sequence[tuple[float, float, float]]) -> Self:
        """Return the cloud without the points in discs (x m, y m, radius m): other vehicles."""
        if not discs or not len(self):
            return self
        centres = np.asarray(discs, dtype=np.float64)
        if centres.shape != (len(discs), 3) or not np.isfinite(centres).all():
            raise RegistrationError(f'discs are {discs!r}, expected finite (x, y, radius)')
        off = self.points[:, None] - centres[None, :, :2]
        keep = ((off**2).sum(axis=2) > centres[:, 2] ** 2).all(axis=1)
        return self if keep.all() else self.only(keep)

    def only(self, keep: NDArray[np.bool_]) -> Self:
        """Return the points under a mask (n,)."""
        return replace(
            self,
            points=self.points[keep],
            normals=self.normals[keep],
            weights=self.weights[keep],
        )

    @classmethod
    def empty(cls) -> Self:
        """Make a cloud without points."""
        return cls(np.empty((0, 2)), np.empty((0, 2)), np.empty(0))


def merged(clouds: Sequence[PointCloud]) -> PointCloud:
    """Return the points of several clouds that are in the same frame as one cloud."""
    if not clouds:
        return PointCloud.empty()
    return PointCloud(
        np.concatenate([cloud.points for cloud in clouds]),
        np.concatenate([cloud.normals for cloud in clouds]),
        np.concatenate([cloud.weights for cloud in clouds]),
    )


def thinned(points: Array, spacing: float) -> Array:
    """Return the first point (k, 2) in each occupied square of the spacing (m), in order."""
    if not len(points):
        return points
    cells = np.round(points / spacing).astype(np.int64)
    cells -= cells.min(axis=0)
    _, first = np.unique(cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1], return_index=True)
    kept: Array = points[np.sort(first)]
    return kept


def scan_cloud(
    scan: LaserScan,
    laser: Pose2 = IDENTITY,
    farthest: float = math.inf,
) -> PointCloud:
    """Return the valid returns of a scan in the vehicle frame, with the normals of surfaces.

    Readings that are not finite, outside [range_min, range_max] or beyond farthest (m) are no
    returns. laser: its pose on the vehicle. All beams count as measured at one moment, see
    `explore_slam.sweeps.deskewed`.
    """
    ranges = scan.ranges.astype(np.float64)
    valid = np.isfinite(ranges) & (ranges >= max(scan.range_min, _MINIMUM_RANGE))
    valid &= ranges <= min(scan.range_max, farthest)
    ranges, angles = ranges[valid], scan.angles[valid]
    points = np.stack([np.cos(angles), np.sin(angles)], axis=1) * ranges[:, None]
    if not len(points):
        return PointCloud.empty()
    normals = _line_normals(points, ranges)
    across = ((normals * points).sum(axis=1) / ranges) ** 2
    weights = np.where(ranges < _GRAZING_RANGE, across / (across + _GRAZING**2), 1.0)
    cloud = PointCloud(points, normals, weights)
    return cloud if laser == IDENTITY else cloud.moved(laser)


@kernel
def _line_normals(points: Array, ranges: Array) -> Array:
    """Return the normals (n, 2) of lines fitted through the neighbours of each return.

    The laser is at the origin and the returns are in the order of the beams. The fit is total
    least squares. The normal is zero where there is no line.
    """
    count = len(points)
    normals = np.zeros((count, 2))
    for i in range(count):
        reach = _LINE_REACH + _LINE_REACH_GROWTH * ranges[i]
        on_line, x, y, xx, xy, yy = 1, 0.0, 0.0, 0.0, 0.0, 0.0
        for side in (-1, 1):
            for k in range(1, _BEAMS_EITHER_SIDE + 1):
                j = i + side * k
                if j < 0 or j >= count:
                    break
                dx, dy = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
                if dx * dx + dy * dy > reach * reach:
                    break
                on_line += 1
                x += dx
                y += dy
                xx += dx * dx
                xy += dx * dy
                yy += dy * dy
        if on_line < _MINIMUM_LINE_POINTS:
            continue
        x, y = x / on_line, y / on_line
        xx, xy, yy = xx / on_line - x * x, xy / on_line - x * y, yy / on_line - y * y
        across = 0.5 * (xx + yy) - math.hypot(0.5 * (xx - yy), xy)
        if across > _STRAIGHTNESS * (xx + yy):
            continue
        heading = 0.5 * math.atan2(2.0 * xy, xx - yy)
        nx, ny = -math.sin(heading), math.cos(heading)
        if nx * points[i, 0] + ny * points[i, 1] > 0.0:
            nx, ny = -nx, -ny
        normals[i, 0], normals[i, 1] = nx, ny
    return normals
