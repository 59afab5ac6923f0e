"""Importer of UTIAS MR.CLAM: five robots, odometry, bar-coded landmarks, motion-capture truth.

Leung, Halpern, Barfoot and Liu, "The UTIAS multi-robot cooperative localization and mapping
dataset", International Journal of Robotics Research 30(8), 2011. Each bar code becomes a landmark
with a descriptor of its own, a unit vector far from all others, so that the data association is
known (as in experiment 1). Bar codes of robots become inter-robot observations.

The camera measures the bearing of a code by its place in the image, and the range by its size.
The size gives the depth along the optical axis, which the logs call the range: at the edge of the
image it is 15 % shorter than the distance. `distances` corrects it. Noise of camera and odometry,
and the correlation lengths of the camera's errors, are the same for all robots; all figures are
those of `benchmarks/noise_mrclam.py`.

The logged odometry is what the robot was commanded: the robot follows it some tenths of a second
later. The delay is estimated from the recording itself, by comparing how far the odometry and the
bearings of one landmark turn (`odometry_delay`). Landmarks and robots lie in the plane: height 0.
"""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from explore_slam.data import DESCRIPTOR_LENGTH, InterRobotObservation, LandmarkObservations
from explore_slam.errors import RecordingError
from explore_slam.geometry import Array, Pose2, compose, wrap_angles
from explore_slam.messages.topics import TopicKind
from explore_slam.recording.events import Event, odometry_event, start_event, truth_event
from explore_slam.recording.importers.importing import read_table, require, write_bag
from explore_slam.recording.importers.registry import importer
from explore_slam.recording.start_poses import start_poses
from explore_slam.settings import Section, setting

logger = logging.getLogger(__name__)

ROBOTS = range(1, 6)
# Distance (m) = DISTANCE_SCALE · depth + DISTANCE_OFFSET; depth = logged range / cos(bearing).
DISTANCE_SCALE = 0.973
DISTANCE_OFFSET = -0.04
MINIMUM_DISTANCE = 0.05  # m; closer, a code does not fit into the image
RANGE_SIGMA = 0.02  # m
RANGE_SIGMA_PER_METRE = 0.015
BEARING_SIGMA = 0.0125  # rad
HEIGHT_SIGMA = 0.05  # m
TRUTH_PERIOD = 0.04  # s; the motion capture runs at 100 Hz, 25 Hz is enough to interpolate
DESCRIPTOR_SEED = 2011
# Of odometry and camera of these robots. Correlation lengths because the error of a bar code's
# size depends on where it is seen from: `benchmarks/noise_mrclam.py` finds 1.85 m, 2.2 rad, 32 s
# in set 6 and 0.55 m, 0.66 rad, 4 s in set 9. Their mean (1 m) leaves the filter overconfident in
# set 6 (0.78 of the positions inside the 95 % ellipse, 0.82 with these), the longest cost 25 % of
# the accuracy in set 9.
FILTER_SETTINGS: dict[str, float | str] = {
    'forward_variance_per_metre': 0.0025,
    'lateral_variance_per_metre': 0.0005,
    'position_variance_per_radian': 0.0002,
    'heading_variance_per_metre': 0.0015,
    'heading_variance_per_radian': 0.0055,
    'correlation_distance': 1.5,
    'correlation_turn': 1.8,
    'correlation_time': 20.0,
}
# The noise above holds for these robots in motion.
SETTINGS: dict[str, float | str] = FILTER_SETTINGS | {'camera_readout_time': 0.0}
# Delays (s) that are compared, and the most time between two bearings of one landmark that are.
DELAYS = np.arange(0.0, 0.501, 0.01)
BEARING_GAP = 1.0
MINIMUM_BEARINGS = 50  # pairs of bearings below which no delay is estimated


@dataclass(frozen=True)
class _Robot:
    """One robot's tables: odometry (t, v, omega), measurements (t, subject, range, bearing).

    truth (t, x, y, theta) may be empty.
    """

    number: int
    odometry: Array
    measurements: Array
    truth: Array

    @property
    def name(self) -> str:
        return f'robot{self.number}'


