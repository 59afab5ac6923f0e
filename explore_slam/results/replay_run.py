"""Replay of a recording through the agent, evaluated against what else was recorded."""

import logging
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from explore_slam.agent.agent import Agent
from explore_slam.agent.config import AgentConfig, explicit_mounts
from explore_slam.data import LaserScan, OdometryReading
from explore_slam.errors import RecordingError
from explore_slam.geometry import Pose2
from explore_slam.mapping import OccupancyGrid
from explore_slam.messages.sweep_status import named_sweeps
from explore_slam.messages.topics import TopicKind
from explore_slam.messages.vehicle_settings import split_vehicle_values
from explore_slam.recording.bag import BagReader
from explore_slam.recording.events import Event
from explore_slam.recording.importers.importing import SETTINGS_FILE
from explore_slam.recording.replay import Replay, Tally
from explore_slam.recording.topic_selection import topic_choices
from explore_slam.results.landmark_agreement import evaluate_frames
from explore_slam.results.run_data import RunData, RunRecorder
from explore_slam.settings import read_parameters, values_of, with_values
from explore_slam.sweeps import Sweep

logger = logging.getLogger(__name__)

# Time (s) between two samples of the mapped area: 300 samples in a recording of 25 minutes.
COVERAGE_PERIOD = 5.0
POSE_PERIOD = 0.2  # s between samples of the pose online: at 0.5 m/s one every 10 cm
NAMED_NO_RETURNS = 0.01  # share of beams without return that a note tells
_SOURCES = {
    'scan': 'its scans (odometry: scan)',
    'wheels+gyro': 'its wheels and a gyroscope (odometry: wheels+gyro)',
}
_RECORDED = {TopicKind.ODOMETRY, TopicKind.GROUND_TRUTH}


def bag_settings(bag: Path) -> dict[str, Any]:
    """Return the settings recorded with a bag, by name; {} without any.

    They are stored in the bag (imported data sets) or in the run folder beside it (live runs).
    """
    files = [bag / SETTINGS_FILE, bag.parent / SETTINGS_FILE] if bag.is_dir() else []
    file = next((file for file in files if file.exists()), None)
    return {} if file is None else read_parameters(file)


def recorded_starts(bag: Path) -> dict[str, Pose2 | None]:
    """Return the start poses of the live run that recorded the bag; {} for other bags.

    None: the start pose of a vehicle was unknown (nan).
    """
    settings = bag_settings(bag)
    names, flat = settings.get('vehicles'), settings.get('start_poses')
    if not isinstance(names, list) or not isinstance(flat, list) or len(flat) != 3 * len(names):
        return {}
    poses = [Pose2.from_array(flat[3 * index : 3 * index + 3]) for index in range(len(names))]
    return {
        str(name): pose if pose.is_finite() else None
        for name, pose in zip(names, poses, strict=True)
    }


def configuration(
    bag: Path, config: AgentConfig | None = None, options: Mapping[str, Any] | None = None
) -> AgentConfig:
    """Return the settings of a replay: options override `config`, which replaces the bag's own."""
    tree = config or AgentConfig()
    if config is None:
        known = values_of(tree)
        _, found = split_vehicle_values(bag_settings(bag))
        others = sorted(set(found) - set(known))
        if others:
            logger.info('%s: settings %s do not belong to the agent and are ignored', bag, others)
        tree = with_values(tree, {name: found[name] for name in found if name in known})
    return with_values(tree, options or {})


