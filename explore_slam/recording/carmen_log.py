"""Reading of CARMEN logs: wheel odometry, laser scans and, in corrected logs, reference poses.

The format is that of the Carnegie Mellon navigation toolkit, one message per line:

ODOM x y theta tv rv accel TIME
FLASER n r1 .. rn laser_x laser_y laser_theta odom_x odom_y odom_theta TIME    (RLASER: rear laser)
ROBOTLASER1 type start fov step max_range accuracy remission_mode n r1 .. rn m e1 .. em
    laser_x laser_y laser_theta robot_x robot_y robot_theta tv rv forward side turn_axis TIME
PARAM name value

where TIME is: time host logger_time. In a raw log all poses come from wheel odometry. In a
corrected log the pose of a scan is the result of a SLAM program, and the odometry restarts at that
pose in the line after the scan; the wheel odometry is rebuilt from the increments between such
restarts.

The order of the lines is the order of events: in thinned logs single stamps are out of order by up
to a second, although the motion is smooth from line to line.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import LaserScan
from explore_slam.errors import RecordingError
from explore_slam.geometry import IDENTITY, Array, Pose2, between
from explore_slam.recording.carmen_stamps import NAMED_LINES, regular_stamps
from explore_slam.recording.storage.compression import FORMAT_OF_MAGIC, decompress
from explore_slam.recording.storage.file_kinds import check_not_lfs_pointer

# Chosen by hand, for the logs of several recorders; test_carmen_log shows what they decide.
DEFAULT_RANGE_MAX = 80.0  # m; what the SICK drivers of CARMEN write where nothing returned
RANGE_MIN = 0.02  # m; nearer readings are no returns
RESTART_FRACTION = 0.9  # of the scans must be followed by a restart in a corrected log
SAME_POSE = 1e-6  # m, rad: a restart repeats the digits of the scan's pose
MOUNT_SPREAD = 0.01  # m, rad: between scans; larger differences are no mount

LONGEST_NAME = 40  # characters of a message's name; longer ones are none
_IGNORED = {
    'PARAM',
    'SYNC',
    'NEFF',
}  # parameters are read apart; SYNC and NEFF hold no measurement
_FRONT = {'FLASER', 'ROBOTLASER1'}
_REAR = {'RLASER', 'ROBOTLASER2'}


class LaserLine(NamedTuple):
    """One scan as its line states it; poses in the frame of the log's odometry or map.

    fov_start, step: angle of the first beam and between beams (rad, laser frame).
    """

    line: int
    ranges: NDArray[np.float32]
    fov_start: float
    step: float
    range_max: float
    laser: Pose2
    robot: Pose2
    time: float

    def record(self, stamp: float) -> LaserScan:
        """Return the scan at a stamp (s); a reading at or above the maximum is no return."""
        ranges = np.where(self.ranges >= self.range_max, np.float32(np.inf), self.ranges)
        return LaserScan(stamp, self.fov_start, self.step, ranges, RANGE_MIN, self.range_max)


class OdometryLine(NamedTuple):
    """One reading of the wheel odometry as its line states it."""

    line: int
    robot: Pose2
    time: float


@dataclass(frozen=True)
class CarmenLog:
    """One vehicle's log; row i of odometry, stamps, times and lines belong together.

    odometry: (N, 3) poses of the vehicle by wheel odometry, without restarts.
    stamps: (N,) s, increasing; times: (N,) s as written, where usable, else NaN.
    rows: (S,) the row at which each scan was taken.
    reference: (S, 3) poses of the laser that the log itself states, None in raw logs.
    mount: pose of the laser in the vehicle frame.
    """

    path: Path
    odometry: Array
    stamps: Array
    times: Array
    rows: NDArray[np.int64]
    scans: tuple[LaserLine, ...]
    reference: Array | None
    mount: Pose2
    notes: tuple[str, ...]

    @property
    def corrected(self) -> bool:
        """Return whether the log holds reference poses."""
        return self.reference is not None


class _Problems:
    """Lines that cannot be used, by reason; a note names the first of each."""

    def __init__(self) -> None:
        self._lines: dict[str, list[int]] = {}

    def add(self, reason: str, line: int) -> None:
        self._lines.setdefault(reason, []).append(line)

    def notes(self) -> Iterator[str]:
        for reason, lines in self._lines.items():
            named = ', '.join(map(str, lines[:NAMED_LINES]))
            more = f' and {len(lines) - NAMED_LINES} more' if len(lines) > NAMED_LINES else ''
            yield f'line{"s" if len(lines) > 1 else ""} {named}{more}: {reason}'


class _MalformedLineError(ValueError):
    """A line that cannot be read; the text is the reason."""


class _Words:
    """The words of a line, taken one after the other as numbers."""

    def __init__(self, words: list[str]) -> None:
        self._words = words
        self._at = 1
        self.kind = words[0]

    def numbers(self, count: int) -> list[float]:
        """Take so many finite numbers."""
        taken = self._words[self._at : self._at + count]
        if len(taken) < count:
            raise _MalformedLineError(f'{self.kind} is cut short: left out')
        try:
            values = [float(word) for word in taken]
        except ValueError:
            raise _MalformedLineError(
                f'{self.kind} holds a word that is not a number: left out'
            ) from None
        self._at += count
        if not all(map(math.isfinite, values)):
            raise _MalformedLineError(f'{self.kind} holds a number that is not finite: left out')
        return values

    def count(self) -> int:
        """Take a number of readings."""
        (value,) = self.numbers(1)
        if value < 0 or value != int(value):
            raise _MalformedLineError(f'{self.kind} states {value:g} readings: left out')
        return int(value)

    def pose(self) -> Pose2:
        return Pose2.from_array(self.numbers(3))

    def time(self) -> float:
        """Take the time; host name and logger time follow it."""
        if len(self._words) - self._at != 3:
            raise _MalformedLineError(f'{self.kind} is cut short or too long: left out')
        (value,) = self.numbers(1)
        return value


def _odometry_line(line: int, words: _Words) -> OdometryLine:
    pose = words.pose()
    words.numbers(3)
    return OdometryLine(line, pose, words.time())


def _readings(words: _Words) -> NDArray[np.float32]:
    count = words.count()
    if count < 2:
        raise _MalformedLineError(f'{words.kind} has {count} readings: left out')
    return np.array(words.numbers(count), np.float32)


def _laser_line(line: int, words: _Words, range_max: float) -> LaserLine:
    """Read FLASER or RLASER: from -90 degrees on; 180 beams are 1.000, 360 are 0.500 deg apart."""
    ranges = _readings(words)
    laser, robot = words.pose(), words.pose()
    step = beam_step(len(ranges))
    return LaserLine(line, ranges, -math.pi / 2, step, range_max, laser, robot, words.time())


def beam_step(beams: int) -> float:
    """Return the angle (rad) between the beams of a SICK over 180 degrees.

    It is a round number of degrees: a logger of 180 beams left out the last of 181.
    """
    return math.pi / (beams - beams % 2)


def _robot_laser_line(line: int, words: _Words) -> LaserLine:
    """Read ROBOTLASER1 or ROBOTLASER2, which state their own angles and range."""
    _, start, _, step, range_max, _, _ = words.numbers(7)
    ranges = _readings(words)
    words.numbers(words.count())  # remission
    laser, robot = words.pose(), words.pose()
    words.numbers(5)
    if step == 0.0 or range_max <= RANGE_MIN:
        raise _MalformedLineError(
            f'{words.kind} states step {step:g}, range {range_max:g}: left out'
        )
    return LaserLine(line, ranges, start, step, range_max, laser, robot, words.time())


@dataclass
class _Content:
    """What the lines of a log hold, in their order."""

    entries: list[OdometryLine | LaserLine]
    parameters: dict[str, str]
    rear: bool
    has_neff: bool
    problems: _Problems


def _read_lines(path: Path) -> _Content:
    check_not_lfs_pointer(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise RecordingError(f'{path} cannot be read: {error}') from error
    for magic, compression in FORMAT_OF_MAGIC.items():
        if data.startswith(magic):
            data, _ = decompress(data, compression)
    text = data.decode('utf-8', 'replace')
    lines = [(number, line.split()) for number, line in enumerate(text.splitlines(), start=1)]
    lines = [(number, words) for number, words in lines if words and words[0][0] != '#']
    kinds = [words[0] for _, words in lines]
    rear = not _FRONT & set(kinds)
    # loggers write a scan of ROBOTLASER1 as FLASER too, without its angles
    repeated = {'FLASER'} if 'ROBOTLASER1' in kinds else set()
    repeated |= {'RLASER'} if rear and 'ROBOTLASER2' in kinds else set()
    problems = _Problems()
    content = _Content([], {}, rear, 'NEFF' in kinds, problems)
    range_max = DEFAULT_RANGE_MAX
    for number, words in lines:
        kind = words[0]
        if kind == 'PARAM' and len(words) >= 3:
            content.parameters[words[1]] = words[2]
            range_max = _range_max(content.parameters, rear)
        if kind in _IGNORED or kind in repeated:
            continue
        try:
            entry = _entry(number, words, rear, range_max)
        except _MalformedLineError as reason:
            problems.add(str(reason), number)
            continue
        if entry is None:
            problems.add(f'{_what(kind)}: not used', number)
        else:
            content.entries.append(entry)
    return content


def _what(kind: str) -> str:
    """Name a line that holds neither odometry nor a scan of the laser in use."""
    if kind in _REAR:
        return f'a second laser {kind}'
    is_name = len(kind) <= LONGEST_NAME and kind.isascii() and kind.isidentifier()
    return f'unknown message {kind}' if is_name else 'no message'


def _range_max(parameters: dict[str, str], rear: bool) -> float:
    """Return from what reading on there is no return: 80 m, or less where the log says so."""
    try:
        stated = float(parameters[f'robot_{"rear" if rear else "front"}_laser_max'])
    except (KeyError, ValueError):
        return DEFAULT_RANGE_MAX
    return stated if RANGE_MIN < stated < DEFAULT_RANGE_MAX else DEFAULT_RANGE_MAX


def _entry(
    line: int, words: list[str], rear: bool, range_max: float
) -> OdometryLine | LaserLine | None:
    kind, numbers = words[0], _Words(words)
    if kind == 'ODOM':
        return _odometry_line(line, numbers)
    if kind not in (_REAR if rear else _FRONT):
        return None
    if kind in ('FLASER', 'RLASER'):
        return _laser_line(line, numbers, range_max)
    return _robot_laser_line(line, numbers)


def read_carmen(path: Path) -> CarmenLog:
    """Read a log; lines that cannot be used are named in the notes, the rest is read.

    RecordingError where it cannot be read at all or holds no scans.
    """
    content = _read_lines(path)
    entries = content.entries
    scans = tuple(entry for entry in entries if isinstance(entry, LaserLine))
    if not scans:
        raise RecordingError(
            f'{path} holds no scans: expected lines FLASER, RLASER or ROBOTLASER1; '
            + ('; '.join(content.problems.notes()) or 'it contains no CARMEN messages')
        )
    corrected = _is_corrected(entries, content.has_neff)
    odometry, rows, kept = _wheel_odometry(entries, corrected)
    lines = np.array([entry.line for entry in kept])
    times = np.array([entry.time for entry in kept])
    timing = regular_stamps(times, odometry, lines)
    mount, mount_notes = _mount(scans, content.parameters, content.rear)
    notes = [
        'corrected log: odometry restarts at the pose of each scan, which is kept as reference'
        if corrected
        else 'raw log: all poses are wheel odometry',
        *mount_notes,
        *timing.notes,
        *content.problems.notes(),
    ]
    if corrected and (idle := _scans_without_odometry(odometry, rows, scans)):
        notes.append(f'{idle} of {len(scans)} scans have no odometry since the scan before them')
    reference = np.array([scan.laser for scan in scans]) if corrected else None
    return CarmenLog(
        path,
        odometry,
        timing.stamps,
        timing.times,
        rows,
        scans,
        reference,
        mount,
        tuple(f'{path.name}: {note}' for note in notes),
    )


def _is_same(a: Pose2, b: Pose2) -> bool:
    return max(abs(x) for x in a.between(b)) <= SAME_POSE


def _is_corrected(entries: list[OdometryLine | LaserLine], has_neff: bool) -> bool:
    """Return whether odometry restarts at the pose of the scans.

    A restart repeats the pose of the scan before it. So does a robot at rest, and a logger that
    writes the odometry after the scan; there the pose is the one that odometry led to. GMapping
    marks its logs with NEFF.
    """
    pairs = list(itertools.pairwise(entries))
    after = [
        (scan, reading)
        for scan, reading in pairs
        if isinstance(scan, LaserLine) and isinstance(reading, OdometryLine)
    ]
    restarts = sum(_is_same(scan.robot, reading.robot) for scan, reading in after)
    if not after or restarts < RESTART_FRACTION * len(after):
        return False
    if has_neff or 2 * sum(reading.time < scan.time for scan, reading in after) > len(after):
        return True  # a restart was written by a program: its time is none
    # the last reading before the scan has the time of the scan but another pose
    before = [
        _is_same(scan.robot, reading.robot)
        for reading, scan in pairs
        if isinstance(scan, LaserLine)
        and isinstance(reading, OdometryLine)
        and reading.time == scan.time
    ]
    return bool(before) and 2 * sum(before) < len(before)


def _wheel_odometry(
    entries: list[OdometryLine | LaserLine], corrected: bool
) -> tuple[Array, NDArray[np.int64], list[OdometryLine | LaserLine]]:
    """Return poses (N, 3), the row of each scan, and the entry of each row.

    Every scan has a row of its own; in a corrected log it repeats the pose of the reading before.
    """
    poses: list[Pose2] = []
    rows: list[int] = []
    kept: list[OdometryLine | LaserLine] = []
    last: Pose2 | None = None
    restart = False
    for entry in entries:
        is_scan = isinstance(entry, LaserLine)
        if last is None:
            last = entry.robot if not (corrected and is_scan) else IDENTITY
            pose = last
        elif corrected and is_scan:
            pose = poses[-1]
        elif corrected and restart:
            last, restart = entry.robot, False
            continue
        else:
            pose = poses[-1].compose(last.between(entry.robot)) if corrected else entry.robot
        last = entry.robot
        if is_scan:
            rows.append(len(poses))
            restart = corrected
        poses.append(pose)
        kept.append(entry)
    return np.array(poses), np.array(rows, np.int64), kept


def _scans_without_odometry(
    odometry: Array, rows: NDArray[np.int64], scans: tuple[LaserLine, ...]
) -> int:
    """Count the scans whose pose changed although the odometry since the last one did not."""
    moved = between(odometry[rows[:-1]], odometry[rows[1:]])
    poses = np.array([scan.robot for scan in scans])
    corrected = between(poses[:-1], poses[1:])
    still = np.abs(moved).max(axis=1) <= SAME_POSE
    return int(np.count_nonzero(still & (np.abs(corrected).max(axis=1) > SAME_POSE)))


def _mount(
    scans: tuple[LaserLine, ...], parameters: dict[str, str], rear: bool
) -> tuple[Pose2, list[str]]:
    """Return the pose of the laser on the vehicle: from the two poses of each scan, or PARAM."""
    offsets = between(
        np.array([scan.robot for scan in scans]), np.array([scan.laser for scan in scans])
    )
    middle = np.median(offsets, axis=0)
    spread = float(np.abs(between(middle, offsets)).max())
    name = f'robot_{"rear" if rear else "front"}laser_offset'
    try:
        stated = float(parameters[name])
    except (KeyError, ValueError):
        stated = None
    if spread <= MOUNT_SPREAD:
        mount = Pose2.from_array(np.where(np.abs(middle) <= SAME_POSE, 0.0, middle))
        if stated is not None and abs(stated - mount.x) > MOUNT_SPREAD:
            text = f'the lines put the laser {mount.x:.3f} m ahead, {name} {stated:.3f} m'
            return mount, [f'{text}: that of the lines is used']
        return mount, []
    mount = Pose2(stated or 0.0, 0.0, math.pi if rear else 0.0)
    return mount, [
        f'the offset of the laser varies by {spread:.2f} from scan to scan: '
        f'it is taken to be {mount.x:.3f} m ahead of the vehicle origin'
    ]
