"""Accuracy of maps from laser logs: replays with default settings, errors over relations."""

import math
import multiprocessing
import resource
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from explore_slam.agent import Agent, Join, warm_up
from explore_slam.agent.config import explicit_mounts
from explore_slam.errors import EvaluationError
from explore_slam.files import write_text
from explore_slam.geometry import Array, Pose2, compose
from explore_slam.messages.vehicle_settings import split_vehicle_values
from explore_slam.polyline import arc_lengths
from explore_slam.recording import BagReader, Replay
from explore_slam.results import tables
from explore_slam.results.plots import save_map_picture
from explore_slam.results.relations import LoggedOdometry, poses_at, relation_errors
from explore_slam.results.replay_run import bag_settings, configuration
from explore_slam.results.run_data import RunData, VehicleRun
from explore_slam.results.trajectory import Trajectory, align, position_errors
from explore_slam.studies.mapping_log import MappingTask, VehicleLog, odometry_of

# A join that is off by more than this is false. Slides along a corridor are 0.5 m and more; the
# references themselves are off by up to 0.3 m between two visits of a place (ACES).
WRONG_JOIN = (0.6, 0.1)  # m, rad
SAME_PLACE = 2.0  # m between the poses of vehicles that have been at the same place
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
    ('joined_after_m', 'joined after (m)', '.1f'),
    ('met_after_m', 'met after (m)', '.1f'),
    ('join_error_m', 'join error (m)', '.3f'),
    ('false_joins', 'false joins', 'd'),
    ('seconds', 'seconds', '.1f'),
    ('peak_memory_mb', 'memory (MB)', '.0f'),
    ('longest_step_s', 'longest step (s)', '.3f'),
)


class _Replayed(NamedTuple):
    """What a replay leaves: keyframes of each vehicle in the map, the grid, and what it cost.

    joins: vehicles that were tied to the map of others, in the order in which that happened.
    """

    keyframes: dict[str, Trajectory]
    joins: list[Join]
    grid: Any
    closures: int
    seconds: float
    steps: Array


class _TimedAgent:
    """An agent that is fed by a replay and measures how long each call takes."""

    def __init__(self, agent: Agent) -> None:
        self._agent = agent
        self._next_grid = -np.inf
        self.steps: list[float] = []  # s

    def add(self, vehicle: str, record: Any, /) -> None:
        """See Agent.add."""
        self._measure(lambda: self._agent.add(vehicle, record))

    def set_pose(self, vehicle: str, pose: Pose2, covariance: Array, /) -> None:
        """See Agent.set_pose."""
        self._measure(lambda: self._agent.set_pose(vehicle, pose, covariance))

    def advance(self, stamp: float, /) -> None:
        """See Agent.advance."""
        self._measure(lambda: self._agent.advance(stamp))

    def tick(self, stamp: float) -> None:
        """Bring the grid up to date as often as the live agent does."""
        if stamp >= self._next_grid:
            self._next_grid = stamp + GRID_PERIOD
            self._measure(lambda: self._agent.grid)

    def _measure(self, step: Callable[[], object]) -> None:
        begin = time.perf_counter()
        step()
        self.steps.append(time.perf_counter() - begin)


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
        **join_figures(task.vehicles, done.joins),
    )
    if task.picture_folder is not None:
        _draw(task, done, seed)
    return figures


def _replay(task: MappingTask, seed: int) -> _Replayed:
    config = configuration(task.bag, None, task.settings)
    with BagReader(task.bag) as bag:
        replay = Replay(
            bag,
            starts=dict.fromkeys(task.unknown_starts),
            settings=split_vehicle_values(bag_settings(task.bag))[0],
            team_mounts=explicit_mounts(config),
        )
        agent = Agent(config, replay.start_poses(), seed)
        timed = _TimedAgent(agent)
        begin = time.perf_counter()
        replay.feed(timed, tick=timed.tick)
        grid = agent.grid
        seconds = time.perf_counter() - begin
    in_map = filter(agent.is_in_map, agent.vehicles)
    keyframes = {name: Trajectory.of(*agent.trajectory(name)) for name in in_map}
    counts = agent.summary().values()
    closures = sum(int(found.get('closures', 0)) for found in counts)
    joins = agent.take_joins()
    return _Replayed(keyframes, joins, grid, closures, seconds, np.array(timed.steps))


