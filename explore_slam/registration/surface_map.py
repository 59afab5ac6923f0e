"""Surface elements of placed clouds, sorted by place, so that the nearest is found fast."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.geometry import Array

# Chosen on the Intel, ACES and Belgioioso logs; `benchmarks/laser_graph_slam.py` shows what a
# change does.
_ELEMENT = 0.05  # m, side of the square whose points of one orientation become one element
_MINIMUM_COSINE = 0.7  # minimum cosine between the normals of elements of one surface
_ORIENTATIONS = 8  # sectors of normals; the two faces of a thin wall stay apart
_CELL = 0.2  # m, side of the squares in which elements are looked up
# m, standard deviation of the kernel over which a surface is averaged. Without it the nearest of
# many noisy elements is the one that errs as the return does: residuals and the steps towards the
# surface are too small (benchmarks/scan_matching_noise.py).
_SMOOTHING = 0.05


class SurfaceMap(NamedTuple):
    """Elements sorted by square cells.

    x, y: lower corner (m); columns, rows of cells; first (columns * rows + 1,): index of the
    first element of each cell; points (n, 2) m and unit normals (n, 2) in that order.
    """

    x: float
    y: float
    columns: int
    rows: int
    first: NDArray[np.int64]
    points: Array
    normals: Array

    @classmethod
    def of(cls, points: Array, normals: Array) -> 'SurfaceMap':
        """Make the elements of points (m, 2) with unit normals (m, 2).

        An element is the mean of the points of nearly the same place and orientation. It lies on
        the surface that it and its neighbours of like orientation make, averaged with a Gaussian
        kernel (implicit moving least squares; Kolluri, SODA 2005): it is less noisy than each.
        """
        if not len(points):
            return cls(0.0, 0.0, 1, 1, np.zeros(2, np.int64), points, normals)
        low = points.min(axis=0)
        columns, rows = (((points.max(axis=0) - low) / _CELL).astype(np.int64) + 1).tolist()
        x, y = low.tolist()
        order = np.argsort(_element_keys(points, normals, x, y, columns), kind='stable')
        first, means, directions, counts = _elements(points, normals, order, x, y, columns, rows)
        rough = cls(x, y, columns, rows, first, means, directions)
        return cls(x, y, columns, rows, first, *_smoothed(rough, counts))


@kernel
def _element_keys(
    points: Array, normals: Array, x: float, y: float, columns: int
) -> NDArray[np.int64]:
    """Return a key (m,) for each point: cell, then square within the cell, then orientation."""
    keys = np.empty(len(points), np.int64)
    squares = round(_CELL / _ELEMENT)
    for n in range(len(points)):
        across, up = (points[n, 0] - x) / _CELL, (points[n, 1] - y) / _CELL
        column, row = int(across), int(up)
        inner = min(int((across - column) * squares), squares - 1)
        inner = inner * squares + min(int((up - row) * squares), squares - 1)
        sector = math.atan2(normals[n, 1], normals[n, 0]) * (_ORIENTATIONS / (2.0 * math.pi))
        cell = row * columns + column
        sector_number = math.floor(sector) % _ORIENTATIONS
        keys[n] = (cell * squares * squares + inner) * _ORIENTATIONS + sector_number
    return keys


@kernel
def _elements(
    points: Array,
    normals: Array,
    order: NDArray[np.int64],
    x: float,
    y: float,
    columns: int,
    rows: int,
) -> tuple[NDArray[np.int64], Array, Array, Array]:
    """Return the first element of each cell, means (n, 2), mean normals (n, 2), points of each."""
    keys = _element_keys(points, normals, x, y, columns)
    per_cell = round(_CELL / _ELEMENT) ** 2 * _ORIENTATIONS
    first = np.zeros(columns * rows + 1, np.int64)
    means, directions, counts = (
        np.empty_like(points),
        np.empty_like(normals),
        np.empty(len(points)),
    )
    count, begin = 0, 0
    while begin < len(order):
        key, end = keys[order[begin]], begin
        px, py, nx, ny = 0.0, 0.0, 0.0, 0.0
        while end < len(order) and keys[order[end]] == key:
            n = order[end]
            px += points[n, 0]
            py += points[n, 1]
            nx += normals[n, 0]
            ny += normals[n, 1]
            end += 1
        length = math.hypot(nx, ny)
        means[count, 0], means[count, 1] = px / (end - begin), py / (end - begin)
        directions[count, 0], directions[count, 1] = nx / length, ny / length
        counts[count] = end - begin
        first[key // per_cell + 1] += 1
        count += 1
        begin = end
    for cell in range(columns * rows):
        first[cell + 1] += first[cell]
    return first, means[:count], directions[:count], counts[:count]


@kernel
def nearest_element(
    surface: SurfaceMap, x: float, y: float, nx: float, ny: float, reach: float, agreement: float
) -> int:
    """Return the nearest element within reach (m) of like orientation, -1 if there is none.

    agreement: minimum cosine between the normals.
    """
    left, right = (x - reach - surface.x) / _CELL, (x + reach - surface.x) / _CELL
    low, high = (y - reach - surface.y) / _CELL, (y + reach - surface.y) / _CELL
    if right < 0.0 or high < 0.0 or left >= surface.columns or low >= surface.rows:
        return -1
    first_column, last_column = max(int(left), 0), min(int(right), surface.columns - 1)
    best, found = reach * reach, -1
    for row in range(max(int(low), 0), min(int(high), surface.rows - 1) + 1):
        begin = surface.first[row * surface.columns + first_column]
        end = surface.first[row * surface.columns + last_column + 1]
        for k in range(begin, end):
            dx, dy = surface.points[k, 0] - x, surface.points[k, 1] - y
            square = dx * dx + dy * dy
            cosine = nx * surface.normals[k, 0] + ny * surface.normals[k, 1]
            if square < best and cosine > agreement:
                best, found = square, k
    return found


@kernel
def _smoothed(surface: SurfaceMap, counts: Array) -> tuple[Array, Array]:
    """Return points (n, 2) moved along the normals onto the averaged surface, and its normals.

    counts (n,): points that each element is the mean of.
    """
    points, normals = np.empty_like(surface.points), np.empty_like(surface.normals)
    reach = 2.5 * _SMOOTHING
    for k in range(len(points)):
        x, y = surface.points[k, 0], surface.points[k, 1]
        nx, ny = surface.normals[k, 0], surface.normals[k, 1]
        first_column = max(int((x - reach - surface.x) / _CELL), 0)
        last_column = min(int((x + reach - surface.x) / _CELL), surface.columns - 1)
        first_row = max(int((y - reach - surface.y) / _CELL), 0)
        last_row = min(int((y + reach - surface.y) / _CELL), surface.rows - 1)
        total, mx, my, px, py = 0.0, 0.0, 0.0, 0.0, 0.0
        for row in range(first_row, last_row + 1):
            begin = surface.first[row * surface.columns + first_column]
            end = surface.first[row * surface.columns + last_column + 1]
            for j in range(begin, end):
                dx, dy = surface.points[j, 0] - x, surface.points[j, 1] - y
                square = dx * dx + dy * dy
                if square > reach * reach:
                    continue
                if nx * surface.normals[j, 0] + ny * surface.normals[j, 1] < _MINIMUM_COSINE:
                    continue
                weight = counts[j] * math.exp(-0.5 * square / _SMOOTHING**2)
                total += weight
                mx += weight * surface.normals[j, 0]
                my += weight * surface.normals[j, 1]
                px += weight * dx
                py += weight * dy
        length = math.hypot(mx, my)
        mx, my = mx / length, my / length
        off = (mx * px + my * py) / total
        points[k, 0], points[k, 1] = x + off * mx, y + off * my
        normals[k, 0], normals[k, 1] = mx, my
    return points, normals
