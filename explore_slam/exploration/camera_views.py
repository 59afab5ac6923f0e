"""Areas that a laser has seen, but no depth camera has looked at.

Table tops, shelves and steps may be there, of which a laser shows legs at most. A laser completes
rooms through their doors, so that some would never be looked at. They are visited once no frontier
is left: as a vehicle drives to the middle of such an area, it looks ahead.
"""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from explore_slam.exploration.clearance import CostMap, squared_distance
from explore_slam.exploration.frontier_kernels import Viewpoints, find_viewpoint
from explore_slam.exploration.records import Frontier, Grid
from explore_slam.exploration.regions import along_main_direction, cut_across
from explore_slam.exploration.sections import FrontierConfig

# Chosen by hand; `explore_slam benchmark obstacles` measures what another value does.
_NARROWEST = 0.5  # m; narrower strips, as along walls and between two views, are left out
_LARGEST = 3.0  # m; longer areas are split: about as far as a depth camera looks


def find_unviewed(
    grid: Grid,
    costs: CostMap,
    looked_at: NDArray[np.bool_],
    viewpoints: NDArray[np.bool_],
    config: FrontierConfig,
) -> list[Frontier]:
    """Return the areas to be looked at, as frontiers whose target lies in or near their middle.

    looked_at (H, W): cells that cameras have looked at. viewpoints (H, W): cells that a vehicle
    with a camera can get to. Areas smaller than `min_unviewed_area` are left out.
    """
    scale = grid.resolution
    wide = _opened(costs.free & ~looked_at, 0.5 * _NARROWEST / scale)
    marks = np.zeros(grid.shape, np.int32)
    found = []
    for mark, cells in enumerate(_areas(wide, config.min_unviewed_area / scale**2, scale), 1):
        row, col = find_viewpoint(
            costs.free,
            Viewpoints(viewpoints, costs.squared),
            0,
            marks,
            mark,
            cells,
            round(config.viewpoint_distance / scale),
        )
        if row < 0:
            continue
        places = np.array([[row, col], np.rint(cells.mean(axis=0))])
        (x, y), middle = grid.to_point(places).tolist()
        middle, area = (middle[0], middle[1]), len(cells) * scale**2
        found.append(
            Frontier(
                cells, middle, (x, y), (row, col), math.sqrt(area), area, middle, showing=area
            )
        )
    return found


def _opened(mask: NDArray[np.bool_], radius: float) -> NDArray[np.bool_]:
    """Return the cells of a mask (H, W) that a disc covers that fits into it (opening).

    radius: of the disc (cells).
    """
    limit = math.floor(radius) + 1
    inner = squared_distance(~mask, limit) > radius * radius
    covered: NDArray[np.bool_] = squared_distance(inner, limit) <= radius * radius
    return covered


def _areas(mask: NDArray[np.bool_], least: float, scale: float) -> Iterator[NDArray[np.int64]]:
    """Yield connected areas of a mask (H, W) with at least so many cells, in pieces (N, 2)."""
    labels, _ = ndimage.label(mask)
    sizes = np.bincount(labels.ravel())
    for label, box in enumerate(ndimage.find_objects(labels), 1):
        if sizes[label] >= least:
            cells = np.argwhere(labels[box] == label) + (box[0].start, box[1].start)
            yield from _pieces(np.ascontiguousarray(cells), _LARGEST / scale)


def _pieces(cells: NDArray[np.int64], largest: float) -> Iterator[NDArray[np.int64]]:
    """Cut cells (N, 2) across their main direction until no piece is longer than `largest`."""
    along = along_main_direction(cells)
    count = math.ceil(np.ptp(along) / largest)
    if count <= 1:
        yield cells
        return
    for part in cut_across(cells, along, count):
        yield from _pieces(part, largest)
