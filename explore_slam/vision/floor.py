"""The floor as a depth camera sees it, which tells how far its mount is off.

A plane is fitted to the readings near the floor of every frame by RANSAC (Fischler and Bolles,
1981) and least squares, and averaged over frames. Planes farther from where the mount has the
floor may be a step or a ramp: they are not used, but reported while no floor has been found.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array

_EVERY = 8  # samples of the image in both directions of which one is used
_HYPOTHESES = 40  # of three points; with half of them on the floor, all fail in 1 of 200 frames
_INLIER = 0.015, 0.006  # m, and per metre of distance: noise of height
_LEAST_POINTS = 40  # on the plane, for a floor
_LEAST_DEPTH = 0.5  # m, extent of a floor from which its slope is known
_MEAN = 20  # frames over which floors are averaged
_WIDE = 0.02, 0.03  # rad and m; a floor farther from the average is another one (a step, a ramp)
_SURE = 5  # frames from which an average is compared, and reported
_TILT, _HEIGHT = 0.035, 0.04  # rad (2 degrees) and m, of a mount that is worth a warning
MISFITS = 20  # frames with such a plane and without a floor that are reported: as many as averaged


class Floor(NamedTuple):
    """Height (m) of the floor below the camera where the mount has it at 0, and its slopes.

    along, across: slope in the direction in which the camera looks, and to the left (rad).
    """

    height: float = 0.0
    along: float = 0.0
    across: float = 0.0


class _Limits(NamedTuple):
    """How far (m) and how steep a floor may be from where the mount has it, and its least share.

    The share is that of the readings on it among those within the other limits.
    """

    nearest: float
    steepest: float
    share: float


_ACCEPTED = _Limits(0.1, 0.18, 0.4)  # 10 degrees; lower than the steps of stairs (0.15 m and more)
# 40 degrees: a base frame at the height of the axles or of the deck, or a pitch of the wrong sign.
# Walls and furniture are within these limits as well, hence the smaller share. Where it is met,
# RANSAC misses the plane in a third of the frames, which delays a report alone
_SEARCHED = _Limits(1.0, 0.84, 0.3)


class Plane(NamedTuple):
    """A plane in the readings of a frame, and the share of those near the floor that lie on it."""

    floor: Floor
    share: float


class FloorEstimate:
    """The floor as one camera has seen it until now; at first, it is where the mount has it."""

    def __init__(self) -> None:
        self.floor = Floor()
        self._frames = 0
        self._reported = False
        self._misfits: list[Plane] = []
        self._misfit_reported = False

    def add(
        self,
        ahead: NDArray[np.float32],
        tangent: NDArray[np.float32],
        slope: NDArray[np.float32],
        depth: NDArray[np.float32],
        height: float,
        reach: float,
    ) -> None:
        """Take a frame.

        ahead, tangent, slope: of the rays of the depth image (W, H) m: how far ahead they get per
        metre of depth, and to the left and up per metre ahead. height (m): of the camera.
        reach (m): of readings that are used.
        """
        some = slice(_EVERY // 2, None, _EVERY)
        forward = (ahead[some, some] * depth[some, some]).reshape(-1).astype(np.float64)
        points = np.column_stack(
            [
                forward,
                forward * tangent[some, some].reshape(-1),
                height + forward * slope[some, some].reshape(-1),
            ]
        )
        points = points[(forward > 0.0) & (forward < reach)]
        plane = _fit(points, _ACCEPTED, height)
        if plane is None:
            self._search_farther(points, height)
            return
        found = plane.floor
        if self._frames >= _SURE:
            off = np.abs(np.subtract(found, self.floor))
            if off[0] > _WIDE[1] or off[1:].max() > _WIDE[0]:
                return
        self._misfits.clear()
        self._frames += 1
        gain = 1.0 / min(self._frames, _MEAN)
        self.floor = Floor(
            *(old + gain * (new - old) for old, new in zip(self.floor, found, strict=True))
        )

    def _search_farther(self, points: Array, height: float) -> None:
        """Look for a floor farther from where the mount has it than floors are accepted.

        Once a floor is known, the mount is right, and such a plane is a step or a ramp.
        """
        if self._frames >= _SURE or self._misfit_reported:
            return
        plane = _fit(points, _SEARCHED, height)
        if plane is not None and not _within(plane.floor, _ACCEPTED):  # else it is in clutter
            self._misfits.append(plane)

    def misfit(self) -> Plane | None:
        """Return, once, the mean of planes that were found for long in place of a floor."""
        if len(self._misfits) < MISFITS:
            return None
        floors, shares = zip(*self._misfits, strict=True)
        self._misfits.clear()
        self._misfit_reported = True
        mean = Floor(*(float(value) for value in np.mean(floors, axis=0)))
        return Plane(mean, float(np.mean(shares)))

    def contradicts_mount(self) -> bool:
        """Return, once, whether the mount of the camera is off."""
        if self._reported or self._frames < _SURE:
            return False
        floor = self.floor
        tilt = max(abs(floor.along), abs(floor.across))
        self._reported = tilt > _TILT or abs(floor.height) > _HEIGHT
        return self._reported


def _within(floor: Floor, limits: _Limits) -> bool:
    """Return whether a floor is where the mount has it, but for these limits."""
    tilt = max(abs(floor.along), abs(floor.across))
    return abs(floor.height) < limits.nearest and tilt < limits.steepest


def _fit(points: Array, limits: _Limits, height: float) -> Plane | None:
    """Return the floor in points (N, 3) of a frame, None where too little of it is seen.

    height (m): of the camera, which is above the floor.
    """
    points = points[np.abs(points[:, 2]) < limits.nearest + limits.steepest * points[:, 0]]
    if len(points) < _LEAST_POINTS:
        return None
    design = np.column_stack([np.ones(len(points)), points[:, :2]])
    z = points[:, 2]
    allowed = _INLIER[0] + _INLIER[1] * points[:, 0]
    # the same draw for the same number of points: results depend on the frame alone
    draws = np.random.default_rng(len(points)).integers(0, len(points), (_HYPOTHESES, 3))
    corners = design[draws]
    usable = np.abs(np.linalg.det(corners)) > 0.01  # m²; points in a line define no plane
    if not usable.any():
        return None
    planes = np.linalg.solve(corners[usable], z[draws[usable]][..., None])[..., 0]
    flat = (np.abs(planes[:, 0]) < limits.nearest) & (planes[:, 0] < height)
    flat &= (np.abs(planes[:, 1:]) < limits.steepest).all(axis=1)
    if not flat.any():
        return None
    planes = planes[flat]
    inside = np.abs(design @ planes.T - z[:, None]) < allowed[:, None]
    on_floor = inside[:, int(np.argmax(inside.sum(axis=0)))]
    for _ in range(2):
        if on_floor.sum() < max(_LEAST_POINTS, limits.share * len(points)):
            return None
        plane, *_ = np.linalg.lstsq(design[on_floor], z[on_floor], rcond=None)
        on_floor = np.abs(design @ plane - z) < allowed
    if np.ptp(points[on_floor, 0]) < _LEAST_DEPTH:
        return None
    return Plane(Floor(*(float(value) for value in plane)), float(on_floor.mean()))
