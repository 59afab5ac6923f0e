"""Laser odometry of one vehicle: match each scan with a window of recent ones.

Point-to-line ICP (Censi, "An ICP variant using a point-to-line metric", ICRA 2008) in the odometry
frame, with wheel odometry as prior: directions that the walls leave free, say along a corridor,
keep the motion of the wheels. Matching with a window instead of the last scan keeps the error from
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
from explore_slam.geometry import IDENTITY, Array, Pose2, moved_enough
from explore_slam.mapping.config import ScanMatchingConfig

# Design values: plausible for indoor lasers of 0.5 to 1 degree, not chosen by a study.
_ITERATIONS = 12  # at most
_CONVERGED = np.array([3e-4, 3e-4, 1e-4])  # m, m, rad; a step below this ends the iteration
_MINIMUM_DEVIATIONS = np.array([1e-4, 1e-4, 1e-4])  # m, m, rad; of the prior
_MINIMUM_POINTS = 15  # returns that a match needs
_MINIMUM_RANGE = 0.05  # m; nearer returns are the vehicle itself
_NEIGHBOURHOOD = 0.026  # rad on either side of a beam in which the returns form a line
_MAXIMUM_NEIGHBOURS = 5  # beams on either side of a beam
_DEPTH_STEP, _DEPTH_STEP_PER_METRE = 0.05, 0.1  # m, m/m; larger steps separate two surfaces
_LINE_DEVIATION = 0.02  # m; RMS distance of the returns from their line
_NORMAL_AGREEMENT = 0.8  # cosine of 37 degrees between the normals of corresponding points
_INDEPENDENT_POINTS = 60.0  # errors of neighbouring beams are correlated: more count as so many
_SPACING = 0.03  # m between returns that are matched
_CELL = 0.1  # m; of the search grid, and the smallest correspondence distance
# Matches with the same window share its error: the motion between two of them is more accurate
# than each pose by itself, by this factor in information.
_WINDOW_GAIN = 50.0


@dataclass(frozen=True)
class ScanMatch:
    """Result of matching a scan.

    pose: of the vehicle in the odometry frame.
    covariance (3, 3): of the motion whose covariance the prior had, in the vehicle frame.
    overlap: fraction of the returns that have a correspondence.
    """

    pose: Pose2
    covariance: Array
    overlap: float


class Cloud(NamedTuple):
    """Points (n, 2) m with unit normals (n, 2)."""

    points: Array
    normals: Array

    def moved(self, pose: Pose2) -> 'Cloud':
        """Return a cloud in the vehicle frame transformed by the pose of the vehicle."""
        c, s = math.cos(pose.theta), math.sin(pose.theta)
        turn = np.array([[c, s], [-s, c]])
        return Cloud(self.points @ turn + (pose.x, pose.y), self.normals @ turn)


def scan_cloud(scan: LaserScan, laser: Pose2, farthest: float) -> Cloud:
    """Return the returns of a scan that lie on lines, with their normals, in the vehicle frame.

    laser: its pose in the vehicle frame.
    farthest: returns beyond this range (m) are discarded.
    A line is fitted to the neighbouring beams of each return; returns at a step in depth and
    those off a line are discarded. Normals point to the laser, which tells the two faces of a
    thin wall apart.
    """
    ranges = scan.ranges.astype(np.float64)
    valid = np.isfinite(ranges) & (ranges >= max(scan.range_min, _MINIMUM_RANGE))
    valid &= ranges <= min(scan.range_max, farthest)
    ranges = np.where(valid, ranges, 0.0)
    angles = scan.angles + laser.theta
    points = np.stack([np.cos(angles), np.sin(angles)], axis=1) * ranges[:, None]
    points += (laser.x, laser.y)
    count = len(points)
    half = min(max(round(_NEIGHBOURHOOD / abs(scan.angle_increment)), 1), _MAXIMUM_NEIGHBOURS)
    if count < 2 * half + 1:
        return Cloud(np.empty((0, 2)), np.empty((0, 2)))
    window = np.arange(-half, half + 1) + np.arange(half, count - half)[:, None]
    step = np.abs(np.diff(ranges[window], axis=1)).max(axis=1)
    middle = ranges[half : count - half]
    whole = valid[window].all(axis=1) & (step < _DEPTH_STEP + _DEPTH_STEP_PER_METRE * middle)
    near = points[window[whole]]
    center = near.mean(axis=1)
    off = near - center[:, None]
    xx, yy = (off[..., 0] ** 2).mean(1), (off[..., 1] ** 2).mean(1)
    xy = (off[..., 0] * off[..., 1]).mean(1)
    across = 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy)
    heading = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    straight = across < _LINE_DEVIATION**2
    normals = np.stack([-np.sin(heading), np.cos(heading)], axis=1)
    own, normals = points[half : count - half][whole][straight], normals[straight]
    away = (normals * (own - (laser.x, laser.y))).sum(axis=1) > 0.0
    normals[away] *= -1.0
    if not len(own):
        return Cloud(own, normals)
    lengths = np.cumsum(np.hypot(*np.diff(own, axis=0, prepend=own[:1]).T))
    kept = np.diff(lengths // _SPACING, prepend=-1.0) > 0.0
    return Cloud(own[kept], normals[kept])


class _Cells(NamedTuple):
    """Points of the window sorted by the cells of a grid, for the search of neighbours.

    x, y: lower left corner of the grid (m).
    first (columns * rows + 1,): index of the first point of each cell.
    points, normals (n, 2): in the order of the cells.
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
    cloud: Cloud,
    cells: _Cells,
    pose: tuple[float, float, float],
    max_distance: float,
    deviation: float,
) -> tuple[Array, Array, int]:
    """Return A (3, 3) and b (3,) of A δ = b for the error δ of a pose, and the matched points.

    Each point corresponds to the nearest point of the window within max_distance (m) whose normal
    agrees. Residuals are point to line, with Cauchy weights of the standard deviation (m).
    """
    A, b, matched = np.zeros((3, 3)), np.zeros(3), 0
    points, normals = cloud.points, cloud.normals
    x, y, columns, rows, first, walls, across = cells
    px, py, theta = pose
    c, s = math.cos(theta), math.sin(theta)
    reach = math.ceil(max_distance / _CELL)
    for n in range(len(points)):
        lx, ly = points[n, 0], points[n, 1]
        wx, wy = px + c * lx - s * ly, py + s * lx + c * ly
        nx, ny = c * normals[n, 0] - s * normals[n, 1], s * normals[n, 0] + c * normals[n, 1]
        column, row = int((wx - x) / _CELL), int((wy - y) / _CELL)
        best, nearest = max_distance * max_distance, -1
        for r in range(max(row - reach, 0), min(row + reach + 1, rows)):
            low = first[r * columns + min(max(column - reach, 0), columns)]
            high = first[r * columns + min(max(column + reach + 1, 0), columns)]
            for k in range(low, high):
                dx, dy = walls[k, 0] - wx, walls[k, 1] - wy
                square = dx * dx + dy * dy
                agreement = nx * across[k, 0] + ny * across[k, 1]
                if square < best and agreement > _NORMAL_AGREEMENT:
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
    """Matches the scans of one vehicle with a window of recent ones, in the odometry frame."""

    def __init__(self, config: ScanMatchingConfig) -> None:
        self.config = config
        self._window: deque[Cloud] = deque(maxlen=config.matching_window)
        self._last: Pose2 = IDENTITY
        self._cells: _Cells | None = None

    @property
    def started(self) -> bool:
        """Whether there are scans to match with."""
        return self._cells is not None

    def reset(self) -> None:
        """Forget all scans, for example because the clock has jumped."""
        self._window.clear()
        self._cells = None

    def match(
        self, scan: LaserScan, laser: Pose2, prior: Pose2, covariance: Array
    ) -> ScanMatch | None:
        """Return the pose of the vehicle at a scan, or None if it matches nothing.

        laser: its pose in the vehicle frame.
        prior: pose by wheel odometry, with covariance (3, 3) in the vehicle frame.
        The scan enters the window once the vehicle has moved far enough.
        """
        cloud = scan_cloud(scan, laser, self.config.matching_range)
        if len(cloud.points) < _MINIMUM_POINTS:
            return None
        found = self._search(cloud, prior, covariance) if self._cells is not None else None
        pose = found.pose if found is not None else prior
        self._extend_window(cloud, pose)
        return found

    def _extend_window(self, cloud: Cloud, pose: Pose2) -> None:
        """Add a cloud to the window if the vehicle has moved far enough since the last one."""
        config = self.config
        if self._window and not moved_enough(
            self._last.between(pose),
            config.matching_window_distance,
            config.matching_window_heading,
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
        """Minimize over the error δ of the pose, in the vehicle frame, with the prior N(0, P).

        Gauss-Newton; the correspondence distance is halved in each iteration.
        """
        assert self._cells is not None
        information = np.linalg.inv(covariance + np.diag(_MINIMUM_DEVIATIONS**2))
        config = self.config
        pose, max_distance = prior, config.max_correspondence_distance
        for iteration in range(_ITERATIONS):
            A, b, matched = _normal_equations(
                cloud,
                self._cells,
                (pose.x, pose.y, pose.theta),
                max_distance,
                config.point_to_line_deviation,
            )
            if matched < max(_MINIMUM_POINTS, config.matching_overlap * len(cloud.points)):
                return None
            off = np.asarray(pose.between(prior))
            step = np.linalg.solve(A + information, b + information @ off)
            pose = pose.compose(Pose2.from_array(step))
            max_distance = max(0.5 * max_distance, _CELL)
            if iteration > 1 and (np.abs(step) < _CONVERGED).all():
                break
        off = np.asarray(prior.between(pose))
        if off @ information @ off > config.matching_gate**2:
            return None
        posterior = np.linalg.inv(_WINDOW_GAIN * A + information)
        remaining = posterior + config.matching_drift * covariance
        return ScanMatch(pose, remaining, matched / len(cloud.points))
