"""Importer of the Intel Research Lab data set (D. Hähnel): laser and odometry of one robot.

`intel_raw_odom_scans.npz`: ranges (N, 180) m from -90° to +89°, valid (N, 180), odom_inc (N, 3),
the motion after each scan. The log has no usable times: stamps follow from the motion at a nominal
speed, so that timeouts and rates are plausible.

`reference_pose_flirt.csv` (step, x, y, theta of a corrected log, in a frame of its own) becomes
the ground truth of those steps. It is moved to agree with the odometry at its first step, so only
errors after alignment are meaningful.
"""

import logging
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import LaserScan
from explore_slam.errors import RecordingError
from explore_slam.geometry import IDENTITY, Array, Pose2, between, compose
from explore_slam.messages.topics import TopicKind
from explore_slam.recording.carmen_log import beam_step
from explore_slam.recording.events import Event, odometry_event, start_event, truth_event
from explore_slam.recording.importers.importing import read_table, require, write_bag
from explore_slam.recording.importers.registry import importer

logger = logging.getLogger(__name__)

LOG, REFERENCE = 'intel_raw_odom_scans.npz', 'reference_pose_flirt.csv'
VEHICLE = 'robot1'
SPEED = 0.5  # m/s; nominal, for the stamps
TURN_RATE = 0.8  # rad/s
SCAN_PERIOD = 0.1  # s; the minimum time between scans
FIRST_STAMP = 1.0  # s
RANGE_MIN, RANGE_MAX = 0.05, 80.0  # m; larger readings mean no return
# the log does not say where the laser is mounted; corridors are long
SETTINGS: dict[str, float | str] = {
    'laser_x': 0.0,
    'laser_y': 0.0,
    'laser_yaw': 0.0,
    'max_laser_range': 20.0,
    'no_return_range': 0.0,
}


@importer('intel', 'Intel Research Lab: laser and odometry of one robot')
def import_intel(folder: Path, out: Path) -> dict[str, int]:
    """Write the data set in the folder as a bag; return the messages per topic."""
    require(folder, [LOG], 'the Intel data set')
    ranges, valid, increments = _read_log(folder / LOG)
    stamps = synthetic_stamps(increments)
    poses = odometry_poses(increments)
    streams = [
        iter([start_event(VEHICLE, FIRST_STAMP, IDENTITY)]),
        _odometry(stamps, poses),
        _scans(stamps, ranges, valid),
    ]
    if (folder / REFERENCE).exists():
        streams.append(_truth(read_table(folder / REFERENCE, 4), stamps, poses))
    else:
        logger.warning('%s is missing: the bag has no ground truth', folder / REFERENCE)
    return write_bag(out, streams, SETTINGS)


def _read_log(path: Path) -> tuple[NDArray[np.float32], NDArray[np.bool_], Array]:
    try:
        with np.load(path) as log:
            ranges = np.asarray(log['ranges'], dtype=np.float32)
            valid = np.asarray(log['valid'], dtype=bool)
            increments = np.asarray(log['odom_inc'], dtype=np.float64)
    except (OSError, ValueError, KeyError) as error:
        raise RecordingError(f'{path} is not the log of the Intel data set: {error}') from error
    count = len(ranges)
    if ranges.ndim != 2 or valid.shape != ranges.shape or increments.shape != (count, 3):
        raise RecordingError(
            f'{path}: ranges {ranges.shape}, valid {valid.shape}, odom_inc {increments.shape}, '
            'expected (N, B), (N, B), (N, 3)'
        )
    return ranges, valid, increments


def synthetic_stamps(increments: Array) -> Array:
    """Return increasing stamps (N,) s of scans, given the increments (N, 3) after each of them."""
    distance = np.hypot(increments[:, 0], increments[:, 1])
    needed = np.maximum(distance / SPEED, np.abs(increments[:, 2]) / TURN_RATE)
    steps = np.maximum(needed, SCAN_PERIOD)[:-1]
    stamps: Array = FIRST_STAMP + np.concatenate([[0.0], np.cumsum(steps)])
    return stamps


def odometry_poses(increments: Array) -> Array:
    """Return the odometry pose (N, 3) at each scan."""
    pose, poses = IDENTITY, [IDENTITY]
    for increment in increments[:-1].tolist():
        pose = pose.compose(Pose2(*increment))
        poses.append(pose)
    return np.array(poses)


def _odometry(stamps: Array, poses: Array) -> Iterator[Event]:
    for stamp, pose in zip(stamps.tolist(), poses.tolist(), strict=True):
        yield odometry_event(VEHICLE, stamp, Pose2(*pose))


def _scans(
    stamps: Array, ranges: NDArray[np.float32], valid: NDArray[np.bool_]
) -> Iterator[Event]:
    increment = beam_step(ranges.shape[1])
    for stamp, row, good in zip(stamps.tolist(), ranges, valid, strict=True):
        # REP-117: no return is +inf; other readings that the log marks as invalid are NaN
        far = row > RANGE_MAX
        values = np.where(good & ~far, row, np.where(far, np.inf, np.nan)).astype(np.float32)
        scan = LaserScan(stamp, -0.5 * math.pi, increment, values, RANGE_MIN, RANGE_MAX)
        yield Event(stamp, VEHICLE, TopicKind.SCAN, scan)


def align_reference(reference: Array, stamps: Array, odometry: Array) -> tuple[Array, Array]:
    """Return stamps (R,) and poses (R, 3) in the map of the reference.

    reference: (R, 4) step, x, y, theta. odometry: (N, 3) poses at the stamps (N,).
    """
    steps = reference[:, 0].astype(int)
    if (steps < 0).any() or (steps >= len(stamps)).any():
        raise RecordingError(
            f'{REFERENCE}: step {int(steps.max())}, expected 0 to {len(stamps) - 1}'
        )
    order = np.argsort(steps, kind='stable')
    steps, poses = steps[order], reference[order, 1:]
    return stamps[steps], compose(odometry[steps[0]], between(poses[0], poses))


def _truth(reference: Array, stamps: Array, odometry: Array) -> Iterator[Event]:
    times, poses = align_reference(reference, stamps, odometry)
    for stamp, pose in zip(times.tolist(), poses.tolist(), strict=True):
        yield truth_event(VEHICLE, stamp, Pose2(*pose))
