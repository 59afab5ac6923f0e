"""What planning derives from a grid, kept between cycles: a cycle costs by what has changed.

`PlanningMap` compares the grid with what it was in the last cycle, and renews the tiles of cells
in which, or within reach of which, something has changed: obstacles, free and unknown cells,
distances to obstacles, frontier cells. A `CostLayer` adds what depends on the size of a vehicle:
costs, and which cells are connected. Connected regions are labelled within each tile and joined
across tiles, so that a door that closes is found out without a search of the whole grid.

Everything equals what would be computed anew. Grids may grow to any side, shrink and move.
"""

import math
from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.exploration.clearance import (
    CostMap,
    clearance_factors,
    distance_limit,
    roomy_from,
)
from explore_slam.exploration.frontier_kernels import FrontierCells
from explore_slam.exploration.frontiers import FrontierCache
from explore_slam.exploration.records import Cell, Grid
from explore_slam.exploration.regions import open_around
from explore_slam.exploration.routes import RouteGrid
from explore_slam.exploration.sections import PathConfig
from explore_slam.exploration.tiles import (
    FREE,
    OBSTACLE,
    TILE,
    UNKNOWN,
    Levels,
    Todo,
    close_disc,
    join_tiles,
    label_tiles,
    mark_around,
    mark_box,
    moved,
    renew_costs,
    renew_frontier_cells,
    renew_region,
    renew_squared,
    take_changes,
    tiles_of,
)
from explore_slam.exploration.value_iteration import Costs

Mask = NDArray[np.bool_]
Cells = NDArray[np.int64]
Disc = tuple[int, int, float]  # row, column, radius (cells)
_LARGEST_UINT16 = 2**16 - 1


class Overlay(NamedTuple):
    """What changes the costs of cells beside the map, in this order; cells of the present grid.

    before: discs closed, then opened along the trails. trails (N, 2); half: cells beside them that
    are opened too; prices: cost of opened cells by squared distance (cells) to an obstacle.
    after: discs that are closed, on trails too.
    """

    before: tuple[Disc, ...] = ()
    trails: Cells = np.empty((0, 2), np.int64)
    half: int = 0
    prices: NDArray[np.float32] = np.ones(1, np.float32)
    after: tuple[Disc, ...] = ()


