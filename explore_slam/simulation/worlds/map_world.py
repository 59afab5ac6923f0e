"""Build a world from a map_server map: cells that are not free become walls of few boxes.

GridWorld decides which cells are solid, so that planning studies and coverage use the same walls.
Only the solid cells next to free ones are raised. The world keeps the frame of the map.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from explore_slam.errors import MappingError, SimulationError
from explore_slam.geometry import Pose2
from explore_slam.simulation.worlds.grid_world import FREE, GridWorld
from explore_slam.simulation.worlds.world import Block, Face, World

WALL_HEIGHT = 2.2  # m, as in world files (world_file.py)
WALL_STYLES = ('plaster', 'brick', 'concrete', 'panel')
STYLE_AREA = 5.0  # m; the walls within a square of this side share a style
START_RADIUS = 0.35  # m of clearance at a suggested start: the body's 0.26 m and a margin
MAX_STARTS = 8  # suggested start poses at most
Mask = NDArray[np.bool_]


def world_of_map(path: Path) -> World:
    """Return the world of a map_server YAML file; raises SimulationError for a malformed one."""
    try:
        grid = GridWorld.from_map(path)
    except MappingError as error:
        raise SimulationError(f'cannot build a world from this map: {error}') from error
    free = grid.cells == FREE
    if not free.any():
        raise SimulationError(f'{path}: the map has no free cell, expected some to drive on')
    free = np.pad(free, 1)  # walls where free cells lie at the border of the map
    walls = ~free & dilated(free)
    cell = grid.resolution
    rows, columns = np.nonzero(walls)
    r0, r1 = int(rows.min()), int(rows.max()) + 1
    c0, c1 = int(columns.min()), int(columns.max()) + 1
    origin = (grid.origin[0] + (c0 - 1) * cell, grid.origin[1] + (r0 - 1) * cell)
    walls, free = walls[r0:r1, c0:c1], free[r0:r1, c0:c1]
    return World(
        name=path.stem,
        bounds=(*origin, origin[0] + (c1 - c0) * cell, origin[1] + (r1 - r0) * cell),
        blocks=tuple(_block(rectangle, origin, cell) for rectangle in merge_cells(walls)),
        faces=tuple(wall_faces(walls, free, origin, cell)),
        starts=_starts(grid),
    )


def _starts(grid: GridWorld) -> dict[str, Pose2]:
    """Suggest start poses for as many vehicles as fit close together."""
    for count in range(MAX_STARTS, 0, -1):
        try:
            poses = grid.start_poses(count, 0, START_RADIUS)
        except SimulationError:
            continue
        return {f'robot{index + 1}': pose for index, pose in enumerate(poses)}
    return {}


def dilated(mask: Mask) -> Mask:
    """Dilate a mask by its eight neighbours."""
    wide = np.pad(mask, 1)
    result = np.zeros_like(mask)
    rows, columns = mask.shape
    for row in range(3):
        for column in range(3):
            result |= wide[row : row + rows, column : column + columns]
    return result


def _runs(line: Mask) -> list[tuple[int, int]]:
    """Return start and end (exclusive) of each run of set cells in a line."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def merge_cells(mask: Mask) -> list[tuple[int, int, int, int]]:
    """Return disjoint rectangles (row, column, end row, end column) that cover the set cells.

    Runs along rows are merged over consecutive rows in which a run is the same.
    """
    done: list[tuple[int, int, int, int]] = []
    growing: dict[tuple[int, int], int] = {}
    for row in range(mask.shape[0] + 1):
        runs = _runs(mask[row]) if row < mask.shape[0] else []
        kept = {run: growing.get(run, row) for run in runs}
        for (start, end), first in growing.items():
            if (start, end) not in kept:
                done.append((first, start, row, end))
        growing = kept
    return done


def _block(
    rectangle: tuple[int, int, int, int], origin: tuple[float, float], cell: float
) -> Block:
    row, column, end_row, end_column = rectangle
    return Block(
        origin[0] + 0.5 * (column + end_column) * cell,
        origin[1] + 0.5 * (row + end_row) * cell,
        0.5 * (end_column - column) * cell,
        0.5 * (end_row - row) * cell,
        0.0,
        WALL_HEIGHT,
    )


def wall_faces(walls: Mask, free: Mask, origin: tuple[float, float], cell: float) -> list[Face]:
    """Return the faces between wall and free cells, merged into straight pieces."""
    faces: list[Face] = []
    for forward in (True, False):
        # first the faces whose free side has the smaller y (directed along +x), then the others
        below, above = (free, walls) if forward else (walls, free)
        for row in range(1, walls.shape[0]):
            for start, end in _runs(below[row - 1] & above[row]):
                ends = (start, end) if forward else (end, start)
                faces.append(_face([(ends[0], row), (ends[1], row)], origin, cell))
        left, right = (walls, free) if forward else (free, walls)
        for column in range(1, walls.shape[1]):
            for start, end in _runs(left[:, column - 1] & right[:, column]):
                ends = (start, end) if forward else (end, start)
                faces.append(_face([(column, ends[0]), (column, ends[1])], origin, cell))
    return faces


def _face(ends: list[tuple[int, int]], origin: tuple[float, float], cell: float) -> Face:
    (x0, y0), (x1, y1) = [(origin[0] + c * cell, origin[1] + r * cell) for c, r in ends]
    area = int((x0 + x1) / 2 // STYLE_AREA) + 3 * int((y0 + y1) / 2 // STYLE_AREA)
    return Face(x0, y0, x1, y1, WALL_HEIGHT, WALL_STYLES[area % len(WALL_STYLES)])
