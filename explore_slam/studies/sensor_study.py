"""How accurate pose and map are with sensors as people have them: the cases of the sensor rig.

A case is a row of the table. Further sensors are further cases.
"""

import heapq
import itertools
import math
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from explore_slam.agent import Agent, AgentConfig, warm_up
from explore_slam.agent.odometry_sources import SOURCES as ODOMETRY
from explore_slam.data import ImuReading, LaserScan, OdometryReading
from explore_slam.errors import EvaluationError
from explore_slam.geometry import Array, Pose2, quaternion_from_yaw, wrap_angle
from explore_slam.mapping import OccupancyGrid
from explore_slam.messages.base import transform_message
from explore_slam.messages.clouds import cloud_message
from explore_slam.messages.frames import FrameNames
from explore_slam.messages.scans import scan_message
from explore_slam.messages.topics import GlobalTopic, TopicKind, topic_name
from explore_slam.recording import BagReader, Replay
from explore_slam.recording.bag import BagWriter
from explore_slam.recording.events import Event, write_event
from explore_slam.recording.rosbags_types import MESSAGES
from explore_slam.results import tables
from explore_slam.settings import with_values
from explore_slam.simulation.worlds.walls import distances_from
from explore_slam.studies.figures import new_figure
from explore_slam.studies.parallel import ALONE, Workers, make_runs
from explore_slam.studies.sensor_rig import (
    FLOOR,
    START,
    Drive,
    Laser,
    gyroscope,
    in_order_of_arrival,
    odometry,
    scans,
)

VEHICLE = 'robot1'
FRONT, REAR = Pose2(0.25, 0.0, 0.0), Pose2(-0.25, 0.0, math.pi)  # two lasers on a vehicle
LASER_HEIGHT, CEILING = 0.5, 2.6  # m above the floor
RINGS = np.radians(np.arange(-15.0, 16.0, 2.0))  # elevations of a VLP-16
# s; time_increment of the TurtleBot3's LDS-01 at 5.5 Hz, as in a recording of its driver. A turn
# of 360 beams takes one interval between scans in truth.
LDS_INCREMENT = 2.98899994959e-05
OFF_WALL = 0.10  # m; occupied cells whose centre is farther from the true walls are wrong
SOURCES = ('live', 'bag', 'topic', 'cloud')


@dataclass(frozen=True)
class Case:
    """One row of the table.

    turn_rate: rad/s on the spot. odometry_turn, odometry_distance: what the wheels measure of a
    turn and of a distance of 1.
    odometry: what the agent takes the odometry from; there are no wheels with scan, and there is
    an IMU with wheels+gyro.
    source: live, records in the order of arrival; bag, the messages of a bag through its replay;
    topic, likewise with all lasers on the topic scan, told apart by header.frame_id; cloud,
    likewise with the laser as a 3-D lidar, whose clouds hold the floor and the ceiling, too.
    """

    title: str
    lasers: tuple[Laser, ...] = (Laser(),)
    turn_rate: float = 0.9
    odometry_turn: float = 1.05
    odometry_distance: float = 1.0
    odometry: str = 'wheels'
    source: str = 'live'

    def __post_init__(self) -> None:
        if self.source not in SOURCES:
            raise EvaluationError(f'source is {self.source!r}, expected one of {SOURCES}')
        if self.odometry not in ODOMETRY:
            raise EvaluationError(f'odometry is {self.odometry!r}, expected one of {ODOMETRY}')


