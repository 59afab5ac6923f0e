"""Accuracy of maps from laser logs: import, replay with default settings, errors over relations.

A log is a CARMEN file or a bag. It may be cut into two vehicles that drive at the same time.
"""

import json
import multiprocessing
import resource
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from explore_slam.agent import Agent, warm_up
from explore_slam.data import OdometryReading
from explore_slam.errors import EvaluationError
from explore_slam.files import write_text
from explore_slam.geometry import Array, Pose2, compose
from explore_slam.messages.topics import TopicKind
from explore_slam.recording import BagReader, Replay
from explore_slam.recording.carmen_log import CarmenLog, read_carmen
from explore_slam.recording.importers.carmen import start_pose, write_carmen_bag
from explore_slam.results.plots import save_map_picture
from explore_slam.results.relations import (
    LoggedOdometry,
    Relations,
    find_offset,
    poses_at,
    relation_errors,
)
from explore_slam.results.replay_run import configuration
from explore_slam.results.run_data import RunData, VehicleRun
from explore_slam.results.trajectory import Trajectory, align, position_errors

STARTS = ('known', 'unknown')
GRID_PERIOD = 2.0  # s between grids, as the live agent publishes them
MEGABYTE = 2**20
FIGURES = (
    ('translation_mean_m', 'translation (m)', '.3f'),
    ('translation_std_m', '±', '.3f'),
    ('rotation_mean_deg', 'rotation (°)', '.2f'),
    ('near_m', 'near (m)', '.3f'),
    ('loops_m', 'loops (m)', '.3f'),
    ('reference_translation_mean_m', "log's own (m)", '.3f'),
    ('reference_rms_m', 'RMS to reference (m)', '.3f'),
    ('closures', 'closures', 'd'),
    ('seconds', 'seconds', '.1f'),
    ('peak_memory_mb', 'memory (MB)', '.0f'),
    ('longest_step_s', 'longest step (s)', '.3f'),
)


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
    """A log ready to be replayed: its bag, what it is evaluated against, and settings."""

    name: str
    bag: Path
    vehicles: Mapping[str, VehicleLog]
    laser: Pose2
    relations: Relations | None
    offset: float
    settings: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    picture_folder: Path | None = None


class _Replayed(NamedTuple):
    """What a replay leaves: keyframes of each vehicle, the grid, and what it cost."""

    keyframes: dict[str, Trajectory]
    grid: Any
    closures: int
    seconds: float
    steps: Array


class _TimedAgent:
    """An agent for Replay.feed that measures how long every call takes (s)."""

    def __init__(self, agent: Agent) -> None:
        self._agent = agent
        self._next_grid = -np.inf
        self.steps: list[float] = []

    def __getattr__(self, name: str) -> Any:
        method = getattr(self._agent, name)

        def timed(*arguments: Any) -> Any:
            begin = time.perf_counter()
            result = method(*arguments)
            self.steps.append(time.perf_counter() - begin)
            return result

        return timed

    def tick(self, stamp: float) -> None:
        """Bring the grid up to date as often as the live agent does."""
        if stamp >= self._next_grid:
            self._next_grid = stamp + GRID_PERIOD
            begin = time.perf_counter()
            _ = self._agent.grid
            self.steps.append(time.perf_counter() - begin)