class _Collector:
    """Passes odometry, ground truth, keyframes and mapped area of a replay to the recorder."""

    def __init__(self, agent: Agent, recorder: RunRecorder) -> None:
        self._agent = agent
        self._recorder = recorder
        self._next_coverage = self._next_pose = -np.inf
        self._scans = False
        self._scan_counts: dict[str, tuple[int, int]] = {}
        self.first: float | None = None
        self.last = 0.0

    def add_event(self, event: Event) -> None:
        """Record odometry and ground truth."""
        self.first = event.stamp if self.first is None else min(self.first, event.stamp)
        self.last = max(self.last, event.stamp)
        if isinstance(event.record, LaserScan):
            self._scans = True
            count, empty = self._scan_counts.get(event.vehicle, (0, 0))
            empty += not _has_ranges(event.record)
            self._scan_counts[event.vehicle] = count + 1, empty
        elif event.kind in _RECORDED and isinstance(event.record, OdometryReading):
            if event.kind is TopicKind.ODOMETRY:
                if self._agent.track(event.vehicle).source.needs_scans:
                    return  # its odometry is that of the scans
                self._recorder.add_odometry(event.vehicle, event.record)
            else:
                self._recorder.add_truth(event.vehicle, event.stamp, event.record.pose)

    def tick(self, stamp: float) -> None:
        """Record the keyframes since the last call, and periodically the mapped area."""
        for event in self._agent.take_events():
            if event.in_map:
                self._recorder.add_keyframe(event)
        for name, track in self._agent.tracks.items():
            if track.source.needs_scans and len(track.odometry):
                reading = OdometryReading(track.odometry.last, track.odometry.pose)
                self._recorder.add_odometry(name, reading)
        for name in self._agent.vehicles if stamp >= self._next_pose else ():
            odometry = self._agent.track(name).odometry
            if len(odometry) and self._agent.is_in_map(name):
                pose, _ = self._agent.estimate(name)
                self._recorder.add_pose(name, odometry.last, pose)
        self._next_pose = max(self._next_pose, stamp + POSE_PERIOD)
        if self._scans and stamp >= self._next_coverage:
            self._next_coverage = stamp + COVERAGE_PERIOD
            self._recorder.add_coverage(stamp, known_area(self._agent.grid))

    def finish(self, stamp: float) -> None:
        """Record what has come since the last call, and the mapped area at the end."""
        self._next_coverage = -np.inf
        self.tick(stamp)

    def unusable(self) -> list[str]:
        """Return the vehicles most of whose scans hold no range."""
        return [
            f'{empty} of {count} scans of {vehicle} hold no range, and no beam without return '
            '(+inf): all values are NaN, 0 or below range_min'
            for vehicle, (count, empty) in sorted(self._scan_counts.items())
            if 2 * empty > count
        ]


def _has_ranges(scan: LaserScan) -> bool:
    return bool(np.any((scan.ranges >= scan.range_min) & (scan.ranges > 0.0)))


def _join_notes(
    agent: Agent, starts: Mapping[str, Pose2 | None], apart: Iterable[str]
) -> list[str]:
    """Return what became of the vehicles of unknown start; apart: those not in the map."""
    joined = [
        f'{join.vehicle} joined the map of {join.other} after driving {join.distance_driven:.1f} m'
        for join in agent.take_joins()
        if starts[join.vehicle] is None
    ]
    return joined + [f'{vehicle} was not found in the map: it is left out' for vehicle in apart]


def known_area(grid: OccupancyGrid) -> float:
    """Return the area (m²) of the cells whose occupancy is known."""
    return float(np.count_nonzero(grid.known())) * float(grid.resolution) ** 2