def join_figures(logs: Mapping[str, VehicleLog], joins: Sequence[Join]) -> dict[str, float | None]:
    """Return when the last of several vehicles was joined to the others, and how accurately.

    joined_after_m: distance that it had driven, null if not all were joined; met_after_m: distance
    after which the last of them came to a place where another one had been before; join_error_m:
    the largest error of the relative poses that were found, by the reference; false_joins: how
    many of them are wrong. All are null for a single vehicle.
    """
    names = list(logs)
    figures: dict[str, float | None] = dict.fromkeys(
        ('joined_after_m', 'met_after_m', 'join_error_m', 'false_joins')
    )
    if len(names) < 2:
        return figures
    met = [_met_after(logs, name) for name in names[1:]]
    if None not in met:
        figures['met_after_m'] = max(distance for distance in met if distance is not None)
    first = {join.vehicle: join for join in reversed(joins)}
    if set(first) >= set(names[1:]):
        figures['joined_after_m'] = max(join.distance_driven for join in first.values())
    errors = []
    for join in joins:
        here, there = (
            _reference_at(logs[name], stamp)
            for name, stamp in ((join.vehicle, join.stamp), (join.other, join.other_stamp))
        )
        if here is not None and there is not None:
            off = there.between(here).between(join.relative)
            errors.append((math.hypot(off.x, off.y), abs(off.theta)))
    if errors:
        figures['join_error_m'] = max(distance for distance, _ in errors)
    wrong = [error for error in errors if error[0] > WRONG_JOIN[0] or error[1] > WRONG_JOIN[1]]
    figures['false_joins'] = len(wrong)
    return figures


def _met_after(logs: Mapping[str, VehicleLog], name: str) -> float | None:
    """Return the distance (m) a vehicle drove until it was where another had been; None: never."""
    log = logs[name]
    if log.reference is None:
        return None
    distances = arc_lengths(log.reference[:, :2])
    for stamp, pose, distance in zip(log.scan_stamps, log.reference, distances, strict=True):
        for other in logs.values():
            if other is log or other.reference is None:
                continue
            before = other.reference[other.scan_stamps <= stamp]
            if (np.hypot(*(before[:, :2] - pose[:2]).T) < SAME_PLACE).any():
                return float(distance)
    return None


def _reference_at(log: VehicleLog, stamp: float) -> Pose2 | None:
    """Return the reference pose of a vehicle at a stamp (s), None where there is none near it."""
    if log.reference is None:
        return None
    odometry = LoggedOdometry(log.stamps, log.odometry)
    poses, _ = poses_at(np.array([stamp]), log.scan_stamps, log.reference, odometry)
    return Pose2.from_array(poses[0])


def _relation_figures(task: MappingTask, done: _Replayed) -> dict[str, float | None]:
    """Return the errors over the relations, and those of the log's own poses."""
    names = ('translation_mean_m', 'translation_std_m', 'rotation_mean_deg', 'near_m', 'loops_m')
    if task.relations is None:
        return {**dict.fromkeys(names), 'reference_translation_mean_m': None}
    logs = task.vehicles
    odometry = odometry_of(logs)
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
    header = ['seed', *(title for _, title, _ in FIGURES)]
    rows = []
    for run in runs:
        cells = (
            '-' if run.get(name) is None else format(run[name], form) for name, _, form in FIGURES
        )
        rows.append([str(run['seed']), *cells])
    return tables.markdown_table(header, rows)


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
        tables.write_json(paths[0], content)
        write_text(paths[1], markdown_table(runs) + '\n')
    except OSError as error:
        raise EvaluationError(f'{folder} cannot be written: {error}') from error
    return paths
