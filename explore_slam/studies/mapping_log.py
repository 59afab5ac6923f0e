"""Laser logs made ready for the mapping study: a bag, and what its map is evaluated against.

A log is a CARMEN file or a bag. A CARMEN log may be cut into two vehicles that drive at the same
time.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from explore_slam.data import OdometryReading
from explore_slam.errors import EvaluationError
from explore_slam.geometry import Array, Pose2
from explore_slam.messages.topics import TopicKind
from explore_slam.recording import BagReader, Replay
from explore_slam.recording.carmen_log import CarmenLog, read_carmen
from explore_slam.recording.importers.carmen import start_pose, write_carmen_bag
from explore_slam.results.relations import LoggedOdometry, Relations, find_offset
from explore_slam.results.replay_run import configuration
from explore_slam.results.trajectory import Trajectory

STARTS = ('known', 'unknown')


@dataclass(frozen=True)
class VehicleLog:
    """What one vehicle's part of a log holds beside the bag: in the stamps of the bag.

    stamps (N,) s and times (N,) s of the log; odometry (N, 3); scan_stamps (S,) s; reference
    (S, 3) poses of the vehicle, None where the log has none.
    """

    stamps: Array
    times: Array
    odometry: Array
    scan_stamps: Array
    reference: Array | None

    def log_times(self, stamps: Array) -> Array:
        """Return the times of the log at stamps (T,) s of the bag."""
        after = np.clip(np.searchsorted(self.stamps, stamps), 0, len(self.stamps) - 1)
        before = np.maximum(after - 1, 0)
        nearer = np.abs(self.stamps[before] - stamps) < np.abs(self.stamps[after] - stamps)
        return self.times[np.where(nearer, before, after)]


@dataclass(frozen=True)
class MappingTask:
    """A log ready to be replayed: its bag, what it is evaluated against, and settings.

    unknown_starts: vehicles whose start pose the agent is not given.
    """

    name: str
    bag: Path
    vehicles: Mapping[str, VehicleLog]
    laser: Pose2
    relations: Relations | None
    offset: float
    settings: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    unknown_starts: tuple[str, ...] = ()
    picture_folder: Path | None = None


def prepare(
    path: Path,
    folder: Path,
    *,
    relations: Path | None = None,
    offset: float | None = None,
    cut: float | None = None,
    starts: str = 'known',
    settings: Mapping[str, Any] | None = None,
) -> MappingTask:
    """Read a log, write its bag into a folder, and find the offset of the relations' times.

    cut: seconds from the start after which the log becomes that of a second vehicle. starts: see
    STARTS; with unknown ones, only the first vehicle's is given.
    """
    if starts not in STARTS:
        raise EvaluationError(f'starts is {starts!r}, expected one of {list(STARTS)}')
    if path.is_dir() or path.suffix in ('.mcap', '.db3'):
        if cut is not None:
            raise EvaluationError('a bag cannot be cut, expected a CARMEN log')
        bag, laser, vehicles = path, _laser_of_bag(path), _vehicles_of_bag(path)
        unknown = _unknown_starts(path, vehicles, starts)
        notes: tuple[str, ...] = ()
    else:
        log = read_carmen(path)
        notes = log.notes
        logs = [log] if cut is None else cut_log(log, cut)
        vehicles = {f'robot{i + 1}': _vehicle_log(log) for i, log in enumerate(logs)}
        unknown = _unknown_starts(path, vehicles, starts)
        laser, bag = logs[0].mount, folder / 'bag'
        write_carmen_bag(logs, bag, [start_pose(log) for log in logs])
    wanted = Relations.load(relations) if relations is not None else None
    if wanted is not None and offset is None:
        offset = find_offset(wanted, odometry_of(vehicles), laser)
    if wanted is None and all(log.reference is None for log in vehicles.values()):
        raise EvaluationError(
            f'{path} has no corrected poses: expected relations to evaluate it with'
        )
    return MappingTask(
        path.stem,
        bag,
        vehicles,
        laser,
        wanted,
        offset or 0.0,
        dict(settings or {}),
        notes,
        unknown,
    )


def _unknown_starts(
    path: Path, vehicles: Mapping[str, VehicleLog], starts: str
) -> tuple[str, ...]:
    """Return the vehicles whose start pose the agent is not given: all but the first, or none."""
    if starts == 'known':
        return ()
    if len(vehicles) < 2:
        raise EvaluationError(f'{path} is of one vehicle: expected --cut with --starts unknown')
    return tuple(vehicles)[1:]


def cut_log(log: CarmenLog, seconds: float) -> list[CarmenLog]:
    """Return the log before and after so many seconds; the second one starts with the first.

    The second part begins at a scan, whose reference pose is its start pose. A raw log states no
    pose that both parts have in common.
    """
    if log.reference is None:
        raise EvaluationError(
            f'{log.path} is a raw log: the start of its second part is not known in the first'
        )
    later = np.flatnonzero(log.stamps[log.rows] >= log.stamps[0] + seconds)
    if not later.size or later[0] == 0:
        raise EvaluationError(
            f'cut after {seconds:g} s leaves a part without scans: {log.path} spans '
            f'{log.stamps[-1] - log.stamps[0]:.0f} s'
        )
    scan = int(later[0])
    row = int(log.rows[scan])
    first = replace(
        log,
        odometry=log.odometry[:row],
        stamps=log.stamps[:row],
        times=log.times[:row],
        rows=log.rows[:scan],
        scans=log.scans[:scan],
        reference=log.reference[:scan],
    )
    second = replace(
        log,
        odometry=log.odometry[row:],
        stamps=log.stamps[row:] - log.stamps[row] + log.stamps[0],
        times=log.times[row:],
        rows=log.rows[scan:] - row,
        scans=log.scans[scan:],
        reference=log.reference[scan:],
    )
    return [first, second]


def _vehicle_log(log: CarmenLog) -> VehicleLog:
    usable = np.isfinite(log.times)
    times = np.where(usable, log.times, np.interp(log.stamps, *_known(log, usable)))
    reference = np.array([scan.robot for scan in log.scans]) if log.corrected else None
    return VehicleLog(log.stamps, times, log.odometry, log.stamps[log.rows], reference)


def _known(log: CarmenLog, usable: Any) -> tuple[Array, Array]:
    """Return stamps and times where the times are usable; the stamps themselves where none is."""
    if not usable.any():
        return log.stamps, log.stamps
    return log.stamps[usable], log.times[usable]


def odometry_of(vehicles: Mapping[str, VehicleLog]) -> LoggedOdometry:
    """Return the odometry of the whole log, which its parts continue."""
    return LoggedOdometry(
        np.concatenate([log.times for log in vehicles.values()]),
        np.concatenate([log.odometry for log in vehicles.values()]),
    )


def _laser_of_bag(path: Path) -> Pose2:
    return configuration(path).laser_mount.pose


def _vehicles_of_bag(path: Path) -> dict[str, VehicleLog]:
    odometry: dict[str, list[tuple[float, ...]]] = {}
    truth: dict[str, list[tuple[float, ...]]] = {}
    scans: dict[str, list[float]] = {}
    with BagReader(path) as bag:
        for event in Replay(bag).events():
            if event.kind is TopicKind.SCAN:
                scans.setdefault(event.vehicle, []).append(event.stamp)
            elif isinstance(event.record, OdometryReading):
                into = {TopicKind.ODOMETRY: odometry, TopicKind.GROUND_TRUTH: truth}.get(
                    event.kind
                )
                if into is not None:
                    into.setdefault(event.vehicle, []).append((event.stamp, *event.record.pose))
    found = {}
    for vehicle, rows in odometry.items():
        driven = _trajectory(rows)
        stamps = np.array(scans.get(vehicle, []))
        reference = None
        if vehicle in truth and stamps.size:
            poses, valid = _trajectory(truth[vehicle]).at(stamps)
            stamps, reference = stamps[valid], poses[valid]
        found[vehicle] = VehicleLog(driven.stamps, driven.stamps, driven.poses, stamps, reference)
    return found


def _trajectory(rows: list[tuple[float, ...]]) -> Trajectory:
    table = np.array(rows)
    return Trajectory.of(table[:, 0], table[:, 1:])