def replay_bag(
    path: Path,
    *,
    config: AgentConfig | None = None,
    options: Mapping[str, Any] | None = None,
    seed: int = 0,
    vehicles: Iterable[str] = (),
    starts: Mapping[str, Pose2 | None] | None = None,
    until: float | None = None,
    progress: Callable[[float], None] | None = None,
    topics: Iterable[str] = (),
    vehicle_values: Mapping[str, Any] | None = None,
) -> RunData:
    """Replay a bag through the agent and return the data of the run.

    config, options: see `configuration`. starts: start poses that the bag does not hold, None:
    unknown. until: time (s) after the first record at which to stop. progress: called with the
    fraction done. topics: chosen by hand, 'VEHICLE.KIND=/TOPIC'. vehicle_values: settings of the
    vehicles by name, of the team ('vision') or of one ('robot1.laser_mount'), instead of those in
    the bag; options may hold them too.
    metrics['unusable']: reasons why most of what is needed could not be used; [] if all is well.
    The result depends on the bag, the settings and the seed alone (except metrics['timing']).
    A bag without odometry is evaluated frame by frame (`landmark_agreement`).
    """
    own, others = split_vehicle_values(options or {})
    effective = configuration(path, config, others)
    with BagReader(path) as bag:
        if vehicle_values is None:
            vehicle_values, _ = split_vehicle_values(bag_settings(path))
        settings = {**vehicle_values, **own}
        replay = Replay(
            bag,
            vehicles,
            starts,
            recorded_starts(path),
            settings.get('vision'),
            topic_choices(topics),
            settings,
            explicit_mounts(effective),
        )
        if not _has_odometry(replay):
            return evaluate_frames(replay, effective, until)
        poses = replay.start_poses()
        agent = Agent(effective, poses, seed, replay.bodies, replay.sources, replay.camera_scans)
        recorder = RunRecorder(
            f'Replay of {path.name}', poses, effective.slam.particles, coverage_unit='m²'
        )
        collector = _Collector(agent, recorder)
        begin = time.perf_counter()
        tally = replay.feed(
            agent, also=collector.add_event, tick=collector.tick, progress=progress, until=until
        )
        grid = agent.grid
        collector.finish(agent.now)
        wall = time.perf_counter() - begin
    no_returns = agent.no_returns
    recorded = collector.last - (collector.first or collector.last)
    apart = [vehicle for vehicle in poses if not agent.is_in_map(vehicle)]
    for warning in (
        *replay.warnings,
        *_mount_notes(replay),
        *_no_return_notes(no_returns, effective.mapping.no_return_range),
        *_sweep_notes(agent.found_sweeps()),
        *_odometry_notes(agent.odometry_sources()),
        *_warn_without_sensors(replay),
        *_join_notes(agent, poses, apart),
    ):
        recorder.add_note(warning)
    calibrations = agent.odometry_calibrations()
    return recorder.finish(
        {vehicle: agent.trajectory(vehicle) for vehicle in poses if vehicle not in apart},
        calibrations=calibrations,
        grid=grid if grid.known().any() else None,
        landmarks=agent.landmarks(),
        settings=effective,
        extra={
            'seed': seed,
            'records': dict(sorted(tally.fed.items())),
            'refused': dict(sorted(tally.refused.items())),
            'agent': agent.summary(),
            'odometry_calibration': {
                name: found._asdict() for name, found in calibrations.items()
            },
            'odometry_sources': agent.odometry_sources(),
            'sweeps': {
                name: named_sweeps(lasers) for name, lasers in agent.found_sweeps().items()
            },
            'mounts': {name: dict(item.report()) for name, item in replay.mounts.items()},
            'no_return': {
                name: {'share': share, 'free': free} for name, (share, free) in no_returns.items()
            },
            'unusable': [
                *replay.unusable(),
                *collector.unusable(),
                *_lost_in_agent(agent, tally),
            ],
            'timing': {
                'wall_seconds': wall,
                'recorded_seconds': recorded,
                'times_real_time': recorded / wall if wall > 0.0 else None,
            },
        },
    )


def _sweep_notes(found: Mapping[str, Mapping[str, Sweep]]) -> list[str]:
    """Return what scans have shown of the sweeps of their lasers, in words."""
    notes = []
    for vehicle, lasers in found.items():
        for laser, sweep in lasers.items():
            name = f'{vehicle}, {laser}' if laser else vehicle
            shown = str(sweep) if sweep.duration else 'that all beams are measured at one moment'
            notes.append(f'{name}: the scans show {shown}')
    return notes


