"""Tables of everything that was measured, with the present estimate."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from explore_slam.errors import SlamError
from explore_slam.geometry import Array
from explore_slam.slam.graph.factors import Integers
from explore_slam.slam.graph.tables import Table

SPARSE = 2  # a table is compacted when it has more dead rows than 1 / SPARSE of all


class Storage:
    """Keyframes, factors, observations and landmarks as tables whose rows refer to each other."""

    def __init__(self) -> None:
        self.keyframes = Table(
            number=(np.int64, ()),
            vehicle=(np.int64, ()),
            live=(np.bool_, ()),  # not dropped: a variable of the graph
            increment=(np.float64, (3,)),  # raw motion since the vehicle's keyframe before
            covariance=(np.float64, (3, 3)),
            previous=(np.int64, ()),  # row of the vehicle's live keyframe before; −1: none
            motion=(np.float64, (3,)),  # raw motion since that one
            motion_covariance=(np.float64, (3, 3)),
            motion_information=(np.float64, (3, 3)),
            has_white=(np.bool_, ()),
            white_information=(np.float64, (3, 3)),
            pose=(np.float64, (3,)),  # estimate
            chain=(np.float64, (3,)),  # the same with the white error: where the motion ends
        )
        self.factors = Table(
            number=(np.int64, ()),
            kind=(np.int64, ()),
            a=(np.int64, ()),  # row of a keyframe; −1: none
            b=(np.int64, ()),
            z=(np.float64, (3,)),
            W=(np.float64, (3, 3)),
            robust=(np.int64, ()),
            scale=(np.float64, ()),
        )
        self.observations = Table(
            number=(np.int64, ()),
            keyframe=(np.int64, ()),  # row
            landmark=(np.int64, ()),  # row; −1: dropped
            z=(np.float64, (3,)),
            W=(np.float64, (6,)),  # information, scaled by the weight
            weight=(np.float64, ()),
            influence=(np.float64, ()),  # robust weight at the last optimum
        )
        self.landmarks = Table(
            number=(np.int64, ()),  # id; −1: removed
            placed=(np.bool_, ()),  # the position is that of the last optimum
            position=(np.float64, (3,)),
        )
        self.landmark_rows: dict[int, int] = {}
        self.newest: dict[int, int] = {}  # vehicle -> row of its newest keyframe
        self.versions: dict[int, int] = {}  # vehicle -> changes that concern it
        self.next_factor = 0
        self.next_observation = 0

    def check_new(self, keyframe: int) -> None:
        """Refuse a keyframe number that does not follow the last one."""
        last = int(self.keyframes['number'][-1]) if len(self.keyframes) else -1
        if keyframe <= last:
            raise SlamError(f'keyframe {keyframe} does not come after the last one, {last}')

    def row_of(self, keyframe: int) -> int:
        """Return the row of a keyframe."""
        numbers = self.keyframes['number']
        row = int(np.searchsorted(numbers, keyframe))
        if row == len(numbers) or numbers[row] != keyframe:
            raise SlamError(f'keyframe {keyframe} is not in the graph')
        return row

    def live_row_of(self, keyframe: int) -> int:
        """Return the row of a keyframe that has not been dropped."""
        row = self.row_of(keyframe)
        if not self.keyframes['live'][row]:
            raise SlamError(f'keyframe {keyframe} was dropped, pin what is needed later')
        return row

    def landmark_row_of(self, number: int) -> int:
        """Return the row of a landmark, a new one if it has none."""
        row = self.landmark_rows.get(number)
        if row is None:
            row = self.landmark_rows[number] = self.landmarks.append(1, number=number)
        return row

    def add_factor(
        self, kind: int, a: int, b: int, z: Array, W: Array, robust: int, scale: float
    ) -> int:
        """Append a factor between rows of keyframes; returns its number."""
        number = self.next_factor
        self.next_factor += 1
        self.factors.append(
            1, number=number, kind=kind, a=a, b=b, z=z, W=W, robust=robust, scale=scale
        )
        self.touch([row for row in (a, b) if row >= 0])
        return number

    def vehicle_of(self, row: int) -> int:
        """Return the vehicle of a keyframe."""
        return int(self.keyframes['vehicle'][row])

    def touch(self, rows: Iterable[int] | None = None) -> None:
        """Count a change that concerns the vehicles of some keyframes, or of all."""
        changed = self.newest if rows is None else {self.vehicle_of(row) for row in rows}
        for vehicle in changed:
            self.versions[vehicle] = self.versions.get(vehicle, 0) + 1

    def versions_of(self, vehicles: Iterable[int]) -> tuple[int, ...]:
        """Return the counts of changes of some vehicles."""
        return tuple(self.versions[vehicle] for vehicle in vehicles)

    def drop_observations(self, where: NDArray[np.bool_]) -> None:
        """Drop the observations that are marked, compacting the table now and then."""
        self.observations['landmark'][where] = -1
        alive = self.observations['landmark'] >= 0
        if SPARSE * int(alive.sum()) < len(alive):
            self.observations.keep(alive)

    def forget_landmarks(self, rows: Integers) -> None:
        """Remove landmarks that have no observations any more."""
        for number in self.landmarks['number'][rows].tolist():
            self.landmark_rows.pop(number, None)
        self.landmarks['number'][rows] = -1
        alive = self.landmarks['number'] >= 0
        if SPARSE * int(alive.sum()) < len(alive):
            moved_to = np.append(np.cumsum(alive) - 1, -1)
            moved_to[:-1][~alive] = -1
            self.observations['landmark'][:] = moved_to[self.observations['landmark']]
            self.landmarks.keep(alive)
            self.landmark_rows = {
                number: row for row, number in enumerate(self.landmarks['number'].tolist())
            }
