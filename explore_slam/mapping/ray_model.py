"""Compiled loops that turn the beams of one scan into evidence for grid cells.

Evidence is the log-odds of a cell in thousandths of a nat (int16, clamped); UNKNOWN marks a cell
that no beam has touched. One scan counts once per cell, and a hit outweighs a beam passing.
"""

import math

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.geometry import Array

UNKNOWN = np.int16(-32768)
NATS = 1000.0

NOTHING, FREE_ONLY, HIT = 0, 1, 2


@kernel
def classify_beams(
    ranges: NDArray[np.float32],
    range_min: float,
    range_max: float,
    max_laser_range: float,
    no_return_range: float,
) -> tuple[Array, NDArray[np.uint8]]:
    """Return for each beam how far it frees cells (B,) m and whether it ends in a hit (B,).

    REP-117: NaN and -inf say nothing, +inf is no return; a finite range beyond range_max is taken
    as no return as well, one below range_min says nothing.
    """
    lengths = np.zeros(ranges.size)
    kinds = np.zeros(ranges.size, np.uint8)
    for i in range(ranges.size):
        r = float(ranges[i])
        if math.isnan(r) or r < range_min:
            continue
        if r > range_max:
            # silence proves nothing beyond what the scanner can measure
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
def drop_bodies(
    x: float,
    y: float,
    headings: Array,
    lengths: Array,
    kinds: NDArray[np.uint8],
    bodies: Array,
) -> None:
    """Cut, in place, beams that end on a vehicle (x, y, radius): no hit, free up to its body."""
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
def _add(evidence: NDArray[np.int16], row: int, col: int, step: int, low: int, high: int) -> None:
    before = int(evidence[row, col])
    after = step if before == -32768 else before + step
    evidence[row, col] = min(max(after, low), high)


@kernel
def draw_beams(
    evidence: NDArray[np.int16],
    touched: NDArray[np.int32],
    scan_number: int,
    x: float,
    y: float,
    headings: Array,
    lengths: Array,
    kinds: NDArray[np.uint8],
    steps: NDArray[np.int32],
) -> None:
    """Add one scan to evidence (H, W), in place.

    x, y and lengths are in cells, measured from the corner of cell [0, 0]; touched (H, W) holds
    the number of the scan that changed a cell last; steps: hit, miss, lowest, highest evidence.
    The caller guarantees that the origin and every end point lie inside the array.
    """
    hit, miss, low, high = steps[0], steps[1], steps[2], steps[3]
    for i in range(headings.size):
        if kinds[i] == HIT:
            col = math.floor(x + lengths[i] * math.cos(headings[i]))
            row = math.floor(y + lengths[i] * math.sin(headings[i]))
            if touched[row, col] != scan_number:
                touched[row, col] = scan_number
                _add(evidence, row, col, hit, low, high)
    for i in range(headings.size):
        if kinds[i] != NOTHING:
            c, s = math.cos(headings[i]), math.sin(headings[i])
            _free_ray(evidence, touched, scan_number, x, y, c, s, lengths[i], miss, low, high)


@kernel
def _free_ray(
    evidence: NDArray[np.int16],
    touched: NDArray[np.int32],
    scan_number: int,
    x: float,
    y: float,
    c: float,
    s: float,
    length: float,
    miss: int,
    low: int,
    high: int,
) -> None:
    """Visit every cell the ray crosses before the one it ends in (Amanatides and Woo, 1987)."""
    col, row = math.floor(x), math.floor(y)
    end_col, end_row = math.floor(x + length * c), math.floor(y + length * s)
    step_col, step_row = (1 if c > 0.0 else -1), (1 if s > 0.0 else -1)
    per_col = 1.0 / abs(c) if c != 0.0 else np.inf
    per_row = 1.0 / abs(s) if s != 0.0 else np.inf
    to_col = (col + 1 - x if c > 0.0 else x - col) * per_col if c != 0.0 else np.inf
    to_row = (row + 1 - y if s > 0.0 else y - row) * per_row if s != 0.0 else np.inf
    for _ in range(abs(end_col - col) + abs(end_row - row)):
        if touched[row, col] != scan_number:
            touched[row, col] = scan_number
            _add(evidence, row, col, miss, low, high)
        if to_col < to_row:
            to_col += per_col
            col += step_col
        else:
            to_row += per_row
            row += step_row
