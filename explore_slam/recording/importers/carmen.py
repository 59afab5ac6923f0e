"""CARMEN logs, one vehicle each: wheel odometry and laser scans, reference poses as ground truth.

The vehicles are named robot1, robot2 ... in the order of the logs. The ground truth of a corrected
log is what its own SLAM program estimated: a reference, not a measurement.
"""

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path

from explore_slam.errors import RecordingError
from explore_slam.geometry import Pose2
from explore_slam.messages.topics import TopicKind
from explore_slam.recording.carmen_log import CarmenLog, read_carmen
from explore_slam.recording.events import Event, odometry_event, start_event, truth_event
from explore_slam.recording.importers.importing import write_bag
from explore_slam.recording.importers.registry import importer

logger = logging.getLogger(__name__)

# a beam of the SICK changes the grid up to this range (m): its footprint is 0.3 m wide there
LONGEST_MAPPED_RANGE = 20.0
MOUNT_TOLERANCE = 1e-3  # m, rad
ABSOLUTE_TIME = 1e8  # s; later stamps count from 1970, earlier ones from the start of the log


@importer(
    'carmen',
    'CARMEN logs, raw or corrected: laser and odometry, one vehicle per log',
    source='log of one vehicle',
    several=True,
)
def import_carmen(logs: Sequence[Path], out: Path) -> dict[str, int]:
    """Write logs as one bag, a vehicle each; return messages per topic."""
    read = [read_carmen(path) for path in logs]
    for log in read:
        for note in log.notes:
            logger.warning('%s', note)
    return write_carmen_bag(read, out)


def write_carmen_bag(
    logs: Sequence[CarmenLog], out: Path, starts: Sequence[Pose2] | None = None
) -> dict[str, int]:
    """Write logs that have been read as one bag; see start_pose for the default of starts."""
    _check_mounts(logs)
    begins = [float(log.stamps[0]) for log in logs]
    shifts = [0.0] * len(logs)
    if min(begins) < ABSOLUTE_TIME <= max(begins):
        # some count from 1970, some from their start: let all of them start together
        shifts = [-begin for begin in begins]
        logger.warning('logs with absolute and with relative times: all start at the same time')
    poses = starts or [start_pose(log) for log in logs]
    streams = [
        stream
        for index, (log, pose, shift) in enumerate(zip(logs, poses, shifts, strict=True))
        for stream in _streams(log, f'robot{index + 1}', pose, shift)
    ]
    return write_bag(out, streams, sensor_settings(logs[0]))


def sensor_settings(log: CarmenLog) -> dict[str, float]:
    """Return the settings that belong to the sensor: its mount and its range."""
    longest = max(scan.range_max for scan in log.scans)
    return {
        'laser_x': log.mount.x,
        'laser_y': log.mount.y,
        'laser_yaw': log.mount.theta,
        'max_laser_range': min(longest, LONGEST_MAPPED_RANGE),
        'no_return_range': 0.0,  # glass and dark surfaces return nothing either
    }


def start_pose(log: CarmenLog) -> Pose2:
    """Return the pose of the vehicle at the first row.

    In a corrected log the first reference pose, moved back by odometry, so that the map is in the
    frame of the reference; in a raw log the first odometry pose.
    """
    first = Pose2.from_array(log.odometry[0])
    if log.reference is None:
        return first
    at_scan = Pose2.from_array(log.odometry[log.rows[0]])
    return log.scans[0].robot.compose(at_scan.between(first))


def _check_mounts(logs: Sequence[CarmenLog]) -> None:
    for log in logs[1:]:
        if max(map(abs, logs[0].mount.between(log.mount))) > MOUNT_TOLERANCE:
            raise RecordingError(
                f'{log.path.name} has its laser at {tuple(log.mount)}, {logs[0].path.name} at '
                f'{tuple(logs[0].mount)}: expected the same mount on all vehicles of one bag'
            )


def _streams(log: CarmenLog, vehicle: str, start: Pose2, shift: float) -> list[Iterator[Event]]:
    stamps = log.stamps + shift
    at_scans = stamps[log.rows].tolist()
    streams: list[Iterator[Event]] = [
        iter([start_event(vehicle, float(stamps[0]), start)]),
        (
            odometry_event(vehicle, stamp, Pose2(*pose))
            for stamp, pose in zip(stamps.tolist(), log.odometry.tolist(), strict=True)
        ),
        (
            Event(stamp, vehicle, TopicKind.SCAN, scan.record(stamp))
            for stamp, scan in zip(at_scans, log.scans, strict=True)
        ),
    ]
    if log.corrected:
        streams.append(
            truth_event(vehicle, stamp, scan.robot)
            for stamp, scan in zip(at_scans, log.scans, strict=True)
        )
    return streams
