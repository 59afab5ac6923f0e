"""Test whether the path of a vehicle has a unique match in the mapped area.

A search prefers poses at which the map shows all that the vehicle has seen. Where the map is still
growing, the right pose may lie beyond its edge, and a wrong one wins because it is covered: the
next of equal rooms. Here every pose is evaluated only by the returns in the mapped area: if at
another pose a fair number of them lie there and fit as well, the join must wait.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from explore_slam.geometry import Array, to_world
from explore_slam.registration import thinned
from explore_slam.slam.closures.anchors import Anchor, Integers

# Values were chosen in corridors of equal rooms (`explore_slam benchmark twins`).
TRAIL_LENGTH = 20.0  # m driven by the vehicle that are compared with the map
_SPACING = 0.8  # m driven between the anchors that are compared
_CELL = 0.2  # m
# m; poses farther away from the join are rivals that the search itself finds
_MAXIMUM_SHIFT = 12.0
_MAXIMUM_RANGE = 8.0  # m; returns farther away are left out
_DEVIATION = 0.2  # m, of a return from a surface of the map
_ROTATIONS = tuple(
    math.radians(quarter + small) for quarter in (0, 180, 90, 270) for small in (0, -2, 2)
)
_JOIN_SLACK = 0.4  # m, by which the pose of the join itself may be off
# Rivals of a join are poses that are off by more than this (m), or by more than this turn (rad).
_RIVAL_DISTANCE = 0.8
_RIVAL_TURN = math.radians(10.0)
_MINIMUM_FRACTION = 0.5  # of the returns that count at the join must count at a rival
_MINIMUM_RETURNS = 100  # that count: 20 m of wall in cells of _CELL


class Fit(NamedTuple):
    """How well a path fits into the map at the pose of a join, and at the best other pose.

    score: mean likelihood (0 to 1) of the returns that fall where the map has been seen; returns:
    their number; rival: the best score elsewhere, 0 if there is none.
    """

    score: float
    returns: int
    rival: float

    def is_unique(self, other_mode: float) -> bool:
        """Return whether enough returns count and no other pose scores this fraction."""
        return self.returns >= _MINIMUM_RETURNS and self.rival < other_mode * self.score


class _Map(NamedTuple):
    """The mapped part of an area, in cells (H, W); corner (2,) m: the lower left one.

    seen: 1 where a laser has seen, else 0; fitting: likelihood of a return, 0 where not seen.
    """

    seen: Array
    fitting: Array
    corner: Array


def trail_of(anchors: Sequence[Anchor]) -> list[Anchor]:
    """Return the anchors, oldest first, of the part of a vehicle's path that is compared."""
    chosen: list[Anchor] = []
    for anchor in reversed(anchors):
        if anchors[-1].distance_driven - anchor.distance_driven > TRAIL_LENGTH:
            break
        if not chosen or chosen[-1].distance_driven - anchor.distance_driven >= _SPACING:
            chosen.append(anchor)
    return chosen[::-1]


def fit_of(
    trail: Sequence[Anchor], placed: Array, known: Sequence[Anchor], poses: Array
) -> Iterator[Fit | None]:
    """Compare a path with the map: yield None after each part of the work, the result at the end.

    trail: anchors of a vehicle, with their poses placed (n, 3) in the map by a join; known:
    anchors of the map, with their poses (m, 3).
    """
    centre = placed[:, :2].mean(axis=0)
    near = [_near_returns(anchor, pose) for anchor, pose in zip(trail, placed, strict=True)]
    returns = np.concatenate(near)
    reach = float(np.hypot(*(returns - centre).T).max(initial=0.0)) + _MAXIMUM_SHIFT + 2.0 * _CELL
    area = _seen_map(known, poses, centre - reach, centre + reach)
    yield None
    score, count, rival = 0.0, 0, 0.0
    for rotation in _ROTATIONS:
        turned = to_world([*centre, rotation], returns - centre)
        fitting, seen, shifts = _at_all_shifts(area, thinned(turned, _CELL))
        mean = fitting / np.maximum(seen, 1.0)
        if rotation == 0.0:
            here = np.where(shifts <= _JOIN_SLACK, fitting, -1.0)
            at = np.unravel_index(int(np.argmax(here)), here.shape)
            score, count = float(mean[at]), int(seen[at])
        others = seen >= max(_MINIMUM_FRACTION * count, _MINIMUM_FRACTION * _MINIMUM_RETURNS)
        if abs(rotation) <= _RIVAL_TURN:
            others &= shifts > _RIVAL_DISTANCE
        rival = max(rival, float(mean[others].max(initial=0.0)))
        yield None
    yield Fit(score, count, rival)


