"""Error of a trajectory over reference relations: true relative poses between pairs of times.

Kümmerle et al., On Measuring the Accuracy of SLAM Algorithms, Autonomous Robots 27, 2009: the
error of a relation is (reference relation)⁻¹ ∘ (estimated relation). Relations over short times
measure local accuracy, those over long times closed loops.

Times of relations lie between the poses of a trajectory. The pose at such a time comes from the
pose before and the pose after it, each carried to the time by odometry, blended by time: through
the nearest pose alone even a perfect trajectory scores several centimetres.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.errors import EvaluationError
from explore_slam.geometry import (
    IDENTITY,
    Array,
    Pose2,
    between,
    compose,
    interpolated,
    wrap_angles,
)

# Chosen by hand for the relations of Intel, ACES and Belgioioso (test_relations).
LOOP_SECONDS = 20.0  # relations over more than this time are those of loops
MAX_GAP = 6.0  # s; relations farther from the nearest pose are left out
COLUMNS = 8  # t1 t2 x y z roll pitch yaw
VOTE_WIDTH = 0.002  # s; votes for offsets this close count together
NEARLY_AS_MANY = 0.8  # of the most votes: candidates between which odometry decides
MINIMUM_VOTES = 0.3  # of the times of the relations must coincide with odometry at their offset


@dataclass(frozen=True)
class Relations:
    """Reference relations: times (R, 2) s, and the relative pose (R, 3) from first to second."""

    times: Array
    poses: Array

    def __len__(self) -> int:
        return len(self.times)

    @classmethod
    def load(cls, path: Path) -> 'Relations':
        """Read a file of the SLAM benchmark, rows: t1 t2 x y z roll pitch yaw (s, m, rad)."""
        try:
            lines = path.read_text(encoding='utf-8').splitlines()
            table = np.loadtxt(lines, ndmin=2) if any(lines) else np.empty((0, 0))
        except (OSError, ValueError) as error:
            raise EvaluationError(f'{path} holds no relations: {error}') from error
        if table.shape[1] != COLUMNS or not len(table) or not np.isfinite(table).all():
            raise EvaluationError(
                f'{path} holds {len(table)} rows of {table.shape[1]} numbers, expected one row or '
                f'more of {COLUMNS} finite ones'
            )
        return cls(table[:, :2], table[:, [2, 3, 7]])


@dataclass(frozen=True)
class LoggedOdometry:
    """Wheel odometry in the time of the log: times (N,) s in any order, poses (N, 3)."""

    times: Array
    poses: Array

    def sorted(self) -> 'LoggedOdometry':
        """Return it in order of time."""
        order = np.argsort(self.times, kind='stable')
        return LoggedOdometry(self.times[order], self.poses[order])

    def at(self, times: Array) -> Array:
        """Return poses (T, 3), interpolated; self must be in order of time."""
        x, y = (np.interp(times, self.times, self.poses[:, axis]) for axis in (0, 1))
        heading = np.interp(times, self.times, np.unwrap(self.poses[:, 2]))
        return np.column_stack([x, y, wrap_angles(heading)])


class RelationErrors(NamedTuple):
    """Errors of the relations that lie within the trajectory; translation (m), rotation (rad).

    seconds: (U,) time between the two poses of each. left_out: relations too far from any pose.
    """

    translation: Array
    rotation: Array
    seconds: Array
    left_out: int

    def figures(self) -> dict[str, float | None]:
        """Return mean and standard deviation, and the means of short and long relations."""
        loops = self.seconds > LOOP_SECONDS

        def mean(values: Array) -> float | None:
            return float(values.mean()) if values.size else None

        return {
            'translation_mean_m': mean(self.translation),
            'translation_std_m': float(self.translation.std()) if len(self.translation) else None,
            'rotation_mean_deg': mean(np.degrees(self.rotation)),
            'near_m': mean(self.translation[~loops]),
            'loops_m': mean(self.translation[loops]),
        }


def find_offset(relations: Relations, odometry: LoggedOdometry, sensor: Pose2 = IDENTITY) -> float:
    """Return time of the relations minus time of the log (s).

    Relations were measured between scans, which share their times with odometry readings: at the
    right offset most times coincide. Where readings come at a steady rate this holds at many
    offsets; of these the one is taken at which odometry agrees best with the relations.
    EvaluationError where the times coincide at no offset.
    """
    known = np.isfinite(odometry.times)
    path = LoggedOdometry(odometry.times[known], odometry.poses[known]).sorted()
    wanted, times = np.unique(relations.times), np.unique(path.times)
    if not times.size:
        raise EvaluationError('the log has no usable times: relations cannot be evaluated')
    low, high = wanted[-1] - times[-1] - 1.0, wanted[0] - times[0] + 1.0
    if low > high:
        raise EvaluationError(
            f'the relations span {wanted[-1] - wanted[0]:.0f} s, the log '
            f'{times[-1] - times[0]:.0f} s: they are not of this log'
        )
    candidates = _coincidences(wanted, times, low, high)
    if not candidates:
        raise EvaluationError(
            f'no offset brings the {len(wanted)} times of the relations onto those of the log; '
            'give it with --offset'
        )
    return min(candidates, key=lambda offset: _disagreement(relations, path, sensor, offset))


def _coincidences(wanted: Array, times: Array, low: float, high: float) -> list[float]:
    """Return the offsets in [low, high] at which most wanted times coincide with given ones."""
    first = np.searchsorted(times, wanted - high)
    last = np.searchsorted(times, wanted - low, 'right')
    differences = np.sort(
        np.concatenate([time - times[a:b] for time, a, b in zip(wanted, first, last, strict=True)])
    )
    ends = np.searchsorted(differences, differences + VOTE_WIDTH, 'right')
    votes = ends - np.arange(len(differences))
    found: list[float] = []
    enough = max(MINIMUM_VOTES * len(wanted), NEARLY_AS_MANY * votes.max(initial=0))
    for index in np.argsort(-votes, kind='stable').tolist():
        if votes[index] < enough:
            break
        offset = float(np.median(differences[index : ends[index]]))
        if all(abs(offset - other) > 2.0 * VOTE_WIDTH for other in found):
            found.append(offset)
    return found


def _disagreement(
    relations: Relations, odometry: LoggedOdometry, sensor: Pose2, offset: float
) -> float:
    """Return the median difference (m, with 1 rad as 1 m) of short relations from odometry."""
    apart = np.abs(np.diff(relations.times, axis=1)[:, 0])
    short = apart <= max(LOOP_SECONDS, float(apart.min()))
    ends = [
        compose(odometry.at(relations.times[short, side] - offset), np.asarray(sensor))
        for side in (0, 1)
    ]
    error = between(relations.poses[short], between(ends[0], ends[1]))
    return float(np.median(np.hypot(error[:, 0], error[:, 1]) + np.abs(error[:, 2])))


def relation_errors(
    relations: Relations,
    times: Array,
    poses: Array,
    odometry: LoggedOdometry,
    offset: float,
    sensor: Pose2 = IDENTITY,
) -> RelationErrors:
    """Return the errors of estimated vehicle poses (N, 3) at times (N,) s of the log.

    sensor: the pose on the vehicle of what the relations were measured with. Relations whose times
    are more than MAX_GAP from the nearest pose are left out; EvaluationError if all are.
    """
    if not len(times):
        raise EvaluationError('no poses to evaluate')
    order = np.argsort(times, kind='stable')
    times, poses, odometry = times[order], poses[order], odometry.sorted()
    ends = [poses_at(relations.times[:, side] - offset, times, poses, odometry) for side in (0, 1)]
    used = (ends[0][1] < MAX_GAP) & (ends[1][1] < MAX_GAP)
    if not used.any():
        raise EvaluationError(
            f'none of {len(relations)} relations lies within the trajectory: times of the log '
            f'{times[0]:.1f} to {times[-1]:.1f} s, of the relations '
            f'{relations.times.min() - offset:.1f} to {relations.times.max() - offset:.1f} s'
        )
    first, second = (compose(end[0][used], np.asarray(sensor)) for end in ends)
    error = between(relations.poses[used], between(first, second))
    apart = np.abs(relations.times[used, 1] - relations.times[used, 0])
    return RelationErrors(
        np.hypot(error[:, 0], error[:, 1]),
        np.abs(error[:, 2]),
        apart,
        int(np.count_nonzero(~used)),
    )


def poses_at(
    wanted: Array, times: Array, poses: Array, odometry: LoggedOdometry
) -> tuple[Array, Array]:
    """Return poses (T, 3) at wanted times (T,) s, and how far (T,) s the nearest given pose is.

    times (N,) and odometry must be in order of time.
    """
    after = np.clip(np.searchsorted(times, wanted), min(1, len(times) - 1), len(times) - 1)
    before = np.maximum(after - 1, 0)
    here = odometry.at(wanted)

    def carried(index: NDArray[Any]) -> Array:
        return compose(poses[index], between(odometry.at(times[index]), here))

    one, other = carried(before), carried(after)
    span = np.maximum(times[after] - times[before], 1e-9)
    blended = interpolated(one, other, np.clip((wanted - times[before]) / span, 0.0, 1.0))
    gap = np.minimum(np.abs(times[before] - wanted), np.abs(times[after] - wanted))
    return blended, gap