def _sweep_cases() -> Iterator[Case]:
    """Yield the cases of motion within a sweep."""
    for rate in (5.5, 10.0):
        yield Case(f'one moment, {rate:g} Hz', (Laser(rate, spinning=False),))
    for rate, turn_rate, backward, last, stated in itertools.product(
        (5.5, 10.0), (0.9, 0.45), (False, True), (False, True), (True, False)
    ):
        direction, stamp = 'backward' if backward else 'forward', 'last' if last else 'first'
        title = (
            f'spinning, {rate:g} Hz, {turn_rate:g} rad/s, {direction}, {stamp} beam, '
            f'{"stated" if stated else "not stated"}'
        )
        laser = Laser(rate, backward=backward, last=last, stated=stated)
        yield Case(title, (laser,), turn_rate)
    for rate, stated in itertools.product((5.5, 10.0), (True, False)):
        title = f'spinning, {rate:g} Hz, {"stated" if stated else "not stated"}, from a bag'
        yield Case(title, (Laser(rate, stated=stated),), source='bag')
    yield Case('spinning, 5.5 Hz, exact wheels', odometry_turn=1.0)
    for turn_rate in (0.9, 0.45):
        title = f'spinning, 5.5 Hz, {turn_rate:g} rad/s, increment of the LDS-01 driver'
        yield Case(title, (Laser(stated=False, wrong_increment=LDS_INCREMENT),), turn_rate)


def _laser_cases() -> Iterator[Case]:
    """Yield the cases of several lasers on one vehicle."""
    for rate, turn_rate in itertools.product((5.5, 10.0), (0.9, 0.45)):
        title = f'two lasers of 180°, {rate:g} Hz, {turn_rate:g} rad/s'
        yield Case(title, _laser_pair(rate), turn_rate)
    yield Case('two lasers of 180°, 10 Hz, from a bag', _laser_pair(10.0), source='bag')
    yield Case('two lasers of 180°, 10 Hz, on one topic', _laser_pair(10.0), source='topic')
    yield Case('two lasers of 180°, beams one by one, 10 Hz', _laser_pair(10.0, spinning=True))
    lidar = Laser(10.0, name='points')
    yield Case('3-D lidar, beams one by one, 10 Hz', (lidar,), source='cloud')
    front, rear = _laser_pair(10.0)
    yield Case('two lasers of 180°, 10 and 7 Hz', (front, replace(rear, rate=7.0)))
    yield Case('the laser ahead alone, 10 Hz', (replace(front, name=''),))


def _laser_pair(rate: float, *, spinning: bool = False) -> tuple[Laser, ...]:
    """Return two lasers of 180°, one ahead and one behind."""
    return tuple(
        Laser(rate, spinning, name=name, mount=mount, half=True)
        for name, mount in (('front/scan', FRONT), ('rear/scan', REAR))
    )


def _odometry_cases() -> Iterator[Case]:
    """Yield the cases of poor odometry, or none."""
    for factor in (0.7, 1.2, 1.4):
        yield Case(f'wheels turn {factor:g} x', odometry_turn=factor)
    for factor in (0.7, 0.85, 1.0, 1.2, 1.4):
        title = f'wheels turn {factor:g} x, and a gyroscope'
        yield Case(title, odometry_turn=factor, odometry='wheels+gyro')
    title = 'wheels turn 1.4 x, and a gyroscope, from a bag'
    yield Case(title, odometry_turn=1.4, odometry='wheels+gyro', source='bag')
    yield Case('wheels never report motion', odometry_turn=0.0, odometry_distance=0.0)
    for rate, turn_rate in itertools.product((5.5, 10.0), (0.9, 0.45)):
        title = f'no wheels, {rate:g} Hz, {turn_rate:g} rad/s'
        yield Case(title, (Laser(rate),), turn_rate, odometry='scan')
    yield Case('no wheels, 10 Hz, from a bag', (Laser(10.0),), odometry='scan', source='bag')
    yield Case('no wheels, two lasers, 10 Hz', _laser_pair(10.0), odometry='scan')
    yield Case('no wheels, all beams at once, 5.5 Hz', (Laser(spinning=False),), odometry='scan')
    yield Case('no wheels, 10 Hz, not stated', (Laser(10.0, stated=False),), odometry='scan')


CASES: dict[str, tuple[Case, ...]] = {
    'sweeps': tuple(_sweep_cases()),
    'lasers': tuple(_laser_cases()),
    'odometry': tuple(_odometry_cases()),
}


