"""Growing tables: named columns of equal length whose memory doubles as rows are appended."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from explore_slam.errors import SlamError

Column = NDArray[Any]
SPARE_ROWS = 64  # rows that an empty table has memory for


class GrowingTable:
    """Columns of equal length; a column is given by its type and the shape of one entry."""

    def __init__(self, **columns: tuple[DTypeLike, tuple[int, ...]]) -> None:
        self._memory: dict[str, Column] = {
            name: np.zeros((SPARE_ROWS, *shape), kind) for name, (kind, shape) in columns.items()
        }
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, name: str) -> Column:
        """Return a column as a view, which appending may detach from the table."""
        return self._memory[name][: self._count]

    def append(self, count: int, **values: object) -> int:
        """Append rows; values broadcast, columns that are not named become zero.

        Returns the number of the first new row.
        """
        begin, end = self._count, self._count + count
        for name, memory in self._memory.items():
            if end > len(memory):
                grown = np.zeros((max(end, 2 * len(memory)), *memory.shape[1:]), memory.dtype)
                grown[:begin] = memory[:begin]
                self._memory[name] = grown
            self._memory[name][begin:end] = values.get(name, 0)
        self._count = end
        return begin

    def keep(self, rows: NDArray[np.bool_]) -> None:
        """Delete the rows that are not marked; the others keep their order."""
        kept = {name: self[name][rows] for name in self._memory}
        self._count = 0
        self.append(int(rows.sum()), **kept)

    def state_dict(self) -> dict[str, Column]:
        """Return a copy of all columns."""
        return {name: self[name].copy() for name in self._memory}

    def restore(self, what: str, state: Mapping[str, Column]) -> None:
        """Replace all rows by those of `state_dict`; SlamError names what does not fit."""
        count = len(next(iter(state.values()), ()))
        for name, memory in self._memory.items():
            expected = (count, *memory.shape[1:])
            found = state[name].shape if name in state else None
            if found != expected:
                raise SlamError(f'state of {what}: {name} has shape {found}, expected {expected}')
        self._count = 0
        self.append(count, **state)
