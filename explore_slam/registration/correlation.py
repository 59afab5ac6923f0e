"""Correlative scan matching: the pose in a window at which points agree best with a grid.

The search is exhaustive in steps of one cell and a given angle, and exact: branch and bound
over the pyramid of the likelihood grid skips only what cannot be better.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.errors import RegistrationError
from explore_slam.geometry import Array, Pose2, wrap_angle
from explore_slam.registration.angles import wrapped
from explore_slam.registration.likelihood_grid import FULL, RESOLUTION, Levels, LikelihoodGrid

# Levels, blocks and chunks change the time of a search, not its result;
# `benchmarks/registration_speed.py` measures it.
ANGLE_STEP = math.radians(1.0)  # half a step moves a return at 6 m by one cell of 0.05 m
_MAXIMUM_LEVELS = 7  # squares of 64 cells, 3.2 m
_BLOCKS_ACROSS = 6  # of the coarsest level over the window: fewer bounds say nothing
_CHUNK = 32  # points summed between checks of whether the bound can still be reached


@dataclass(frozen=True)
class SearchWindow:
    """Poses that are searched: a square and an interval of headings around a centre.

    reach (m), turn (rad): half widths; angle_step (rad). position_penalty (1/m²) and
    heading_penalty (1/rad²) are subtracted from the score per squared distance from the centre.
    """

    centre: Pose2
    reach: float
    turn: float
    angle_step: float = ANGLE_STEP
    position_penalty: float = 0.0
    heading_penalty: float = 0.0

    def __post_init__(self) -> None:
        values = (self.reach, self.turn, self.position_penalty, self.heading_penalty)
        if not self.centre.is_finite() or not all(math.isfinite(v) and v >= 0.0 for v in values):
            raise RegistrationError(
                f'search window {self} holds a value that is negative or not finite'
            )
        if not self.angle_step > 0.0:
            raise RegistrationError(f'angle_step is {self.angle_step}, expected more than 0 rad')

    @property
    def cells(self) -> int:
        """Cells from the centre to the edge."""
        return math.ceil(self.reach / RESOLUTION)

    @property
    def turns(self) -> int:
        """Angle steps from the centre to the edge; at most half a turn."""
        return min(math.ceil(self.turn / self.angle_step), int(math.pi / self.angle_step))

    @property
    def pyramid_levels(self) -> int:
        """Levels with which the search is fast."""
        across = max((2 * self.cells + 1) / _BLOCKS_ACROSS, 1.0)
        return min(1 + int(math.log2(across)), _MAXIMUM_LEVELS)


class _Offsets(NamedTuple):
    """The offsets from the centre of a window that are searched, and what they cost.

    extent: cells from the centre to the edge; step: rad between two headings; penalties: per
    squared cell and per rad². excluded (5,): the mode that does not count, offsets in cells and
    in rad, and half widths in m and in rad; zero widths: none.
    """

    extent: int
    step: float
    penalties: tuple[float, float]
    excluded: Array


@dataclass(frozen=True)
class Peak:
    """A pose and its score, the mean likelihood (0 to 1) of the points there."""

    pose: Pose2
    score: float


def find_peak(
    grid: LikelihoodGrid, points: Array, window: SearchWindow, least_score: float
) -> Peak | None:
    """Return the best pose of points (n, 2) in the window, None if no score is above the minimum.

    Penalties decide which pose is best and whether it is above the minimum score; they are not
    part of the score that is returned.
    """
    return _search(grid, points, window, least_score, None, 0.0, 0.0)


def find_other_mode(
    grid: LikelihoodGrid,
    points: Array,
    window: SearchWindow,
    best: Pose2,
    apart: tuple[float, float],
    least_score: float,
) -> Peak | None:
    """Return the best pose that differs from a known one, None if no score is above the minimum.

    apart: distance (m) and turn (rad); a pose nearer than both is the same mode.
    """
    return _search(grid, points, window, least_score, best, *apart)


def _search(
    grid: LikelihoodGrid,
    points: Array,
    window: SearchWindow,
    least_score: float,
    other_than: Pose2 | None,
    apart: float,
    turned: float,
) -> Peak | None:
    if not len(points):
        return None
    levels = grid.levels(window.pyramid_levels)[: window.pyramid_levels]
    centre = window.centre
    excluded = np.zeros(5)
    if other_than is not None:
        steps = (other_than.x - centre.x) / RESOLUTION, (other_than.y - centre.y) / RESOLUTION
        excluded[:] = (*steps, wrap_angle(other_than.theta - centre.theta), apart, turned)
    penalties = (window.position_penalty * RESOLUTION**2, window.heading_penalty)
    start = (centre.x, centre.y, centre.theta)
    cells = _cells_of_points(points, start, grid.origin, window.turns, window.angle_step)
    offsets = _Offsets(window.cells, window.angle_step, penalties, excluded)
    found, score, dx, dy, turn = _branch_and_bound(levels, cells, offsets, least_score)
    if not found:
        return None
    pose = Pose2(
        centre.x + dx * RESOLUTION,
        centre.y + dy * RESOLUTION,
        wrap_angle(centre.theta + turn * window.angle_step),
    )
    return Peak(pose, score)


def score_profile(
    grid: LikelihoodGrid,
    points: Array,
    pose: Pose2,
    direction: tuple[float, float],
    offsets: Array,
) -> Array:
    """Return the scores (k,) of points (n, 2) at a pose shifted along a unit vector by offsets."""
    if not len(points):
        return np.zeros(len(offsets))
    levels = grid.levels(1)
    start = (pose.x, pose.y, pose.theta)
    return _profile(levels[0], grid.origin, points, start, direction, offsets)


@kernel
def _cells_of_points(
    points: Array,
    start: tuple[float, float, float],
    origin: tuple[int, int],
    turns: int,
    step: float,
) -> NDArray[np.int32]:
    """Return column and row (2 turns + 1, n, 2) of the points at each heading of the window."""
    cells = np.empty((2 * turns + 1, len(points), 2), np.int32)
    for k in range(2 * turns + 1):
        heading = start[2] + (k - turns) * step
        c, s = math.cos(heading), math.sin(heading)
        for n in range(len(points)):
            x = start[0] + c * points[n, 0] - s * points[n, 1]
            y = start[1] + s * points[n, 0] + c * points[n, 1]
            cells[k, n, 0] = math.floor(x / RESOLUTION) - origin[0]
            cells[k, n, 1] = math.floor(y / RESOLUTION) - origin[1]
    return cells


@kernel
def _score(level: Levels, cells: NDArray[np.int32], dx: int, dy: int, needed: float) -> float:
    """Return the mean likelihood of the points, or -1 once it cannot be above what is needed."""
    rows, columns = level.shape
    count = len(cells)
    most = FULL * count
    total, n = 0, 0
    while n < count:
        end = min(n + _CHUNK, count)
        for i in range(n, end):
            column, row = cells[i, 0] + dx, cells[i, 1] + dy
            if 0 <= column < columns and 0 <= row < rows:
                total += level[row, column]
        n = end
        if total + FULL * (count - n) <= needed * most:
            return -1.0
    return total / most


@kernel
def _penalty(dx: int, dy: int, size: int, extent: int, weight: float) -> float:
    """Return the smallest penalty of the offsets from (dx, dy) over size cells upwards."""
    if weight == 0.0:
        return 0.0
    x = max(dx, 0) if dx > 0 else min(dx + size - 1, extent, 0)
    y = max(dy, 0) if dy > 0 else min(dy + size - 1, extent, 0)
    return weight * (x * x + y * y)


@kernel
def _is_excluded(dx: int, dy: int, size: int, turn: float, excluded: Array) -> bool:
    """Return whether all offsets of a block belong to the mode that is excluded."""
    if abs(wrapped(turn - excluded[2])) >= excluded[4]:
        return False
    reach = excluded[3] / RESOLUTION
    for x in (dx, dx + size - 1):
        for y in (dy, dy + size - 1):
            if (x - excluded[0]) ** 2 + (y - excluded[1]) ** 2 >= reach * reach:
                return False
    return True


@kernel
def _block_bounds(
    level: Levels,
    cells: NDArray[np.int32],
    size: int,
    offsets: _Offsets,
    least: float,
) -> Array:
    """Return bounds (headings * blocks * blocks,) of the coarsest level, -inf where excluded."""
    extent, step, penalties, excluded = offsets
    headings, blocks = len(cells), (2 * extent) // size + 1
    bounds = np.full(headings * blocks * blocks, -np.inf)
    for k in range(headings):
        turn = (k - headings // 2) * step
        for block in range(blocks * blocks):
            dx, dy = block % blocks * size - extent, block // blocks * size - extent
            if _is_excluded(dx, dy, size, turn, excluded):
                continue
            fixed = penalties[1] * turn * turn + _penalty(dx, dy, size, extent, penalties[0])
            bound = _score(level, cells[k], dx, dy, least + fixed)
            if bound >= 0.0:
                bounds[k * blocks * blocks + block] = bound - fixed
    return bounds


@kernel
def _best_in_block(
    levels: Levels,
    cells: NDArray[np.int32],
    corner: tuple[int, int],
    bound: float,
    turn: float,
    offsets: _Offsets,
    best: float,
) -> tuple[float, int, int]:
    """Return the best value in a block of the coarsest level and its offset, if above best."""
    extent, _, penalties, excluded = offsets
    top = len(levels) - 1
    turned = penalties[1] * turn * turn
    stack = np.empty((3 * top + 4, 3), np.int64)  # level, dx, dy
    bounds = np.empty(len(stack))
    stack[0, 0], stack[0, 1], stack[0, 2], bounds[0] = top, corner[0], corner[1], bound
    depth, best_x, best_y = 1, 0, 0
    while depth:
        depth -= 1
        level, dx, dy = stack[depth, 0], stack[depth, 1], stack[depth, 2]
        if bounds[depth] <= best:
            continue
        if level == 0:
            best, best_x, best_y = bounds[depth], dx, dy
            continue
        half, first = 1 << (level - 1), depth
        for child in range(4):
            x, y = dx + (child & 1) * half, dy + (child >> 1) * half
            if x > extent or y > extent or _is_excluded(x, y, half, turn, excluded):
                continue
            fixed = turned + _penalty(x, y, half, extent, penalties[0])
            value = _score(levels[level - 1], cells, x, y, best + fixed) - fixed
            if value <= best:
                continue
            at = depth  # insertion: the most promising child is on top
            while at > first and bounds[at - 1] > value:
                stack[at], bounds[at] = stack[at - 1], bounds[at - 1]
                at -= 1
            stack[at, 0], stack[at, 1], stack[at, 2], bounds[at] = level - 1, x, y, value
            depth += 1
    return best, best_x, best_y


@kernel
def _branch_and_bound(
    levels: Levels,
    cells: NDArray[np.int32],
    offsets: _Offsets,
    least: float,
) -> tuple[bool, float, int, int, int]:
    """Return whether a pose above the minimum score exists, its score, cells (x, y) and turns."""
    extent, step, penalties, _ = offsets
    top = len(levels) - 1
    size, turns = 1 << top, len(cells) // 2
    blocks = (2 * extent) // size + 1
    bounds = _block_bounds(levels[top], cells, size, offsets, least)
    best, found, best_x, best_y, best_turn = least, False, 0, 0, 0
    for candidate in np.argsort(-bounds, kind='mergesort'):
        if bounds[candidate] <= best:
            break
        k, block = candidate // (blocks * blocks), candidate % (blocks * blocks)
        corner = (block % blocks * size - extent, block // blocks * size - extent)
        turn = (k - turns) * step
        value, x, y = _best_in_block(
            levels, cells[k], corner, bounds[candidate], turn, offsets, best
        )
        if value > best:
            best, found, best_x, best_y, best_turn = value, True, x, y, k - turns
    turn = best_turn * step
    penalty = penalties[1] * turn * turn + _penalty(best_x, best_y, 1, extent, penalties[0])
    return found, best + penalty, best_x, best_y, best_turn


@kernel
def _profile(
    level: Levels,
    origin: tuple[int, int],
    points: Array,
    start: tuple[float, float, float],
    direction: tuple[float, float],
    offsets: Array,
) -> Array:
    rows, columns = level.shape
    c, s = math.cos(start[2]), math.sin(start[2])
    scores = np.zeros(len(offsets))
    for k in range(len(offsets)):
        x, y = start[0] + offsets[k] * direction[0], start[1] + offsets[k] * direction[1]
        total = 0
        for n in range(len(points)):
            column = math.floor((x + c * points[n, 0] - s * points[n, 1]) / RESOLUTION)
            row = math.floor((y + s * points[n, 0] + c * points[n, 1]) / RESOLUTION)
            column, row = column - origin[0], row - origin[1]
            if 0 <= column < columns and 0 <= row < rows:
                total += level[row, column]
        scores[k] = total / (FULL * len(points))
    return scores