class CaseRun(NamedTuple):
    """Figures of one run.

    position_rms (m) and heading_rms (rad): of the estimates after every scan, against the truth.
    wrong_cells: share of the occupied cells that are more than OFF_WALL from the true walls.
    occupied: number of these cells. matched, unmatched: scans. scan_ms: the agent's time per scan
    (ms).
    """

    title: str
    seed: int
    position_rms: float
    heading_rms: float
    wrong_cells: float
    occupied: int
    matched: int
    unmatched: int
    scan_ms: float
    named: str = ''


@dataclass(frozen=True)
class SensorStudy:
    """Definition of a study: groups of cases, parts of titles (all cases if empty), settings."""

    seeds: Sequence[int] = tuple(range(5))
    groups: Sequence[str] = tuple(CASES)
    titles: Sequence[str] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        unknown = sorted(set(self.groups) - CASES.keys())
        if unknown:
            raise EvaluationError(f'sensor study: groups {unknown}, expected some of {[*CASES]}')
        if not self.cases():
            raise EvaluationError(
                f'sensor study: no title of a case contains {" or ".join(self.titles)!r}'
            )
        self.config()

    def cases(self) -> list[Case]:
        """Return the cases in the order of the table."""
        found = [case for group in self.groups for case in CASES[group]]
        return [
            case
            for case in found
            if not self.titles or any(part in case.title for part in self.titles)
        ]

    def config(self) -> AgentConfig:
        """Return the settings of the agent; ConfigError for a wrong one."""
        return with_values(AgentConfig(), dict(self.settings))


class _Watch:
    """Passes records to an agent and notes its estimates after every scan."""

    def __init__(self, agent: Agent) -> None:
        self.agent = agent
        self.seconds = 0.0
        self.rows: list[tuple[float, float, float, float]] = []
        self.scans = 0

    def add(self, vehicle: str, record: Any) -> None:
        """Add a record of a vehicle."""
        began = time.perf_counter()
        self.agent.add(vehicle, record)
        self.seconds += time.perf_counter() - began
        if isinstance(record, LaserScan):
            self.scans += 1
        else:
            return
        track = self.agent.track(vehicle)
        if len(track.odometry):
            self.rows.append((track.odometry.last, *self.agent.map_pose(vehicle)))

    def advance(self, stamp: float) -> None:
        """Set the time (s)."""
        self.agent.advance(stamp)

    def set_pose(self, vehicle: str, pose: Pose2, covariance: Array) -> None:
        """Set the pose of a vehicle in the map."""
        self.agent.set_pose(vehicle, pose, covariance)


def run_case(case: Case, seed: int, config: AgentConfig) -> tuple[CaseRun, OccupancyGrid]:
    """Drive the tour of a seed; return the figures and the map."""
    warm_up()
    random = np.random.default_rng(seed)
    drive = Drive(case.turn_rate)
    wheels = odometry(drive, case.odometry_turn, random, case.odometry_distance)
    sweeps = [scans(drive, laser, random) for laser in case.lasers]
    readings: list[OdometryReading | ImuReading] = []
    if case.odometry != 'scan':
        readings += wheels
    if case.odometry == 'wheels+gyro':
        readings = sorted([*readings, *gyroscope(drive, random)], key=lambda item: item.stamp)
    watch = _Watch(Agent(config, {VEHICLE: START}, seed, sources={VEHICLE: case.odometry}))
    if case.source == 'live':
        for record in in_order_of_arrival(readings, sweeps, case.lasers):
            watch.add(VEHICLE, record)
    else:
        _replay(watch, readings, sweeps, case)
    table = np.array(watch.rows)
    off = table[:, 1:] - drive.at(table[:, 0])
    turn = [wrap_angle(value) for value in off[:, 2]]
    grid = watch.agent.grid
    occupied = np.argwhere(grid.to_trinary() == 100)
    far = distances_from(FLOOR, grid.to_point(occupied)) > OFF_WALL
    counts = watch.agent.summary()[VEHICLE]
    run = CaseRun(
        case.title,
        seed,
        float(np.sqrt((off[:, :2] ** 2).sum(axis=1).mean())),
        float(np.sqrt(np.mean(np.square(turn)))),
        float(far.mean()) if len(far) else math.nan,
        len(occupied),
        counts.get('matched_scans', 0),
        counts.get('unmatched_scans', 0),
        1e3 * watch.seconds / max(watch.scans, 1),
        str(watch.agent.odometry_sources()[VEHICLE].get('problem', '')),
    )
    return run, grid