@dataclass(frozen=True)
class MrclamOptions(Section):
    """Options of the importer."""

    start: tuple[str, ...] = setting(
        (),
        'Start pose of a robot, VEHICLE=X,Y,THETA (m; rad, or degrees as in 90deg), where its '
        'ground truth is missing, and instead of it; may be repeated',
    )


@importer('mrclam', 'UTIAS MR.CLAM: five robots, bar-coded landmarks', options=MrclamOptions)
def import_mrclam(folder: Path, out: Path, start: Sequence[str] = ()) -> dict[str, int]:
    """Write the data set in the folder as a bag; return the messages per topic.

    Stamps are kept as they are logged: from 1970 in the data set as published, from the start of
    the logs where they were resampled by its scripts. RecordingError for a robot whose start pose
    is neither given nor known from its ground truth.
    """
    kinds = ('Odometry', 'Measurement')
    names = [f'Robot{number}_{kind}.dat' for number in ROBOTS for kind in kinds]
    require(folder, ['Barcodes.dat', *names], 'an MR.CLAM data set')
    subjects = {
        int(code): int(subject) for subject, code in read_table(folder / 'Barcodes.dat', 2)
    }
    robots = [_read_robot(folder, number, subjects) for number in ROBOTS]
    starts = _given_starts(robots, start)
    spans = [
        table[[0, -1], 0]
        for robot in robots
        for table in (robot.odometry, robot.truth)
        if len(table)
    ]
    begin, end = max(first for first, _ in spans), min(last for _, last in spans)
    if begin >= end:
        raise RecordingError(f'{folder}: the logs of the robots do not overlap in time')
    delay = odometry_delay([(robot.odometry, robot.measurements) for robot in robots])
    logger.info('%s: the robots follow the logged odometry %.2f s later', folder, delay)
    streams = [
        stream
        for robot in robots
        for stream in _streams(robot, float(begin), float(end), delay, starts.get(robot.name))
    ]
    return write_bag(out, streams, SETTINGS)


def _given_starts(robots: Sequence[_Robot], texts: Sequence[str]) -> dict[str, Pose2]:
    """Return the start poses given by the user; RecordingError where one is missing."""
    found = {name: pose for name, pose in start_poses(texts).items() if pose is not None}
    names = [robot.name for robot in robots]
    if unknown := sorted(set(found) - set(names)):
        raise RecordingError(f'--start for {unknown}, expected some of {names}')
    missing = [r for r in robots if not len(r.truth) and r.name not in found]
    if missing:
        files = ', '.join(f'Robot{robot.number}_Groundtruth.dat' for robot in missing)
        raise RecordingError(
            f'{files} is missing, from which the start pose is taken: give it as '
            f'--start {missing[0].name}=X,Y,THETA'
        )
    without = [robot.name for robot in robots if not len(robot.truth)]
    if without:
        logger.warning('%s: no ground truth, start pose as given', ', '.join(without))
    return found


def _read_robot(folder: Path, number: int, subjects: dict[int, int]) -> _Robot:
    measurements = read_table(folder / f'Robot{number}_Measurement.dat', 4)
    known = np.array([int(code) in subjects for code in measurements[:, 1]])
    if not known.all():
        codes = sorted({int(code) for code in measurements[~known, 1]})
        logger.warning(
            'Robot%d: %d measurements of unknown bar codes %s omitted',
            number,
            np.count_nonzero(~known),
            codes,
        )
    measurements = measurements[known]
    measurements[:, 1] = [subjects[int(code)] for code in measurements[:, 1]]
    measurements[:, 2] = distances(measurements[:, 2], measurements[:, 3])
    return _Robot(
        number,
        _in_order(read_table(folder / f'Robot{number}_Odometry.dat', 3)),
        measurements[np.argsort(measurements[:, 0], kind='stable')],
        _truth_table(folder / f'Robot{number}_Groundtruth.dat'),
    )