def _near_returns(anchor: Anchor, pose: Array) -> Array:
    """Return the near returns (n, 2) of an anchor at a pose."""
    points = anchor.cloud.query_points
    return to_world(pose, points[(points**2).sum(axis=1) < _MAXIMUM_RANGE**2])


def _seen_map(known: Sequence[Anchor], poses: Array, low: Array, high: Array) -> _Map:
    """Return what anchors at poses (m, 3) have mapped of an area from low to high (2,)."""
    width, height = (np.ceil((high - low) / _CELL).astype(int) + 1).tolist()
    free, seen = np.ones((height, width), np.bool_), np.zeros((height, width), np.bool_)
    steps = np.arange(0.0, _MAXIMUM_RANGE, _CELL)
    outside = np.hypot(*np.maximum(np.maximum(low - poses[:, :2], poses[:, :2] - high), 0.0).T)
    for anchor, pose, off in zip(known, poses, outside, strict=True):
        if off > _MAXIMUM_RANGE:
            continue
        points = anchor.cloud.sparse_points
        _mark(
            free, to_world(pose, points[(points**2).sum(axis=1) < _MAXIMUM_RANGE**2]), low, False
        )
        distance = np.hypot(points[:, 0], points[:, 1])
        along = np.minimum(steps[None, :], distance[:, None])
        rays = points[:, None] * (along / np.maximum(distance[:, None], _CELL))[:, :, None]
        _mark(seen, to_world(pose, rays.reshape(-1, 2)), low, True)
    distances = _CELL * ndimage.distance_transform_edt(free)
    seen = ndimage.binary_dilation(seen)  # a wall belongs to what is seen before it
    likelihood = np.exp(-0.5 * (distances / _DEVIATION) ** 2)
    return _Map(seen.astype(np.float64), np.where(seen, likelihood, 0.0), low)


def _mark(cells: NDArray[np.bool_], points: Array, low: Array, value: bool) -> None:
    """Set the cells that points (n, 2) fall into."""
    at = _cells(points, low)
    inside = ((at >= 0) & (at < cells.shape)).all(axis=1)
    cells[tuple(at[inside].T)] = value


def _cells(points: Array, low: Array) -> Integers:
    """Return rows and columns (n, 2) of points (n, 2)."""
    found: Integers = np.floor((points - low)[:, ::-1] / _CELL).astype(np.int64)
    return found


def _at_all_shifts(area: _Map, points: Array) -> tuple[Array, Array, Array]:
    """Return, for shifts of points (n, 2) in both axes, sums of likelihoods and of what is seen.

    The third result are the lengths (m) of the shifts.
    """
    reach = round(_MAXIMUM_SHIFT / _CELL)
    side = 2 * reach + 1
    fitting: Array = np.zeros((side, side))
    seen: Array = np.zeros((side, side))
    for row, column in (_cells(points, area.corner) - reach).tolist():
        window = slice(row, row + side), slice(column, column + side)
        fitting += area.fitting[window]
        seen += area.seen[window]
    steps = _CELL * np.arange(-reach, reach + 1)
    return fitting, seen, np.hypot(steps[:, None], steps[None, :])