def _replay(
    watch: _Watch,
    readings: Sequence[OdometryReading | ImuReading],
    sweeps: Sequence[Sequence[LaserScan]],
    case: Case,
) -> None:
    """Write the records as a bag, with the mounts of the lasers, and feed its replay."""
    with tempfile.TemporaryDirectory(prefix='explore_slam_') as folder:
        path = Path(folder) / 'bag'
        with BagWriter(path) as writer:
            _write_mounts(writer, case.lasers)
            streams: list[Iterable[Event]] = [
                (Event(item.stamp, VEHICLE, _topic_of(item), item) for item in readings),
                *((Event(i.stamp, VEHICLE, TopicKind.SCAN, i) for i in scans) for scans in sweeps),
            ]
            for event in heapq.merge(*streams, key=lambda event: event.stamp):
                if case.source == 'topic' and isinstance(event.record, LaserScan):
                    _write_on_one_topic(writer, event.record)
                elif case.source == 'cloud' and isinstance(event.record, LaserScan):
                    _write_cloud(writer, event.record)
                else:
                    write_event(writer, event)
        timing = case.lasers[0].timing
        settings: dict[str, Any] = {
            'sweep_direction': timing.direction,
            'sweep_stamp': timing.stamp,
            'odometry': case.odometry,
        }
        if case.source == 'bag' and len(case.lasers) > 1:
            settings['scans'] = [laser.name for laser in case.lasers]
        if case.source == 'cloud':
            settings |= {'scans': [''], 'clouds': [laser.name for laser in case.lasers]}
        with BagReader(path) as bag:
            Replay(bag, starts={VEHICLE: START}, settings=settings).feed(watch)


def _topic_of(reading: OdometryReading | ImuReading) -> TopicKind:
    return TopicKind.IMU if isinstance(reading, ImuReading) else TopicKind.ODOMETRY


def _write_mounts(writer: BagWriter, lasers: Iterable[Laser]) -> None:
    """Write the mounts of lasers as /tf_static."""
    frames, topic = FrameNames(VEHICLE), GlobalTopic.TF_STATIC
    transforms = [
        transform_message(
            MESSAGES,
            0.0,
            frames.base,
            frames.laser_frame(laser.name),
            (laser.mount.x, laser.mount.y, LASER_HEIGHT),
            quaternion_from_yaw(laser.mount.theta),
        )
        for laser in lasers
    ]
    writer.add_topic(topic.value, topic.message_type, latched=True)
    message = MESSAGES.make(topic.message_type, transforms=transforms)
    writer.write_message(topic.value, topic.message_type, 0.0, message)


def _write_on_one_topic(writer: BagWriter, scan: LaserScan) -> None:
    """Write the scan of any laser on the topic `scan`, with the frame of its laser."""
    frame = FrameNames(VEHICLE).laser_frame(scan.sensor)
    writer.write_message(
        topic_name(VEHICLE, TopicKind.SCAN),
        TopicKind.SCAN.message_type,
        scan.stamp,
        scan_message(MESSAGES, scan, frame),
    )