# -- what is replayed ----------------------------------------------------------------------------


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

    cut: seconds from the start after which the log becomes that of a second vehicle.
    """
    if starts not in STARTS:
        raise EvaluationError(f'starts is {starts!r}, expected one of {list(STARTS)}')
    if starts == 'unknown':
        raise EvaluationError('the agent cannot start vehicles at unknown poses yet')
    if path.is_dir() or path.suffix in ('.mcap', '.db3'):
        if cut is not None:
            raise EvaluationError('a bag cannot be cut, expected a CARMEN log')
        bag, laser, vehicles = path, _laser_of_bag(path), _vehicles_of_bag(path)
        notes: tuple[str, ...] = ()
    else:
        log = read_carmen(path)
        notes = log.notes
        logs = [log] if cut is None else cut_log(log, cut)
        bag = folder / 'bag'
        write_carmen_bag(logs, bag, [start_pose(log) for log in logs])
        vehicles = {f'robot{i + 1}': _vehicle_log(log) for i, log in enumerate(logs)}
        laser = logs[0].mount
    wanted = Relations.load(relations) if relations is not None else None
    if wanted is not None and offset is None:
        offset = find_offset(wanted, _odometry_of(vehicles), laser)
    if wanted is None and all(log.reference is None for log in vehicles.values()):
        raise EvaluationError(
            f'{path} has no corrected poses: expected relations to evaluate it with'
        )
    return MappingTask(
        path.stem, bag, vehicles, laser, wanted, offset or 0.0, dict(settings or {}), notes
    )


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


def _odometry_of(vehicles: Mapping[str, VehicleLog]) -> LoggedOdometry:
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


# -- one run -------------------------------------------------------------------------------------


def run_mapping(task: MappingTask, seed: int) -> dict[str, Any]:
    """Replay the bag of a task with a seed and return the figures of the run."""
    warm_up()
    done = _replay(task, seed)
    figures: dict[str, Any] = {'seed': seed, **_relation_figures(task, done)}
    figures['reference_rms_m'] = _reference_rms(task, done)
    recorded = max(float(log.stamps[-1] - log.stamps[0]) for log in task.vehicles.values())
    figures.update(
        closures=done.closures,
        seconds=done.seconds,
        recorded_seconds=recorded,
        peak_memory_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / MEGABYTE,
        step_median_s=float(np.median(done.steps)),
        step_p99_s=float(np.quantile(done.steps, 0.99)),
        longest_step_s=float(done.steps.max()),
        joined_after_m=None,
        join_error_m=None,
        false_joins=None,
    )
    if task.picture_folder is not None:
        _draw(task, done, seed)
    return figures


def _replay(task: MappingTask, seed: int) -> _Replayed:
    config = configuration(task.bag, None, task.settings)
    with BagReader(task.bag) as bag:
        replay = Replay(bag)
        agent = Agent(config, replay.start_poses(), seed)
        timed = _TimedAgent(agent)
        begin = time.perf_counter()
        replay.feed(timed, tick=timed.tick)
        grid = agent.grid
        seconds = time.perf_counter() - begin
    keyframes = {name: Trajectory.of(*agent.trajectory(name)) for name in agent.vehicles}
    counts = agent.summary().values()
    closures = sum(int(found.get('closures', 0)) for found in counts)
    return _Replayed(keyframes, grid, closures, seconds, np.array(timed.steps))


def _relation_figures(task: MappingTask, done: _Replayed) -> dict[str, float | None]:
    """Return the errors over the relations, and those of the log's own poses."""
    names = ('translation_mean_m', 'translation_std_m', 'rotation_mean_deg', 'near_m', 'loops_m')
    if task.relations is None:
        return {**dict.fromkeys(names), 'reference_translation_mean_m': None}
    logs = task.vehicles
    odometry = _odometry_of(logs)
    estimated = [
        (logs[name].log_times(path.stamps), path.poses)
        for name, path in done.keyframes.items()
        if name in logs and len(path)
    ]
    reference = [
        (log.log_times(log.scan_stamps), log.reference)
        for log in logs.values()
        if log.reference is not None
    ]

    def errors(parts: Sequence[tuple[Array, Array]]) -> dict[str, float | None]:
        times, poses = (np.concatenate(part) for part in zip(*parts, strict=True))
        assert task.relations is not None
        found = relation_errors(task.relations, times, poses, odometry, task.offset, task.laser)
        return found.figures()

    own = errors(reference)['translation_mean_m'] if reference else None
    return {**errors(estimated), 'reference_translation_mean_m': own}


def _reference_rms(task: MappingTask, done: _Replayed) -> float | None:
    """Return the RMS distance of the laser from its reference, all vehicles aligned at once."""
    poses: list[Array] = []
    references: list[Array] = []
    for name, log in task.vehicles.items():
        path = done.keyframes.get(name)
        if log.reference is None or path is None or not len(path):
            continue
        odometry = LoggedOdometry(log.stamps, log.odometry)
        at_scans, _ = poses_at(log.scan_stamps, path.stamps, path.poses, odometry)
        poses.append(compose(at_scans, np.asarray(task.laser)))
        references.append(compose(log.reference, np.asarray(task.laser)))
    if not poses:
        return None
    estimated, reference = np.concatenate(poses), np.concatenate(references)
    errors = position_errors(align(estimated, reference), reference)
    return float(np.sqrt(np.mean(errors**2)))


def _draw(task: MappingTask, done: _Replayed, seed: int) -> None:
    assert task.picture_folder is not None
    runs = tuple(VehicleRun(name, estimated=path) for name, path in done.keyframes.items())
    data = RunData(f'{task.name}, seed {seed}', runs, {}, done.grid)
    save_map_picture(data, task.picture_folder / f'map_seed{seed}.png', width=1600)


# -- all runs ------------------------------------------------------------------------------------


def run_study(task: MappingTask, seeds: Sequence[int]) -> Iterator[dict[str, Any]]:
    """Yield the figures of a run for every seed, each in a process of its own."""
    if not seeds:
        raise EvaluationError('mapping study: no seeds given')
    context = multiprocessing.get_context('spawn')
    for seed in seeds:
        # a fresh process for each: its peak of memory is that of the run
        with ProcessPoolExecutor(1, mp_context=context) as pool:
            yield pool.submit(run_mapping, task, seed).result()


def markdown_table(runs: Sequence[Mapping[str, Any]]) -> str:
    """Return a table of the figures, one row per seed."""
    lines = [
        '| seed | ' + ' | '.join(title for _, title, _ in FIGURES) + ' |',
        '|---' * (len(FIGURES) + 1) + '|',
    ]
    for run in runs:
        cells = (
            '-' if run.get(name) is None else format(run[name], form) for name, _, form in FIGURES
        )
        lines.append(f'| {run["seed"]} | ' + ' | '.join(cells) + ' |')
    return '\n'.join(lines)


def save_study(task: MappingTask, runs: Sequence[Mapping[str, Any]], folder: Path) -> list[Path]:
    """Write mapping.json and table.md into a folder; return the paths of both."""
    content = {
        'log': task.name,
        'vehicles': list(task.vehicles),
        'relations': None if task.relations is None else len(task.relations),
        'offset_s': task.offset if task.relations is not None else None,
        'settings': dict(task.settings),
        'runs': list(runs),
    }
    paths = [folder / 'mapping.json', folder / 'table.md']
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_text(paths[0], json.dumps(content, indent=2) + '\n')
        write_text(paths[1], markdown_table(runs) + '\n')
    except OSError as error:
        raise EvaluationError(f'{folder} cannot be written: {error}') from error
    return paths