def _odometry_notes(sources: Mapping[str, Mapping[str, float | str]]) -> list[str]:
    """Return what odometry is taken from, where scans disagree, and what gyroscopes show."""
    notes = []
    for vehicle, found in sources.items():
        if found['source'] != 'wheels':
            notes.append(f'{vehicle}: its odometry is that of {_SOURCES[str(found["source"])]}')
        if 'problem' in found:
            notes.append(f'{vehicle}: {found["problem"]}')
        if 'gyro' in found:
            notes.append(
                f'{vehicle}: gyroscope {found["gyro"]}, bias '
                f'{found["gyro_bias_rad_per_s"]:.4f} rad/s '
                f'± {found["gyro_bias_deviation_rad_per_s"]:.4f}'
            )
    return notes


def _mount_notes(replay: Replay) -> list[str]:
    """Return the mounts that are not those of the settings, and where they come from."""
    return [
        f'{vehicle}: sensor {frame or "without frame"} at {mount}'
        for vehicle, mounts in replay.mounts.items()
        for frame, mount in sorted(mounts.used.items())
        if mount.pose is not None
    ]


def _no_return_notes(no_returns: Mapping[str, tuple[float, bool]], limit: float) -> list[str]:
    """Return how many beams have no return, and what they are taken for."""
    return [
        f'{vehicle}: {100.0 * share:.0f} % of the beams have no return (+inf): '
        + (f'they free cells up to {limit:g} m' if free and limit else 'they free no cells')
        + ' (no_return_meaning, no_return_range)'
        for vehicle, (share, free) in no_returns.items()
        if share >= NAMED_NO_RETURNS or not free
    ]


def _lost_in_agent(agent: Agent, tally: Tally) -> list[str]:
    """Return the vehicles of which the agent could not use most measurements, or odometry."""
    found = []
    for vehicle, counts in agent.summary().items():
        odometry = tally.fed.get(f'{vehicle}/{TopicKind.ODOMETRY.value}', 0)
        late = counts.get('late_odometry', 0)
        if 2 * late > odometry > 0:
            found.append(
                f'{late} of {odometry} odometry messages of {vehicle} have a stamp that is not '
                'later than the one before: they are omitted'
            )
        kinds = (TopicKind.SCAN, TopicKind.COLOR, TopicKind.LANDMARKS)
        fed = sum(tally.fed.get(f'{vehicle}/{kind.value}', 0) for kind in kinds)
        lost = counts.get('dropped_without_odometry', 0) + counts.get('late_observations', 0)
        if odometry and 2 * lost > fed > 0:  # without odometry, that is the reason, and named
            found.append(
                f'{lost} of {fed} measurements of {vehicle} lie outside its odometry: their '
                'stamps do not fit together'
            )
    return found


def _warn_without_sensors(replay: Replay) -> list[str]:
    """Return a warning for each vehicle that measures nothing but its odometry."""
    sensors = {
        TopicKind.COLOR,
        TopicKind.COLOR_COMPRESSED,
        TopicKind.LANDMARKS,
        TopicKind.SCAN,
    }
    return [
        f'{vehicle} has neither scans nor images nor landmark observations: its pose follows its '
        'odometry'
        for vehicle in replay.vehicles
        if not replay.kinds(vehicle) & sensors
    ]


def _has_odometry(replay: Replay) -> bool:
    """Return whether any vehicle has odometry or scans; warn of those that have neither."""
    without = [
        vehicle
        for vehicle in replay.vehicles
        if TopicKind.ODOMETRY not in replay.kinds(vehicle) and replay.sources[vehicle] != 'scan'
    ]
    images = {TopicKind.COLOR, TopicKind.COLOR_COMPRESSED}
    if len(without) == len(replay.vehicles) and not any(replay.kinds(v) & images for v in without):
        raise RecordingError(
            f'{replay.bag.path} holds neither odometry (<vehicle>/{TopicKind.ODOMETRY.value}) nor '
            f'scans of {without}, without which no vehicle can be localized'
        )
    for vehicle in without:
        replay.note(f'{vehicle} has no odometry: its observations are not mapped')
    return len(without) < len(replay.vehicles)