def _write_cloud(writer: BagWriter, scan: LaserScan) -> None:
    """Write a scan as the cloud of a 3-D lidar in a room with floor, walls and ceiling.

    All rings of a bearing are measured at once. A ring that meets floor or ceiling before the wall
    ends there.
    """
    walls = np.repeat(scan.ranges.astype(np.float64), len(RINGS))
    bearings = np.repeat(scan.angles, len(RINGS))
    slopes = np.tile(np.tan(RINGS), scan.ranges.size)
    level = np.where(slopes < 0.0, -LASER_HEIGHT, CEILING - LASER_HEIGHT)
    reach = np.minimum(walls, level / slopes)
    seen = np.isfinite(reach)
    reach, bearings, slopes = reach[seen], bearings[seen], slopes[seen]
    times = np.repeat(scan.time_increment * np.arange(scan.ranges.size), len(RINGS))[seen]
    columns = [
        ('x', reach * np.cos(bearings)), ('y', reach * np.sin(bearings)), ('z', reach * slopes),
        ('time', times),
    ]  # fmt: skip
    frame = FrameNames(VEHICLE).laser_frame(scan.sensor)
    writer.write_message(
        topic_name(VEHICLE, TopicKind.CLOUD, scan.sensor),
        TopicKind.CLOUD.message_type,
        scan.stamp,
        cloud_message(MESSAGES, scan.stamp, frame, columns),
    )


def run_study(
    study: SensorStudy, output: Path | None = None, workers: Workers = ALONE
) -> Iterator[CaseRun]:
    """Yield the run of every case and seed, in order; sensors.json grows with them.

    output: folder for sensors.json and a picture of the map of the first seed of every case.
    """
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
    runs: list[CaseRun] = []
    cases = [(case, seed) for case in study.cases() for seed in study.seeds]
    tasks = [(case, seed, study.config()) for case, seed in cases]
    done = make_runs(run_case, tasks, workers)
    for index, ((case, seed), (run, grid)) in enumerate(zip(cases, done, strict=True)):
        runs.append(run)
        if output is not None:
            save_runs(study, runs, output)
            if seed == study.seeds[0]:
                number = index // len(study.seeds)
                plot_map(grid, case.title, output / f'{number:02d}.png')
        yield run


HEADER = (
    'case', 'position RMS (m)', 'heading RMS (°)', 'cells off the walls', 'scans unmatched',
    'ms per scan',
)  # fmt: skip


def markdown_table(runs: Sequence[CaseRun]) -> str:
    """Return the table of a study: per case the range of its seeds."""
    rows = []
    for title, group in itertools.groupby(runs, key=lambda run: run.title):
        own = list(group)
        scanned = sum(run.matched + run.unmatched for run in own)
        rows.append(
            (
                title,
                _span([run.position_rms for run in own], '.3f'),
                _span([math.degrees(run.heading_rms) for run in own], '.2f'),
                _span([100.0 * run.wrong_cells for run in own], '.1f') + ' %',
                f'{sum(run.unmatched for run in own)} of {scanned}',
                _span([run.scan_ms for run in own], '.1f'),
            )
        )
    return tables.markdown_table(HEADER, rows) + '\n'


def _span(values: Sequence[float], form: str) -> str:
    low, high = format(min(values), form), format(max(values), form)
    return low if low == high else f'{low}–{high}'


def save_runs(study: SensorStudy, runs: Sequence[CaseRun], folder: Path) -> Path:
    """Write sensors.json into a folder; return its path. A figure that is not finite is null."""
    content = {
        'settings': dict(study.settings),
        'seeds': list(study.seeds),
        'runs': [run._asdict() for run in runs],
    }
    path = folder / 'sensors.json'
    tables.write_json(path, content)
    return path


def plot_map(grid: OccupancyGrid, title: str, path: Path) -> None:
    """Draw the map of a run, with the true walls over it."""
    figure, axes = new_figure(width=7.0, height=4.8)
    axis = axes[0, 0]
    (x, y), (rows, cols) = grid.origin, grid.shape
    extent = (x, x + cols * grid.resolution, y, y + rows * grid.resolution)
    axis.imshow(
        np.where(grid.known(), 1.0 - grid.probability(), 0.6),
        extent=extent, origin='lower', cmap='gray', vmin=0.0, vmax=1.0,
    )  # fmt: skip
    for x0, y0, x1, y1 in FLOOR:
        axis.plot((x0, x1), (y0, y1), color='#c0392b', linewidth=0.6)
    axis.set(title=title, xlabel='x (m)', ylabel='y (m)', aspect='equal')
    axis.grid(visible=False)
    figure.savefig(path, dpi=110)