class PlanningMap:
    """The grid of the present cycle as planning uses it.

    free, unknown, squared (H, W): see CostMap. first: row and column of cell [0, 0], counted from
    the origin of the map frame.
    """

    def __init__(self, config: PathConfig, *, probability_costs: bool = False) -> None:
        """Create it without cells; probability_costs: see make_cost_map."""
        self._config = config
        self._probability_costs = probability_costs
        self._table = np.empty(0, np.float32)
        self._resolution = math.nan
        self._limit = 0
        self._layers: dict[float, CostLayer] = {}
        self._clear()

    def _clear(self) -> None:
        self.first = (0, 0)
        self.free = np.zeros((0, 0), np.bool_)
        self.unknown = np.zeros((0, 0), np.bool_)
        self.squared: NDArray[Any] = np.zeros((0, 0), np.uint16)
        self._kept = np.zeros((0, 0), np.int16)
        self._frontiers = FrontierCells(np.zeros((0, 0), np.bool_), np.zeros((0, 0), np.int32))
        self._layers = {}

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.free.shape[0], self.free.shape[1]

    def update(self, grid: Grid, paths: Mapping[float, PathConfig]) -> None:
        """Take a grid, for vehicles whose settings are given by their envelopes (m).

        The layer of each of them has to be renewed before the next update.
        """
        cells, table = grid.levels()
        cells = cells.view()
        cells.flags.writeable = False  # always of one kind, so that nothing is compiled later
        scale, (x, y) = grid.resolution, grid.origin
        factors = {
            envelope: clearance_factors(one, scale, soft=not self._probability_costs)
            for envelope, one in paths.items()
        }
        limit = max(distance_limit(usual) for usual, _ in factors.values())
        alike = np.array_equal(table, self._table, equal_nan=True)
        if not alike or scale != self._resolution or limit != self._limit:
            self._clear()
            self._use_table(table)
            self._resolution, self._limit = scale, limit
        todo = self._moved_to((round(y / scale), round(x / scale)), grid.shape)
        levels = Levels(cells, self._kinds, self._bases)
        take_changes(levels, self._kept, self.free, self.unknown, self._limit, todo)
        renew_squared(self.free, self.unknown, self._limit, todo, self.squared)
        renew_frontier_cells(self.free, self.unknown, todo.frontiers, *self._frontiers)
        self._layers = {key: self._layers[key] for key in paths if key in self._layers}
        for layer in self._layers.values():
            layer.todo |= todo.costs
        for envelope, one in paths.items():
            if envelope not in self._layers:
                self._layers[envelope] = CostLayer(self.shape, one, factors[envelope], scale)

    def layer(self, envelope: float, overlay: Overlay) -> tuple['CostLayer', CostMap]:
        """Return the layer of vehicles of an envelope (m), and the costs under an overlay."""
        layer = self._layers[envelope]
        levels = Levels(self._kept, self._kinds, self._bases)
        return layer, layer.renew(levels, self, self._frontiers, overlay)

    def _use_table(self, table: NDArray[np.float32]) -> None:
        """Use the probability (65536,) of each level; NaN is unknown."""
        floor = 0.0 if self._probability_costs else self._config.cost_floor
        scale = 1.0 if self._probability_costs else 1.0 / self._config.cost_floor
        unknown = np.isnan(table)
        kinds = np.where(table <= self._config.occ_max, np.uint8(FREE), np.uint8(OBSTACLE))
        kinds[unknown] = UNKNOWN
        self._table, self._kinds = table.copy(), kinds
        self._bases = np.maximum(table.astype(np.float64), floor) * scale
        # what cells that nothing is known of have been until now
        self._nothing = int(np.flatnonzero(unknown)[0].astype(np.uint16).view(np.int16))

    def _moved_to(self, first: tuple[int, int], shape: tuple[int, int]) -> Todo:
        """Lay everything over another area; return the tiles that have to be renewed for that.

        New cells are unknown at first, until they are compared with the grid. Along the seam of
        old and new cells, both see obstacles and unknown cells of the others.
        """
        (old_row, old_col), (row, col) = self.first, first
        shift, old = (old_row - row, old_col - col), self.shape
        todo = Todo(*(np.zeros(tiles_of(shape), np.bool_) for _ in range(3)))
        if shift == (0, 0) and shape == old:
            return todo
        overlap = all(
            min(shift[k] + old[k], shape[k]) > max(shift[k], 0) and shift[k] % TILE == 0
            for k in (0, 1)
        )
        if not overlap:  # tiles would be others
            self._clear()
            shift, old = (0, 0), (0, 0)
        far = (self._limit + 1) ** 2
        small = far <= _LARGEST_UINT16
        self.first = first
        self._kept = moved(self._kept, shift, shape, self._nothing)
        self.free = moved(self.free, shift, shape, False)
        self.unknown = moved(self.unknown, shift, shape, True)
        before = self.squared.astype(np.uint16 if small else np.int32, copy=False)
        self.squared = moved(before, shift, shape, far)
        mask, counts = self._frontiers
        tiles = (shift[0] // TILE, shift[1] // TILE), tiles_of(shape)
        self._frontiers = FrontierCells(moved(mask, shift, shape, False), moved(counts, *tiles, 0))
        for layer in self._layers.values():
            layer.move(shift, shape)
        for k in (0, 1):
            low, high = shift[k], shift[k] + old[k]
            seams = [max(low, 0)] if low else []
            seams += [min(high, shape[k])] if high != shape[k] else []
            for seam in seams:
                box = [0, shape[0], 0, shape[1]]
                box[2 * k : 2 * k + 2] = seam - self._limit, seam + self._limit
                for part in todo:
                    mark_box(part, *box)
        return todo


class CostLayer:
    """Costs and connected regions for vehicles of one size.

    padded (H + 2, W + 2): see CostMap and padded_costs. todo (R, C): tiles to be renewed.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        paths: PathConfig,
        factors: tuple[NDArray[np.float32], NDArray[np.float32]],
        resolution: float,
    ) -> None:
        self._paths, self._factors, self._resolution = paths, factors, resolution
        self.padded = np.full((shape[0] + 2, shape[1] + 2), np.inf, np.float32)
        tiles = tiles_of(shape)
        self.todo = np.ones(tiles, np.bool_)
        self._unseen = np.ones(tiles, np.bool_)
        self._labels = np.zeros(shape, np.uint16)
        self._counts, self._passable = np.zeros(tiles, np.int32), np.zeros(tiles, np.int32)
        self._least = np.full(tiles, np.inf)
        self._overlay = Overlay()
        self._forget()
        self._offsets = np.zeros(tiles, np.int64)
        self._parents = np.zeros(0, np.int32)

    def _forget(self) -> None:
        """Forget what does not move with the grid."""
        self._regions: list[_Region] = []
        self._used: dict[int, _Region] = {}
        self._route_key: tuple[Any, ...] = ()
        self._routes: RouteGrid | None = None
        self._route_todo = np.zeros((0, 0), np.bool_)
        self._frontier_cache: FrontierCache | None = None

    def move(self, shift: tuple[int, int], shape: tuple[int, int]) -> None:
        """Lay the layer over another area (see moved); `todo` must hold the tiles at the seam."""
        self.padded = moved(self.padded, shift, (shape[0] + 2, shape[1] + 2), np.inf)
        self.padded[[0, -1]] = self.padded[:, [0, -1]] = np.inf
        self._labels = moved(self._labels, shift, shape, 0)
        tiles = (shift[0] // TILE, shift[1] // TILE), tiles_of(shape)
        self.todo = moved(self.todo, *tiles, False)
        self._unseen = np.ones(tiles_of(shape), np.bool_)
        self._counts = moved(self._counts, *tiles, 0)
        self._passable = moved(self._passable, *tiles, 0)
        self._least = moved(self._least, *tiles, np.inf)
        old = self._overlay
        corner = np.array(shift)
        self._overlay = old._replace(
            before=_shifted(old.before, shift),
            after=_shifted(old.after, shift),
            trails=old.trails + corner,
        )
        self._forget()

    def renew(
        self, levels: Levels, ground: PlanningMap, frontiers: FrontierCells, overlay: Overlay
    ) -> CostMap:
        """Renew all that is to do, and what an overlay changes; return the costs."""
        self._mark_overlay(overlay)
        todo, cost = self.todo, self.padded[1:-1, 1:-1]
        self._overlay = overlay
        renew_costs(levels, ground.squared, self._factors[0], todo, cost, self._least)
        self._lay(overlay, cost, ground, todo)
        label_tiles(cost, todo, self._labels, self._counts, self._passable)
        ends = np.cumsum(self._counts, dtype=np.int64)
        if todo.any():
            self._offsets = (ends - self._counts.ravel()).reshape(self._counts.shape)
            count = int(ends[-1]) if ends.size else 0
            self._parents = join_tiles(self._labels, self._offsets, count)
        del self._regions[len(self._used) :]  # those that nobody was in
        self._used = {}
        for region in self._regions:
            region.todo |= todo
        self._unseen |= todo
        if self._routes is not None:
            self._route_todo |= todo
        if self._frontier_cache is not None:
            self._frontier_cache.todo |= todo
        self.todo = np.zeros_like(todo)
        tight = partial(self._tight, levels, ground, overlay)
        return CostMap(
            cost,
            tight,
            ground.free,
            ground.unknown,
            ground.squared,
            roomy_from(self._paths, self._resolution),
            frontiers,
        )

    def _mark_overlay(self, overlay: Overlay) -> None:
        """Mark the tiles in which an overlay differs from the last one."""
        old = self._overlay
        for discs, others in ((overlay.before, old.before), (overlay.after, old.after)):
            for row, col, radius in set(discs) ^ set(others):
                half = math.floor(radius)
                mark_around(self.todo, np.array([[row, col]], np.int64), half)
        if not np.array_equal(overlay.trails, old.trails):
            span = 2**31
            now, before = overlay.trails, old.trails
            different = np.setxor1d(
                now[:, 0] * span + now[:, 1], before[:, 0] * span + before[:, 1]
            )
            rows = np.floor_divide(different + span // 2, span)
            cells = np.stack([rows, different - rows * span], axis=1)
            mark_around(self.todo, cells, max(overlay.half, old.half))

    @staticmethod
    def _lay(overlay: Overlay, cost: Costs, ground: PlanningMap, todo: Mask) -> None:
        """Lay an overlay over costs (H, W) in some tiles."""
        for disc in overlay.before:
            close_disc(cost, todo, *disc)
        if len(overlay.trails):
            open_around(
                cost, ground.free, ground.squared, overlay.trails, overlay.half,
                overlay.prices, todo,
            )  # fmt: skip
        for disc in overlay.after:
            close_disc(cost, todo, *disc)

    def _tight(self, levels: Levels, ground: PlanningMap, overlay: Overlay) -> Costs:
        """Return the costs (H, W) in tight passages, which few cycles need."""
        cost = np.full(ground.shape, np.inf, np.float32)
        everywhere = np.ones(self.todo.shape, np.bool_)
        renew_costs(levels, ground.squared, self._factors[1], everywhere, cost, self._least.copy())
        self._lay(overlay, cost, ground, everywhere)
        return cost

    @property
    def least(self) -> float:
        """A lower bound of all costs, in tight passages too; 0 if no cell is free."""
        least = float(self._least.min(initial=math.inf))
        return least if math.isfinite(least) else 0.0

    @property
    def passable_cells(self) -> int:
        """Number of passable cells."""
        return int(self._passable.sum())

    def take_changed(self) -> Mask:
        """Return the tiles (R, C) whose costs may have changed since the last call."""
        changed, self._unseen = self._unseen, np.zeros_like(self._unseen)
        return changed

    # -- what is connected ------------------------------------------------------------------------

    def region(self, cell: Cell) -> Mask:
        """Return the cells (H, W) that are connected to a passable cell.

        The same array for all cells of a region; it holds for this cycle.
        """
        tile = cell[0] // TILE, cell[1] // TILE
        root = int(self._parents[self._offsets[tile] + self._labels[cell] - 1])
        if root not in self._used:
            index = len(self._used)
            if index == len(self._regions):
                self._regions.append(_Region(self._labels.shape))
            region = self._regions[index]
            changed = region.renew(self._labels, self._offsets, self._parents == root)
            self._used[root] = region
            if self._routes is not None:
                self._route_todo |= changed
            if self._frontier_cache is not None:
                self._frontier_cache.todo |= changed
        return self._used[root].mask

    def _indices_of(self, masks: list[Mask]) -> tuple[int, ...]:
        """Return which of the regions of this layer are among some masks."""
        every = enumerate(self._regions)
        return tuple(k for k, region in every if any(region.mask is mask for mask in masks))

    def frontier_cache(self, viewpoints: Mask) -> FrontierCache | None:
        """Return what is known of the frontiers seen from a region of this layer, else None."""
        found = self._indices_of([viewpoints])
        if not found:
            return None
        index = found[0]
        cache = self._frontier_cache
        if cache is None or cache.region != index:
            cache = self._frontier_cache = FrontierCache(index, self._unseen.shape)
        return cache

    def routes(self, masks: list[Mask], reach: Mask, block: int, first: Cell) -> RouteGrid:
        """Return the coarse grid over the cells of some regions of this layer.

        reach (H, W): all of them together. block, first: see RouteGrid.
        """
        key = (block, first, self._indices_of(masks))
        if self._routes is None or self._route_key != key:
            cost = self.padded[1:-1, 1:-1]
            self._routes = RouteGrid(cost, reach, first, block, self._resolution)
            self._route_key, self._route_todo = key, np.zeros_like(self._unseen)
        elif self._route_todo.any():
            self._routes.renew(self.padded[1:-1, 1:-1], reach, self._route_todo, TILE)
            self._route_todo[:] = False
        return self._routes


class _Region:
    """The cells of a connected region, and by which labels they were found."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.mask = np.zeros(shape, np.bool_)
        self.todo = np.ones(tiles_of(shape), np.bool_)
        self._offsets = np.zeros(tiles_of(shape), np.int64)
        self._inside = np.zeros(0, np.bool_)

    def renew(self, labels: NDArray[np.uint16], offsets: Cells, inside: Mask) -> Mask:
        """Take the labels (N,) that are inside; return the tiles (R, C) that were renewed."""
        changed = self.todo
        renew_region(labels, offsets, inside, self._offsets, self._inside, changed, self.mask)
        self._offsets, self._inside = offsets, inside
        self.todo = np.zeros_like(changed)
        return changed


def _shifted(discs: tuple[Disc, ...], shift: tuple[int, int]) -> tuple[Disc, ...]:
    return tuple((row + shift[0], col + shift[1], radius) for row, col, radius in discs)
