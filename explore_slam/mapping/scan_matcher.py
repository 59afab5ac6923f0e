"""Laser odometry of one vehicle: every scan is laid onto the scans of the way just driven.

Point-to-line ICP (Censi, ICRA 2008) of a scan against a window of earlier scans in the odometry
frame, with the wheels' motion as prior: what the walls do not tell, say along a corridor, stays
as the wheels have it. Matching against a window, not just the last scan, keeps the error from
growing while the vehicle sees the same place.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.data import LaserScan
from explore_slam.geometry import IDENTITY, Array, Pose2
from explore_slam.mapping.config import ScanMatchingConfig

_ITERATIONS = 12
_FINEST = np.array([3e-4, 3e-4, 1e-4])  # m, m, rad: a step below this ends the search
_LEAST_DEVIATIONS = np.array([1e-4, 1e-4, 1e-4])  # m, m, rad, of any motion
_FEWEST_POINTS = 15
_NEIGHBOURHOOD = 0.026  # rad on either side of a beam in which returns make a line
_INDEPENDENT_POINTS = 60.0  # errors of neighbouring beams go together
_SPACING = 0.03  # m between returns that are used
_CELL = 0.1  # m
# Matches with one window err together: the motion between two of them is known better than
# each pose by itself.
_WINDOW_GAIN = 50.0


@dataclass(frozen=True)
class ScanMatch:
    """Where a scan was taken: vehicle pose in the odometry frame.

    covariance (3, 3): of the motion that the prior was told, in the vehicle frame; overlap:
    part of the returns that lie on known walls.
    """

    pose: Pose2
    covariance: Array
    overlap: float


class Cloud(NamedTuple):
    """Points (n, 2) with unit normals (n, 2)."""

    points: Array
    normals: Array

    def moved(self, pose: Pose2) -> 'Cloud':
        """Return the cloud of the vehicle frame in the frame of the pose."""
        c, s = math.cos(pose.theta), math.sin(pose.theta)
        turn = np.array([[c, s], [-s, c]])
        return Cloud(self.points @ turn + (pose.x, pose.y), self.normals @ turn)


def scan_cloud(scan: LaserScan, laser: Pose2, farthest: float) -> Cloud:
    """Return the returns of a scan that lie on lines, in the vehicle frame, with their normals.

    A line is fitted through the neighbouring beams of each return; where they jump in depth or
    do not lie on a line there is none, and the return is left out. Normals point to the laser:
    the two faces of a thin wall are not the same.
    """
    ranges = scan.ranges.astype(np.float64)
    valid = np.isfinite(ranges) & (ranges >= max(scan.range_min, 0.05))
    valid &= ranges <= min(scan.range_max, farthest)
    ranges = np.where(valid, ranges, 0.0)
    angles = scan.angles + laser.theta
    points = np.stack([np.cos(angles), np.sin(angles)], axis=1) * ranges[:, None]
    points += (laser.x, laser.y)
    count = len(points)
    half = min(max(round(_NEIGHBOURHOOD / abs(scan.angle_increment)), 1), 5)
    if count < 2 * half + 1:
        return Cloud(np.empty((0, 2)), np.empty((0, 2)))
    window = np.arange(-half, half + 1) + np.arange(half, count - half)[:, None]
    step = np.abs(np.diff(ranges[window], axis=1)).max(axis=1)
    middle = ranges[half : count - half]
    whole = valid[window].all(axis=1) & (step < 0.05 + 0.1 * middle)
    near = points[window[whole]]
    center = near.mean(axis=1)
    off = near - center[:, None]
    xx, yy = (off[..., 0] ** 2).mean(1), (off[..., 1] ** 2).mean(1)
    xy = (off[..., 0] * off[..., 1]).mean(1)
    across = 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy)
    heading = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    straight = across < 0.02**2
    normals = np.stack([-np.sin(heading), np.cos(heading)], axis=1)
    own, normals = points[half : count - half][whole][straight], normals[straight]
    away = (normals * (own - (laser.x, laser.y))).sum(axis=1) > 0.0
    normals[away] *= -1.0
    if not len(own):
        return Cloud(own, normals)
    way = np.cumsum(np.hypot(*np.diff(own, axis=0, prepend=own[:1]).T)) // _SPACING
    thin = np.diff(way, prepend=-1.0) > 0.0
    return Cloud(own[thin], normals[thin])


class _Cells(NamedTuple):
    """Points of the window sorted by square cells of a grid over them (for search nearby).

    x, y of the lower corner (m), columns, rows; first (columns * rows + 1,) point of each cell;
    points and normals (n, 2) in that order.
    """

    x: float
    y: float
    columns: int
    rows: int
    first: NDArray[np.int64]
    points: Array
    normals: Array


def _sorted_into_cells(cloud: Cloud) -> _Cells:
    low = cloud.points.min(axis=0) - _CELL
    across = ((cloud.points - low) / _CELL).astype(np.int64)
    columns, rows = (across.max(axis=0) + 2).tolist()
    cell = across[:, 1] * columns + across[:, 0]
    order = np.argsort(cell, kind='stable')
    first = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=columns * rows))])
    x, y = low.tolist()
    return _Cells(x, y, columns, rows, first, cloud.points[order], cloud.normals[order])


@kernel
def _normal_equations(
    cloud: Cloud, cells: _Cells, pose: tuple[float, float, float], reach: float, deviation: float
) -> tuple[Array, Array, int]:
    """Return A (3, 3) and b (3,) of A δ = b for the error δ of a pose, and the points matched.

    Each point goes to the nearest wall point within reach whose normal differs by less than 37
    degrees; residuals are point to line, with Cauchy weights of a standard deviation (m).
    """
    A, b, matched = np.zeros((3, 3)), np.zeros(3), 0
    points, normals = cloud.points, cloud.normals
    x, y, columns, rows, first, walls, across = cells
    px, py, theta = pose
    c, s = math.cos(theta), math.sin(theta)
    around = math.ceil(reach / _CELL)
    for n in range(len(points)):
        lx, ly = points[n, 0], points[n, 1]
        wx, wy = px + c * lx - s * ly, py + s * lx + c * ly
        nx, ny = c * normals[n, 0] - s * normals[n, 1], s * normals[n, 0] + c * normals[n, 1]
        column, row = int((wx - x) / _CELL), int((wy - y) / _CELL)
        best, nearest = reach * reach, -1
        for r in range(max(row - around, 0), min(row + around + 1, rows)):
            low = first[r * columns + min(max(column - around, 0), columns)]
            high = first[r * columns + min(max(column + around + 1, 0), columns)]
            for k in range(low, high):
                dx, dy = walls[k, 0] - wx, walls[k, 1] - wy
                square = dx * dx + dy * dy
                if square < best and nx * across[k, 0] + ny * across[k, 1] > 0.8:
                    best, nearest = square, k
        if nearest < 0:
            continue
        matched += 1
        nx, ny = across[nearest, 0], across[nearest, 1]
        residual = nx * (walls[nearest, 0] - wx) + ny * (walls[nearest, 1] - wy)
        jx, jy = c * nx + s * ny, c * ny - s * nx
        jt = jy * lx - jx * ly
        weight = 1.0 / (deviation * deviation + residual * residual)
        A[0, 0] += weight * jx * jx
        A[0, 1] += weight * jx * jy
        A[0, 2] += weight * jx * jt
        A[1, 1] += weight * jy * jy
        A[1, 2] += weight * jy * jt
        A[2, 2] += weight * jt * jt
        b[0] += weight * jx * residual
        b[1] += weight * jy * residual
        b[2] += weight * jt * residual
    A[1, 0], A[2, 0], A[2, 1] = A[0, 1], A[0, 2], A[1, 2]
    if matched > _INDEPENDENT_POINTS:
        A *= _INDEPENDENT_POINTS / matched
        b *= _INDEPENDENT_POINTS / matched
    return A, b, matched


class ScanMatcher:
    """Window of earlier scans of one vehicle in its odometry frame, and the search in it."""

    def __init__(self, config: ScanMatchingConfig) -> None:
        self.config = config
        self._window: deque[Cloud] = deque(maxlen=config.matching_window)
        self._last: Pose2 = IDENTITY
        self._cells: _Cells | None = None

    @property
    def started(self) -> bool:
        """Tell whether there are scans to match with."""
        return self._cells is not None

    def reset(self) -> None:
        """Forget all scans: the vehicle has been lifted, or time has jumped."""
        self._window.clear()
        self._cells = None

    def match(
        self, scan: LaserScan, laser: Pose2, prior: Pose2, covariance: Array
    ) -> ScanMatch | None:
        """Return the pose of the vehicle at a scan, or None where it lies on nothing known.

        laser: its pose on the vehicle; prior: pose by the wheels, with covariance (3, 3) in the
        vehicle frame. The scan enters the window when the vehicle has moved on far enough.
        """
        cloud = scan_cloud(scan, laser, self.config.matching_range)
        if len(cloud.points) < _FEWEST_POINTS:
            return None
        found = self._search(cloud, prior, covariance) if self._cells is not None else None
        pose = found.pose if found is not None else prior
        self._keep(cloud, pose)
        return found

    def _keep(self, cloud: Cloud, pose: Pose2) -> None:
        moved = self._last.between(pose)
        if (
            self._window
            and math.hypot(moved.x, moved.y) < self.config.window_distance
            and abs(moved.theta) < self.config.window_heading
        ):
            return
        self._last = pose
        self._window.append(cloud.moved(pose))
        self._cells = _sorted_into_cells(
            Cloud(
                np.concatenate([part.points for part in self._window]),
                np.concatenate([part.normals for part in self._window]),
            )
        )

    def _search(self, cloud: Cloud, prior: Pose2, covariance: Array) -> ScanMatch | None:
        """Gauss-Newton over the vehicle's error δ in its own frame, with the prior N(0, P)."""
        assert self._cells is not None
        certainty = np.linalg.inv(covariance + np.diag(_LEAST_DEVIATIONS**2))
        pose, reach, config = prior, self.config.matching_reach, self.config
        for iteration in range(_ITERATIONS):
            A, b, matched = _normal_equations(
                cloud, self._cells, (pose.x, pose.y, pose.theta), reach, config.matching_deviation
            )
            if matched < max(_FEWEST_POINTS, config.matching_overlap * len(cloud.points)):
                return None
            off = np.asarray(pose.between(prior))
            step = np.linalg.solve(A + certainty, b + certainty @ off)
            pose = pose.compose(Pose2.from_array(step))
            reach = max(0.5 * reach, _CELL)
            if iteration > 1 and (np.abs(step) < _FINEST).all():
                break
        off = np.asarray(prior.between(pose))
        if off @ certainty @ off > config.matching_gate**2:
            return None
        left = np.linalg.inv(_WINDOW_GAIN * A + certainty) + config.matching_drift * covariance
        return ScanMatch(pose, left, matched / len(cloud.points))