def _truth_table(path: Path) -> Array:
    """Return the true poses (N, 4) with their times; none without the file."""
    return _in_order(read_table(path, 4)) if path.exists() else np.empty((0, 4))


def distances(ranges: Array, bearings: Array) -> Array:
    """Return the distances (N,) m of codes, by their logged ranges (m) and bearings (rad)."""
    depths = ranges / np.cos(bearings)
    return np.maximum(DISTANCE_SCALE * depths + DISTANCE_OFFSET, MINIMUM_DISTANCE)


def _in_order(table: Array) -> Array:
    """Return the rows sorted by time; of rows with the same time the last one is kept."""
    ordered: Array = table[np.argsort(table[:, 0], kind='stable')]
    return np.concatenate([ordered[:-1][np.diff(ordered[:, 0]) > 0.0], ordered[-1:]])


def odometry_delay(robots: Sequence[tuple[Array, Array]]) -> float:
    """Return by how much (s) the robots follow the logged velocities, from 0 to 0.5.

    A landmark that is seen twice within a second turns in view by what the robot has turned
    meanwhile, since it is far away compared to the distance driven. The delay is the one at which
    the turns of the odometry explain most of the variance of the changes of bearing, over all
    robots together; 0 with too few bearings.

    robots: odometry (N, 3) time, forward and angular velocity, and measurements (N, 4) time,
    subject, range and bearing, of each.
    """
    unexplained, count = np.zeros(len(DELAYS)), 0
    for odometry, measurements in robots:
        rows = measurements[measurements[:, 1] > len(ROBOTS)]
        rows = rows[np.lexsort((rows[:, 0], rows[:, 1]))]
        first, second = rows[:-1], rows[1:]
        elapsed = second[:, 0] - first[:, 0]
        pairs = (first[:, 1] == second[:, 1]) & (elapsed > 0.0) & (elapsed < BEARING_GAP)
        if not pairs.any():
            continue
        count += int(np.count_nonzero(pairs))
        first, second = first[pairs], second[pairs]
        turned = -wrap_angles(second[:, 3] - first[:, 3])
        held = odometry[:-1, 2] * np.diff(odometry[:, 0])
        heading = np.concatenate([[0.0], np.cumsum(held)])
        for number, delay in enumerate(DELAYS):
            logged = np.interp(second[:, 0] - delay, odometry[:, 0], heading)
            logged -= np.interp(first[:, 0] - delay, odometry[:, 0], heading)
            square = logged @ logged
            scale = (logged @ turned) / square if square > 0.0 else 0.0
            unexplained[number] += np.sum((turned - scale * logged) ** 2)
    return float(DELAYS[np.argmin(unexplained)]) if count >= MINIMUM_BEARINGS else 0.0


def _streams(
    robot: _Robot, begin: float, end: float, delay: float, given: Pose2 | None
) -> list[Iterator[Event]]:
    start = _pose_at(robot.truth, begin) if given is None else given
    return [
        iter([start_event(robot.name, begin, start)]),
        _odometry(robot, begin, end, delay),
        _measurements(robot, begin, end),
        _truth(robot, begin, end),
    ]


def _pose_at(truth: Array, stamp: float) -> Pose2:
    headings = np.unwrap(truth[:, 3])
    x, y, theta = (np.interp(stamp, truth[:, 0], c) for c in (truth[:, 1], truth[:, 2], headings))
    return Pose2.from_array([x, y, theta])


def integrate_velocities(table: Array, begin: float, end: float) -> tuple[Array, Array]:
    """Return stamps (T,) and poses (T, 3) from the origin at `begin`.

    table: (N, 3) time (s), forward velocity (m/s), angular velocity (rad/s). Velocities are held
    until the next row; the motion between rows is an arc of a circle.
    """
    inside = (table[:, 0] > begin) & (table[:, 0] < end)
    stamps = np.concatenate([[begin], table[inside, 0], [end]])
    held = np.clip(np.searchsorted(table[:, 0], stamps[:-1], 'right') - 1, 0, None)
    step = np.diff(stamps)
    distance, turn = table[held, 1] * step, table[held, 2] * step
    half = 0.5 * turn
    chord = distance * np.sinc(half / np.pi)
    headings = np.concatenate([[0.0], np.cumsum(turn)])
    direction = headings[:-1] + half
    x = np.concatenate([[0.0], np.cumsum(chord * np.cos(direction))])
    y = np.concatenate([[0.0], np.cumsum(chord * np.sin(direction))])
    return stamps, compose(np.column_stack([x, y, headings]), np.zeros(3))


