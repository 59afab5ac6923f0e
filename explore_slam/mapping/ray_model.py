"""Inverse sensor model of the occupancy grid: the evidence of one scan for the cells.

The evidence for a cell is its log-odds (Moravec and Elfes, "High resolution maps from wide angle
sonar", 1985; Thrun, Burgard and Fox, "Probabilistic Robotics", 2005, chapter 9) in thousandths of
a nat, clamped and stored as int16. One scan counts once per cell, and a hit outweighs a pass.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.geometry import Array

UNKNOWN = np.int16(-32768)  # evidence for a cell that no beam has touched
UNITS_PER_NAT = 1000.0  # resolution of the evidence: the largest log-odds, 30 nat, fits an int16

NOTHING, FREE_ONLY, HIT = 0, 1, 2  # information of a beam


class BeamSteps(NamedTuple):
    """Evidence: of a hit, of a pass, and the limits to which a cell is clamped."""

    hit: int
    miss: int
    low: int
    high: int


class Beams(NamedTuple):
    """Beams of one scan from a common origin.

    x, y: the origin; headings (B,) rad; lengths (B,): how far each beam frees cells, in the unit
    of the origin; kinds (B,): NOTHING, FREE_ONLY or HIT.
    """

    x: float
    y: float
    headings: Array
    lengths: Array
    kinds: NDArray[np.uint8]


class Canvas(NamedTuple):
    """What scans are drawn into: evidence (H, W), changed in place.

    touched (H, W): number of the scan that changed a cell last; first_row, first_col: of the map,
    at which the arrays begin; scan_number: of the scan that is drawn.
    """

    evidence: NDArray[np.int16]
    touched: NDArray[np.int32]
    first_row: int
    first_col: int
    scan_number: int
    steps: BeamSteps


@kernel
def classify_beams(
    ranges: NDArray[np.float32],
    range_min: float,
    range_max: float,
    max_laser_range: float,
    no_return_range: float,
) -> tuple[Array, NDArray[np.uint8]]:
    """Return for each beam how far it frees cells (B,) m, and its kind (B,).

    REP-117: NaN and -inf are invalid, +inf is no return. A range beyond range_max is treated as
    no return, one below range_min is invalid.
    """
    lengths = np.zeros(ranges.size)
    kinds = np.zeros(ranges.size, np.uint8)
    for i in range(ranges.size):
        r = float(ranges[i])
        if math.isnan(r) or r < range_min:
            continue
        if r > range_max:
            # no return says nothing about cells beyond the range of the scanner
            lengths[i] = min(no_return_range, max_laser_range, range_max)
            kinds[i] = FREE_ONLY if lengths[i] > 0.0 else NOTHING
        elif r > max_laser_range:
            lengths[i] = max_laser_range
            kinds[i] = FREE_ONLY
        else:
            lengths[i] = r
            kinds[i] = HIT
    return lengths, kinds


@kernel
def drop_bodies(beams: Beams, bodies: Array) -> None:
    """Shorten, in place, beams that end on a vehicle: no hit, and free up to its body only.

    bodies (V, 3): x, y and radius (m) of the vehicles, in the frame of the beams' origin.
    """
    x, y, headings, lengths, kinds = beams
    for b in range(bodies.shape[0]):
        bx, by, radius = bodies[b, 0] - x, bodies[b, 1] - y, bodies[b, 2]
        distance_squared = bx * bx + by * by
        for i in range(headings.size):
            if kinds[i] != HIT:
                continue
            c, s = math.cos(headings[i]), math.sin(headings[i])
            ex, ey = lengths[i] * c - bx, lengths[i] * s - by
            if ex * ex + ey * ey > radius * radius:
                continue
            along = bx * c + by * s
            half = radius * radius - (distance_squared - along * along)
            entry = along - math.sqrt(max(half, 0.0))
            lengths[i] = max(0.0, min(lengths[i], entry))
            kinds[i] = FREE_ONLY


@kernel
def _add(canvas: Canvas, map_row: int, map_col: int, step: int) -> None:
    """Add evidence to one cell of the map, clamped, unless this scan has done so already."""
    row, col = map_row - canvas.first_row, map_col - canvas.first_col
    if canvas.touched[row, col] == canvas.scan_number:
        return
    canvas.touched[row, col] = canvas.scan_number
    before = int(canvas.evidence[row, col])
    after = step if before == UNKNOWN else before + step
    canvas.evidence[row, col] = min(max(after, canvas.steps.low), canvas.steps.high)


@kernel
def draw_beams(canvas: Canvas, beams: Beams) -> None:
    """Add one scan to the evidence.

    The beams are in cells of the map, so that the result does not depend on where the arrays
    begin. The caller guarantees that their origin and every end point lie inside the arrays.
    """
    x, y, headings, lengths, kinds = beams
    for i in range(headings.size):
        if kinds[i] == HIT:
            col = math.floor(x + lengths[i] * math.cos(headings[i]))
            row = math.floor(y + lengths[i] * math.sin(headings[i]))
            _add(canvas, row, col, canvas.steps.hit)
    for i in range(headings.size):
        if kinds[i] != NOTHING:
            c, s = math.cos(headings[i]), math.sin(headings[i])
            _free_ray(canvas, x, y, c, s, lengths[i])


@kernel
def _free_ray(canvas: Canvas, x: float, y: float, c: float, s: float, length: float) -> None:
    """Add a pass to every cell that a ray crosses before the one in which it ends.

    x, y: origin; c, s: cosine and sine of the heading; all in cells.
    Traversal after Amanatides and Woo, "A fast voxel traversal algorithm for ray tracing" (1987).
    """
    col, row = math.floor(x), math.floor(y)
    end_col, end_row = math.floor(x + length * c), math.floor(y + length * s)
    step_col, step_row = (1 if c > 0.0 else -1), (1 if s > 0.0 else -1)
    per_col = 1.0 / abs(c) if c != 0.0 else np.inf
    per_row = 1.0 / abs(s) if s != 0.0 else np.inf
    to_col = (col + 1 - x if c > 0.0 else x - col) * per_col if c != 0.0 else np.inf
    to_row = (row + 1 - y if s > 0.0 else y - row) * per_row if s != 0.0 else np.inf
    for _ in range(abs(end_col - col) + abs(end_row - row)):
        _add(canvas, row, col, canvas.steps.miss)
        if to_col < to_row:
            to_col += per_col
            col += step_col
        else:
            to_row += per_row
            row += step_row
