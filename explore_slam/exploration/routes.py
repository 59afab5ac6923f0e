"""Travel costs on a coarser grid: from vehicles to targets and between targets.

A block of cells costs what its cheapest reachable cell costs. Blocks are no wider than the
planning radius, so that walls, which are inflated by that radius on both sides, remain. Travel
costs are computed by the same value iteration as on the full grid, and those from each target are
kept between planning cycles.
"""

import math

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.exploration.value_iteration import Costs, padded_costs, spread
from explore_slam.geometry import Array

# 16 MB for the fields of the 60 targets of the default strategy: 80 x 80 m in blocks of 0.3 m
_LARGEST_FIELD = 70_000
# Chosen by hand, see benchmarks/planning_cycles.py
_NEW_ROWS = 2  # targets per cycle from which costs are computed to all others on a large map
_NEAR = 15.0  # m from the other new targets, within which ways are searched for


@kernel
def _cheapest(
    cost: Costs,
    reach: NDArray[np.bool_],
    row_shift: int,
    col_shift: int,
    block: int,
    padded: Costs,
) -> None:
    """Set each block of a padded grid to the smallest cost of its reachable cells."""
    for row in range(cost.shape[0]):
        target = padded[(row + row_shift) // block + 1]
        for col in range(cost.shape[1]):
            if reach[row, col]:
                at = (col + col_shift) // block + 1
                target[at] = min(target[at], cost[row, col])


@kernel
def _cheapest_in(
    cost: Costs,
    reach: NDArray[np.bool_],
    row_shift: int,
    col_shift: int,
    block: int,
    padded: Costs,
    todo: NDArray[np.bool_],
    tile: int,
) -> None:
    """Set the blocks that share cells with some tiles, as _cheapest does."""
    height, width = cost.shape
    for tile_row in range(todo.shape[0]):
        for tile_col in range(todo.shape[1]):
            if not todo[tile_row, tile_col]:
                continue
            last_row = min(height, (tile_row + 1) * tile) - 1 + row_shift
            last_col = min(width, (tile_col + 1) * tile) - 1 + col_shift
            for i in range((tile_row * tile + row_shift) // block, last_row // block + 1):
                top = max(0, i * block - row_shift)
                bottom = min(height, (i + 1) * block - row_shift)
                for j in range((tile_col * tile + col_shift) // block, last_col // block + 1):
                    left = max(0, j * block - col_shift)
                    right = min(width, (j + 1) * block - col_shift)
                    low = np.float32(np.inf)
                    for row in range(top, bottom):
                        for col in range(left, right):
                            if reach[row, col]:
                                low = min(low, cost[row, col])
                    padded[i + 1, j + 1] = low


class RouteGrid:
    """The coarse grid of one planning cycle, over the cells that some vehicle can reach.

    unit: side of a block (m).
    """

    def __init__(
        self,
        cost: Costs,
        reach: NDArray[np.bool_],
        first: tuple[int, int],
        block: int,
        unit: float,
    ) -> None:
        """Build the grid over costs (H, W).

        first: row and column of cell [0, 0], counted from the origin of the map frame.
        block: cells along the side of a block.
        unit: side of a cell (m).
        """
        self.block, self.unit = block, unit * block
        self.first = (first[0] // block, first[1] // block)
        self._world = first
        shift = self._shift = (first[0] % block, first[1] % block)
        height = -(-(cost.shape[0] + shift[0]) // block)
        width = -(-(cost.shape[1] + shift[1]) // block)
        self.padded = np.full((height + 2, width + 2), np.inf, np.float32)
        _cheapest(cost, reach, shift[0], shift[1], block, self.padded)

    @property
    def size(self) -> int:
        """Number of blocks."""
        return int(self.padded.size)

    def renew(
        self, cost: Costs, reach: NDArray[np.bool_], todo: NDArray[np.bool_], tile: int
    ) -> None:
        """Take costs and reachable cells (H, W) that have changed in some tiles.

        todo (R, C): which tiles; tile: cells along the side of a tile. The grid is the same.
        """
        _cheapest_in(cost, reach, *self._shift, self.block, self.padded, todo, tile)

    def blocks(self, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the blocks (N, 2), counted from the origin of the map, of cells (N, 2)."""
        blocks: NDArray[np.int64] = (cells + np.array(self._world)) // self.block
        return blocks

    def values_from(self, block: NDArray[np.int64]) -> 'Field':
        """Return the travel cost (m) from a block."""
        return self._spread(self.padded, block, self.first)

    def values_near(self, block: NDArray[np.int64], reach: float) -> 'Field':
        """Return the travel cost (m) from a block, for blocks within a reach (m) to all sides.

        A way that leaves this window for a while is not found.
        """
        half = max(1, round(reach / self.unit))
        row, col = (block - np.array(self.first)).tolist()
        low_row, low_col = max(0, row - half), max(0, col - half)
        window = self.padded[1:-1, 1:-1][low_row : row + half + 1, low_col : col + half + 1]
        first = self.first[0] + low_row, self.first[1] + low_col
        return self._spread(padded_costs(window, math.inf), block, first)

    def _spread(self, padded: Costs, block: NDArray[np.int64], first: tuple[int, int]) -> 'Field':
        """Return the travel cost (m) from a block over padded costs that begin at a block."""
        row, col = (block - np.array(first) + 1).tolist()
        rows, cols = np.array([row], np.int64), np.array([col], np.int64)
        values = spread(padded, rows, cols)
        values *= np.float32(self.unit)
        return Field(values, first)


class Field:
    """Travel cost from one block to all others of a route grid."""

    def __init__(self, values: Costs, first: tuple[int, int]) -> None:
        self._values, self._first = values, np.array(first)

    def at(self, blocks: NDArray[np.int64]) -> Array:
        """Return the travel cost (N,) m to blocks (N, 2); inf if unreachable or outside."""
        index = blocks - self._first + 1
        inside = ((index >= 0) & (index < self._values.shape)).all(axis=1)
        result = np.full(len(blocks), np.inf)
        picked = index[inside]
        result[inside] = self._values[picked[:, 0], picked[:, 1]]
        return result


class _Row:
    """Travel cost from one block to those of some targets: what is needed of a field."""

    def __init__(self, blocks: NDArray[np.int64], field: Field) -> None:
        keys, first = np.unique(_keys(blocks), return_index=True)
        self._keys, self._values = keys, field.at(blocks[first])

    def holds(self, blocks: NDArray[np.int64]) -> bool:
        """Return whether all blocks (N, 2) are among the targets."""
        return bool(np.isin(_keys(blocks), self._keys).all())

    def at(self, blocks: NDArray[np.int64]) -> Array:
        """Return the travel cost (N,) m to blocks (N, 2); inf to those that are not among them."""
        wanted = _keys(blocks)
        index = np.minimum(np.searchsorted(self._keys, wanted), len(self._keys) - 1)
        found: Array = np.where(self._keys[index] == wanted, self._values[index], np.inf)
        return found


def _keys(blocks: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return a number (N,) for each block (N, 2)."""
    keys: NDArray[np.int64] = blocks[:, 0] * 2**32 + blocks[:, 1]
    return keys


class CostsFrom:
    """Travel costs from one block, over a route grid that does not change meanwhile.

    On a large map, only the costs to the blocks that were asked for are kept.
    """

    def __init__(
        self, grid: RouteGrid, block: NDArray[np.int64], largest_field: int = _LARGEST_FIELD
    ) -> None:
        """Prepare the costs; largest_field: number of blocks up to which all of them are kept."""
        self._grid, self._block, self._largest_field = grid, block, largest_field
        self._field: Field | None = None
        self._asked = np.empty((0, 2), np.int64)
        self._row: _Row | None = None

    def to(self, blocks: NDArray[np.int64]) -> Array:
        """Return the travel cost (N,) m to blocks (N, 2); inf if unreachable or outside."""
        if self._row is not None and self._row.holds(blocks):
            return self._row.at(blocks)
        field = self._field or self._grid.values_from(self._block)
        if self._grid.size <= self._largest_field:
            self._field = field
        elif len(blocks):
            self._asked = np.concatenate([self._asked, blocks])
            self._row = _Row(self._asked, field)
        return field.at(blocks)


class RouteCache:
    """Travel costs between targets, kept between planning cycles.

    As the map grows, costs from an old target to new ones go out of date; costs are taken from
    whichever of the two targets knows the shorter way.

    On a large map, a field takes as much memory and time as a whole cycle should. Then only the
    costs to the frontiers that exist are kept of it, and only a few fields are made per cycle:
    those of new targets first, then the oldest. From the others, ways are searched for nearby, and
    the way to what is far leads over a vehicle. New targets are near vehicles, so that this is
    not much longer.
    """

    def __init__(self, lifetime: int = 40, largest_field: int = _LARGEST_FIELD) -> None:
        """Create an empty cache; costs are computed anew after `lifetime` cycles.

        largest_field: number of blocks up to which fields are kept.
        """
        self._fields: dict[tuple[int, int], tuple[int, Field | _Row]] = {}
        self._lifetime, self._largest_field = lifetime, largest_field
        self._cycle = 0

    def between(
        self,
        grid: RouteGrid,
        blocks: NDArray[np.int64],
        targets: NDArray[np.int64] | None = None,
        costs: Array | None = None,
    ) -> Array:
        """Return the costs (F, F) m between frontiers in blocks (N, 2), of which F are targets.

        targets (F,): which; by default all. costs (V, N): from vehicles to the frontiers (m).
        """
        self._cycle += 1
        chosen = np.arange(len(blocks)) if targets is None else targets
        wanted = blocks[chosen]
        keys = [(int(row), int(col)) for row, col in wanted]
        large = grid.size > self._largest_field
        matrix = self._of_rows(grid, blocks, keys) if large else self._of_fields(grid, keys)
        symmetric: Array = np.minimum(matrix, matrix.T)
        if large and costs is not None:
            for row in costs[:, chosen]:
                symmetric = np.minimum(symmetric, row[:, None] + row[None])
            np.fill_diagonal(symmetric, 0.0)
        return symmetric

    def _of_fields(self, grid: RouteGrid, keys: list[tuple[int, int]]) -> Array:
        """Return the costs (F, F) m between blocks by fields, which are kept."""
        wanted, oldest = set(keys), self._cycle - self._lifetime
        self._fields = {
            key: item for key, item in self._fields.items() if key in wanted and item[0] >= oldest
        }
        blocks = np.array(keys)
        for key, block in zip(keys, blocks, strict=True):
            if key not in self._fields:
                self._fields[key] = (self._cycle, grid.values_from(block))
        return np.array([self._fields[key][1].at(blocks) for key in keys])

    def _of_rows(
        self, grid: RouteGrid, every: NDArray[np.int64], keys: list[tuple[int, int]]
    ) -> Array:
        """Return the costs (F, F) m between blocks by rows, which are kept; inf if unknown.

        every (N, 2): blocks of all that may become targets.
        """
        existing = {(int(row), int(col)) for row, col in every}
        self._fields = {key: item for key, item in self._fields.items() if key in existing}
        new = [key for key in dict.fromkeys(keys) if key not in self._fields]
        oldest = self._cycle - self._lifetime
        old = [key for key, item in self._fields.items() if item[0] < oldest and key in keys]
        old.sort(key=lambda key: self._fields[key][0])
        whole = _NEW_ROWS if self._fields else len(new)
        for key in [*new, *old][:whole]:
            field = grid.values_from(np.array(key))
            self._fields[key] = (self._cycle, _Row(every, field))
        blocks = np.array(keys)
        rows = {key: self._fields[key][1] for key in keys if key in self._fields}
        for key in new[whole:]:
            rows[key] = grid.values_near(np.array(key), _NEAR)
        return np.array([rows[key].at(blocks) for key in keys])


def block_size(width: float, radius: float, resolution: float) -> int:
    """Return the side of a block (cells) for a width (m) of at most the planning radius (m)."""
    return max(1, math.floor(min(width, radius) / resolution + 1e-9))