def _odometry(robot: _Robot, begin: float, end: float, delay: float) -> Iterator[Event]:
    moved = robot.odometry + np.array([delay, 0.0, 0.0])
    stamps, poses = integrate_velocities(moved, begin, end)
    for stamp, pose in zip(stamps.tolist(), poses.tolist(), strict=True):
        yield odometry_event(robot.name, stamp, Pose2(*pose))


def _truth(robot: _Robot, begin: float, end: float) -> Iterator[Event]:
    """Yield the truth, thinned to 25 Hz."""
    last = -np.inf
    for stamp, x, y, theta in robot.truth.tolist():
        if begin <= stamp <= end and stamp - last >= TRUTH_PERIOD:
            last = stamp
            yield truth_event(robot.name, stamp, Pose2.from_array([x, y, theta]))


def _measurements(robot: _Robot, begin: float, end: float) -> Iterator[Event]:
    rows = robot.measurements
    rows = rows[(rows[:, 0] >= begin) & (rows[:, 0] <= end)]
    for stamp in np.unique(rows[:, 0]):
        seen = rows[rows[:, 0] == stamp]
        landmarks = seen[seen[:, 1] > len(ROBOTS)]
        if len(landmarks):
            observations = observe(float(stamp), landmarks[:, 1], landmarks[:, 2:])
            yield Event(float(stamp), robot.name, TopicKind.LANDMARKS, observations)
        for subject, distance, bearing in seen[seen[:, 1] <= len(ROBOTS), 1:].tolist():
            if int(subject) != robot.number:
                position, covariance = planar_measurement(distance, bearing)
                observation = InterRobotObservation(
                    float(stamp), f'robot{int(subject)}', position, covariance
                )
                yield Event(float(stamp), robot.name, TopicKind.INTER_ROBOT, observation)


def planar_measurement(distance: float, bearing: float) -> tuple[Array, Array]:
    """Return position (2,) m and covariance (2, 2) m² in the robot frame."""
    c, s = np.cos(bearing), np.sin(bearing)
    rotation = np.array([[c, -s], [s, c]])
    along = RANGE_SIGMA + RANGE_SIGMA_PER_METRE * distance
    spread = np.diag([along**2, (distance * BEARING_SIGMA) ** 2])
    return distance * rotation[:, 0], rotation @ spread @ rotation.T


def observe(stamp: float, subjects: Array, measurements: Array) -> LandmarkObservations:
    """Return observations of landmarks.

    subjects: (K,) numbers of the landmarks.
    measurements: (K, 2) range (m) and bearing (rad).
    """
    count = len(subjects)
    positions, covariances = np.zeros((count, 3)), np.zeros((count, 3, 3))
    covariances[:, 2, 2] = HEIGHT_SIGMA**2
    for row, (distance, bearing) in enumerate(measurements.tolist()):
        positions[row, :2], covariances[row, :2, :2] = planar_measurement(distance, bearing)
    descriptors = np.empty((count, DESCRIPTOR_LENGTH), np.float32)
    for row, subject in enumerate(subjects.tolist()):
        descriptors[row] = landmark_descriptor(int(subject))
    return LandmarkObservations(stamp, positions, covariances, descriptors)


def landmark_descriptor(subject: int) -> np.ndarray[tuple[int], np.dtype[np.float32]]:
    """Return the descriptor (128,) of a bar-coded landmark: a fixed random unit vector."""
    values = np.random.default_rng([DESCRIPTOR_SEED, subject]).normal(size=DESCRIPTOR_LENGTH)
    return np.asarray(values / np.linalg.norm(values), dtype=np.float32)
