"""A world of square cells: walls, glass, clearance, reachable cells, start poses.

Row = y index, col = x index, row 0 at the lowest y. Made from a map_server map (an image
with or without YAML), from the solids of a world, from a drawing, or from arrays.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from explore_slam.errors import SimulationError
from explore_slam.geometry import Array, Pose2
from explore_slam.mapping import OccupancyGrid, load_map
from explore_slam.mapping.ray_model import UNKNOWN
from explore_slam.simulation.worlds.world import World

Mask = NDArray[np.bool_]

# values of a cell; glass stops a vehicle but returns no laser beam
FREE, SOLID, GLASS = 0, 1, 2
_LARGEST_SPECK = 10  # cells; larger unknown areas may be rooms that nobody entered
# Cells of the largest map: 150 m square at 0.05 m. The distances of all cells then take 0.5 GB.
MAXIMUM_CELLS = 9_000_000
_SMALLEST_INSIDE = 4.0  # m² of room for vehicles; smaller enclosed areas are no place to start
_START_WINDOW = 5.0  # m (per axis) around the first start pose, for those of the others


@dataclass(frozen=True)
class GridWorld:
    """Cells (H, W) int8: FREE, SOLID or GLASS; resolution (m); origin (x, y) of the corner (m)."""

    cells: NDArray[np.int8]
    resolution: float
    origin: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if self.cells.ndim != 2 or self.cells.size == 0:
            raise SimulationError(
                f'grid world: cells have shape {self.cells.shape}, expected (H, W) with H, W >= 1'
            )
        if not (math.isfinite(self.resolution) and self.resolution > 0.0):
            raise SimulationError(f'grid world: resolution is {self.resolution}, expected > 0 m')
        if not all(map(math.isfinite, self.origin)):
            raise SimulationError(f'grid world: origin is {self.origin}, expected finite metres')

    @classmethod
    def from_world(
        cls, world: World, resolution: float = 0.05, height: float = 0.0
    ) -> 'GridWorld':
        """Rasterize the solids of a world into cells with this side (m).

        height: of a vehicle (m), which does not fit below lower boards, nor into pits.
        """
        solid, origin = world.occupied(resolution, height)
        return cls(np.where(solid, SOLID, FREE).astype(np.int8), resolution, origin)

    @classmethod
    def from_map(cls, path: Path, resolution: float | None = None) -> 'GridWorld':
        """Read a map_server map (`load_map`); resolution (m): of an image without a YAML file.

        Free cells are free, all others are solid. Exception: isolated specks of unknown cells
        without an occupied one are gaps in the recording, not objects, and count as free.
        Unknown margins are cut off but for one cell. SimulationError for a map that is too large.
        """
        grid = load_map(path, resolution=resolution)
        evidence, origin = _without_margins(grid)
        if evidence.size > MAXIMUM_CELLS:
            rows, columns = evidence.shape
            raise SimulationError(
                f'{path}: the known part of the map has {columns} x {rows} cells, expected at '
                f'most {MAXIMUM_CELLS // 10**6} million: cut out a part of it, or use larger cells'
            )
        occupied = evidence > 0
        free = (evidence < 0) & (evidence != UNKNOWN)
        solid = ~(free | _specks(~free, occupied, _LARGEST_SPECK))
        cells = np.where(solid, np.int8(SOLID), np.int8(FREE))
        return cls(cells, grid.resolution, origin)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.cells.shape[0], self.cells.shape[1]

    @cached_property
    def clearance(self) -> NDArray[np.float32]:
        """Distance (H, W) m from each cell's centre to the edge of the nearest obstacle."""
        framed = np.pad(self.cells == FREE, 1)
        distance = ndimage.distance_transform_edt(framed)[1:-1, 1:-1]
        metres: NDArray[np.float32] = np.maximum(distance - 0.5, 0.0).astype(np.float32)
        metres *= np.float32(self.resolution)
        return metres

    def to_cell(self, points: ArrayLike) -> NDArray[np.intp]:
        """Return the cells (N, 2), row and col, of points (N, 2) m."""
        shifted = (np.asarray(points, dtype=np.float64)[:, :2] - self.origin) / self.resolution
        return np.floor(shifted[:, ::-1]).astype(np.intp)

    def to_point(self, cells: ArrayLike) -> Array:
        """Return the centres (N, 2) m of cells (N, 2), row and col."""
        centers = (np.asarray(cells, dtype=np.float64)[:, ::-1] + 0.5) * self.resolution
        moved: Array = centers + self.origin
        return moved

    def is_inside(self, point: ArrayLike) -> bool:
        """Return whether a point (2,) m lies in the world."""
        row, col = self.to_cell(np.asarray(point)[None, :2])[0]
        return bool(0 <= row < self.shape[0] and 0 <= col < self.shape[1])

    def reachable(self, starts: ArrayLike, radius: float) -> Mask:
        """Return the free cells (H, W) that a disc of this radius (m) can cover.

        starts: (V, 2) m, initial centres of discs. A disc that does not fit at its start covers
        only the cells around that start.
        """
        labels, _ = ndimage.label(self.clearance >= radius)
        centers = np.zeros(self.shape, np.bool_)
        for row, col in self.to_cell(starts):
            if not (0 <= row < self.shape[0] and 0 <= col < self.shape[1]):
                raise SimulationError(
                    f'grid world: start {np.asarray(starts).tolist()} outside the world'
                )
            centers[row, col] = True
            if labels[row, col]:
                centers |= labels == labels[row, col]
        reach = ndimage.distance_transform_edt(~centers) * self.resolution
        covered: Mask = (reach <= radius) & (self.cells == FREE)
        return covered

    def start_poses(
        self, count: int, seed: int, radius: float, spacing: float = 0.9
    ) -> list[Pose2]:
        """Draw start poses of a team that are close together.

        The first is drawn from the cells of the largest connected free area that leave room for
        a radius (m) and two cells; not from what lies around a building, the free area along most
        of the border, where there is another. The others are as close to the first as possible,
        at least `spacing` (m) from each other. For one seed, the poses of a small team are the
        first poses of a larger one.
        """
        rng = np.random.default_rng(seed)
        roomy, parts = ndimage.label(self.clearance >= radius + 2.0 * self.resolution)
        if parts == 0:
            raise SimulationError(f'grid world: no place has room for a radius of {radius} m')
        sizes = np.bincount(roomy.ravel())
        sizes[0] = 0
        outside = self._outside()
        if outside is not None:
            inside = np.bincount(roomy[~outside], minlength=len(sizes))
            inside[0] = 0
            if inside.max() * self.resolution**2 >= _SMALLEST_INSIDE:
                sizes = inside
        largest = np.argwhere(roomy == sizes.argmax())
        first = largest[rng.integers(len(largest))]
        window = np.abs(largest - first).max(axis=1) <= _START_WINDOW / self.resolution
        near = self._connected(largest[window], first)
        order = np.argsort(np.hypot(*(near - first).T), kind='stable')
        points = self.to_point(near[order])
        chosen = [points[0]]
        for point in points:
            if len(chosen) == count:
                break
            if min(math.dist(point, other) for other in chosen) >= spacing:
                chosen.append(point)
        if len(chosen) < count:
            raise SimulationError(
                f'grid world: room for {len(chosen)} vehicles near {points[0]}, expected {count}'
            )
        return [
            Pose2(float(x), float(y), float(rng.uniform(-math.pi, math.pi))) for x, y in chosen
        ]

    def _outside(self) -> Mask | None:
        """Return the connected free area (H, W) with most cells of the border, if there is one."""
        free = self.cells == FREE
        rim = np.zeros(self.shape, np.bool_)
        rim[0], rim[-1], rim[:, 0], rim[:, -1] = True, True, True, True
        border = np.count_nonzero(rim)
        if 2 * np.count_nonzero(free & rim) <= border:
            return None
        labels, _ = ndimage.label(free)
        counts = np.bincount(labels[rim & free])
        return labels == counts.argmax() if 2 * counts.max() > border else None

    def _connected(self, cells: NDArray[np.intp], first: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return those of the cells (N, 2) that are 4-connected with the first one."""
        low = cells.min(axis=0)
        local = np.zeros(cells.max(axis=0) - low + 1, np.bool_)
        local[tuple((cells - low).T)] = True
        labels, _ = ndimage.label(local)
        kept = labels[tuple((cells - low).T)] == labels[tuple(first - low)]
        connected: NDArray[np.intp] = cells[kept]
        return connected


def _without_margins(grid: OccupancyGrid) -> tuple[NDArray[np.int16], tuple[float, float]]:
    """Return the evidence of the known part with a cell around it, and its corner (m)."""
    evidence, (x, y) = grid.evidence(), grid.origin
    known = evidence != UNKNOWN
    rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    if not rows.size:
        return evidence[:1, :1], (x, y)
    first, left = max(0, int(rows[0]) - 1), max(0, int(columns[0]) - 1)
    part = evidence[first : int(rows[-1]) + 2, left : int(columns[-1]) + 2]
    return part, (x + left * grid.resolution, y + first * grid.resolution)


def _specks(solid: Mask, occupied: Mask, largest: int) -> Mask:
    """Return the 8-connected components of at most `largest` cells, none of them occupied."""
    labels, count = ndimage.label(solid, np.ones((3, 3)))
    sizes = np.bincount(labels.ravel(), minlength=count + 1)
    touched = np.bincount(labels[occupied], minlength=count + 1) > 0
    small = (sizes <= largest) & ~touched
    small[0] = False
    specks: Mask = small[labels]
    return specks
