"""Tables of all measurements in the graph, with the current estimate."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.errors import SlamError
from explore_slam.geometry import Array
from explore_slam.slam.checkpoint import State, part, under
from explore_slam.slam.graph.factors import Integers
from explore_slam.slam.graph.tables import GrowingTable

TABLES = ('keyframes', 'factors', 'observations', 'landmarks')
DEAD_ROWS = 0.2  # part of a table's rows; with more of them dropped, it is compacted


class Calibration(NamedTuple):
    """Scale and drift errors of a vehicle's odometry."""

    deviations: Array  # (3,) of the prior, whose mean is zero
    mean: Array  # (3,) estimate


class Storage:
    """Keyframes, factors, observations and landmarks as tables whose rows refer to each other."""

    def __init__(self) -> None:
        self.keyframes = GrowingTable(
            number=(np.int64, ()),
            vehicle=(np.int64, ()),
            ordinal=(np.int64, ()),  # number among those of the vehicle
            live=(np.bool_, ()),  # not dropped: a variable of the graph
            retired=(
                np.bool_,
                (),
            ),  # no longer among the newest: whether it stays has been decided
            holds_landmarks=(np.bool_, ()),  # it stays because its observations are needed
            reference=(np.int64, ()),  # row that it stays relative to when dropped; −1: none
            pins=(np.int64, ()),  # how often the caller has pinned it
            previous=(np.int64, ()),  # row of the vehicle's previous keyframe; −1: none
            increment=(np.float64, (3,)),  # raw motion since the previous keyframe
            covariance=(np.float64, (3, 3)),
            sensitivity=(np.float64, (3, 3)),  # Jacobian of the increment in the calibration
            previous_live=(np.int64, ()),  # row of its previous live keyframe; −1: none
            motion=(np.float64, (3,)),  # raw motion since that one
            motion_covariance=(np.float64, (3, 3)),
            motion_information=(np.float64, (3, 3)),
            motion_sensitivity=(np.float64, (3, 3)),  # Jacobian of the motion in the calibration
            has_white=(np.bool_, ()),
            white_information=(np.float64, (3, 3)),
            pose=(np.float64, (3,)),  # estimate
            chain=(np.float64, (3,)),  # the same with the white error: where the motion ends
        )
        self.factors = GrowingTable(
            number=(np.int64, ()),
            kind=(np.int64, ()),
            a=(np.int64, ()),  # row of a keyframe; −1: none
            b=(np.int64, ()),
            z=(np.float64, (3,)),
            W=(np.float64, (3, 3)),
            robust=(np.int64, ()),
            scale=(np.float64, ()),
        )
        self.observations = GrowingTable(
            number=(np.int64, ()),
            keyframe=(np.int64, ()),  # row
            landmark=(np.int64, ()),  # row; −1: dropped
            visit=(np.int64, ()),  # which visit of the landmark by the vehicle, from 1
            z=(np.float64, (3,)),
            W=(np.float64, (6,)),  # information, scaled by the weight
            weight=(np.float64, ()),
            robust_weight=(np.float64, ()),  # at the last optimum
        )
        self.landmarks = GrowingTable(
            number=(np.int64, ()),  # id; −1: removed
            observation_count=(np.int64, ()),  # observations ever added
            placed=(np.bool_, ()),  # the position is that of the last optimum
            position=(np.float64, (3,)),
        )
        self.landmark_rows: dict[int, int] = {}
        self.newest: dict[int, int] = {}  # vehicle -> row of its newest keyframe
        self.calibrations: dict[int, Calibration] = {}  # vehicle -> calibration
        self.versions: dict[int, int] = {}  # vehicle -> changes that affect it
        self.changes = 0  # of anything
        # (landmark id, vehicle) -> ordinal of the keyframe that observed it last, visits
        self.visits: dict[tuple[int, int], tuple[int, int]] = {}
        self.next_factor = 0
        self.next_observation = 0

    def append_keyframe(self, vehicle: int, *, connected: bool = True, **values: object) -> int:
        """Append a keyframe at the end of a vehicle's path; returns its row.

        connected: whether a motion leads to it from the vehicle's previous keyframe.
        """
        last = self.newest.get(vehicle, -1)
        previous = last if connected else -1
        row = self.keyframes.append(
            1,
            vehicle=vehicle,
            live=True,
            ordinal=0 if last < 0 else self.keyframes['ordinal'][last] + 1,
            previous=previous,
            previous_live=previous,
            reference=-1,
            **values,
        )
        self.newest[vehicle] = row
        self.touch([row])
        return row

    def check_new(self, keyframe: int) -> None:
        """Raise SlamError unless a keyframe number follows the last one."""
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

    def merge_landmark(self, source: int, target: int) -> int:
        """Give the observations of a landmark to another; returns the row that is left empty."""
        row = self.landmark_rows[source]
        owners = self.observations['landmark']
        into = self.landmark_row_of(target)
        owners[owners == row] = into
        self.landmarks['observation_count'][into] += self.landmarks['observation_count'][row]
        for vehicle in self.newest:
            last, count = self.visits.get((source, vehicle), (-1, 0))
            if count:
                other_last, other_count = self.visits.get((target, vehicle), (-1, 0))
                self.visits[target, vehicle] = (max(last, other_last), max(count, other_count))
        return row

    def calibration_of(self, row: int) -> Array:
        """Return the estimated calibration (3,) of the vehicle of a keyframe."""
        found = self.calibrations.get(self.vehicle_of(row))
        return np.zeros(3) if found is None else found.mean

    def calibrated_increments(self, rows: Sequence[int] | Integers) -> Array:
        """Return the calibrated motions (n, 3) that lead to keyframes from their previous ones."""
        table = self.keyframes
        calibrations = np.zeros((max(self.newest, default=-1) + 1, 3))
        for vehicle, calibration in self.calibrations.items():
            calibrations[vehicle] = calibration.mean
        own = calibrations[table['vehicle'][rows]]
        found: Array = table['increment'][rows] + np.einsum(
            'nij,nj->ni', table['sensitivity'][rows], own
        )
        return found

    def vehicle_of(self, row: int) -> int:
        """Return the vehicle of a keyframe."""
        return int(self.keyframes['vehicle'][row])

    def touch(self, rows: Iterable[int] | None = None) -> None:
        """Count a change that affects the vehicles of some keyframes, or all vehicles."""
        self.changes += 1
        changed = self.newest if rows is None else {self.vehicle_of(row) for row in rows}
        for vehicle in changed:
            self.versions[vehicle] = self.versions.get(vehicle, 0) + 1

    def versions_of(self, vehicles: Iterable[int]) -> tuple[int, ...]:
        """Return the counts of changes of some vehicles."""
        return tuple(self.versions[vehicle] for vehicle in vehicles)

    def drop_observations(self, where: NDArray[np.bool_]) -> None:
        """Drop the marked observations; compact the table when most of it is dropped."""
        self.observations['landmark'][where] = -1
        alive = self.observations['landmark'] >= 0
        if alive.sum() < (1.0 - DEAD_ROWS) * len(alive):
            self.observations.keep(alive)

    def forget_landmarks(self, rows: Integers) -> None:
        """Remove landmarks that no longer have observations."""
        for number in self.landmarks['number'][rows].tolist():
            self.landmark_rows.pop(number, None)
            for vehicle in self.newest:
                self.visits.pop((number, vehicle), None)
        self.landmarks['number'][rows] = -1
        alive = self.landmarks['number'] >= 0
        if alive.sum() < (1.0 - DEAD_ROWS) * len(alive):
            moved_to = np.append(np.cumsum(alive) - 1, -1)
            moved_to[:-1][~alive] = -1
            self.observations['landmark'][:] = moved_to[self.observations['landmark']]
            self.landmarks.keep(alive)
            self.landmark_rows = {
                number: row for row, number in enumerate(self.landmarks['number'].tolist())
            }

    def state_dict(self) -> State:
        """Return everything as named arrays."""
        visits = [(*key, *value) for key, value in self.visits.items()]
        state: State = {
            'visits': np.array(visits, np.int64).reshape(-1, 4),
            'calibrations': np.array(
                [[v, *c.deviations, *c.mean] for v, c in self.calibrations.items()]
            ).reshape(-1, 7),
            'next': np.array([self.next_factor, self.next_observation], np.int64),
        }
        for name in TABLES:
            state |= under(name, getattr(self, name).state_dict())
        return state

    def restore(self, state: State) -> None:
        """Replace everything by what `state_dict` returned."""
        for name in TABLES:
            getattr(self, name).restore(name, part(name, state))
        self.landmark_rows = {
            number: row
            for row, number in enumerate(self.landmarks['number'].tolist())
            if number >= 0
        }
        vehicles = self.keyframes['vehicle'].tolist()
        self.newest = {vehicle: row for row, vehicle in enumerate(vehicles)}
        self.versions = dict.fromkeys(self.newest, 0)
        self.visits = {(a, b): (c, d) for a, b, c, d in state['visits'].tolist()}
        self.calibrations = {
            int(row[0]): Calibration(row[1:4].copy(), row[4:].copy())
            for row in state['calibrations']
        }
        self.next_factor, self.next_observation = state['next'].tolist()
