"""A recording through the agent into a run folder: what `explore_slam replay` does."""

import logging
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from explore_slam.agent.agent import Agent
from explore_slam.agent.config import AgentConfig
from explore_slam.data import OdometryReading
from explore_slam.errors import ConfigError, RecordingError
from explore_slam.studies.observation_study import observe_recording
from explore_slam.results.run_data import RunData, RunRecorder
from explore_slam.geometry import Pose2
from explore_slam.recording.bag import BagReader
from explore_slam.recording.events import Event
from explore_slam.recording.importers.importing import SETTINGS_FILE
from explore_slam.recording.replay import Replay
from explore_slam.messages.topics import TopicKind
from explore_slam.settings import values_of, with_values

logger = logging.getLogger(__name__)

COVERAGE_PERIOD = 5.0
_KEPT = {TopicKind.ODOMETRY, TopicKind.GROUND_TRUTH}


def bag_settings(bag: Path) -> dict[str, Any]:
    """Return the settings that belong to a bag, by name; {} without any.

    They lie in the bag (imported ones) or in the run folder beside it (recorded live).
    """
    files = [bag / SETTINGS_FILE, bag.parent / SETTINGS_FILE] if bag.is_dir() else []
    file = next((file for file in files if file.exists()), None)
    if file is None:
        return {}
    try:
        content = yaml.safe_load(file.read_text(encoding='utf-8')) or {}
        found: dict[str, Any] = {}
        for node in content.values():
            found.update(node['ros__parameters'])
    except (OSError, yaml.YAMLError, AttributeError, KeyError, TypeError, ValueError) as error:
        raise ConfigError(f'{file} is not a ROS parameter file: {error!r}') from error
    return found


def recorded_starts(bag: Path) -> dict[str, Pose2]:
    """Return the start poses that the agent had when the bag was recorded live; {} elsewhere."""
    settings = bag_settings(bag)
    names, flat = settings.get('vehicles'), settings.get('start_poses')
    if not isinstance(names, list) or not isinstance(flat, list) or len(flat) != 3 * len(names):
        return {}
    return {
        str(name): Pose2.from_array(flat[3 * index : 3 * index + 3])
        for index, name in enumerate(names)
    }


def configuration(
    bag: Path, config: AgentConfig | None = None, options: Mapping[str, Any] | None = None
) -> AgentConfig:
    """Return what a replay runs with: options over the given configuration over the bag's own."""
    tree = config or AgentConfig()
    if config is None:
        known = values_of(tree)
        found = bag_settings(bag)
        others = sorted(set(found) - set(known))
        if others:
            logger.info('%s: settings %s are not of the agent: unused', bag, others)
        tree = with_values(tree, {name: found[name] for name in found if name in known})
    return with_values(tree, options or {})


class _Collector:
    """Hears what goes into the agent and what comes out of it, for the recorder."""

    def __init__(self, agent: Agent, recorder: RunRecorder) -> None:
        self._agent = agent
        self._recorder = recorder
        self._next_coverage = -np.inf
        self._scans = False
        self.first: float | None = None
        self.last = 0.0

    def hear(self, event: Event) -> None:
        """Keep odometry and truth."""
        self.first = event.stamp if self.first is None else min(self.first, event.stamp)
        self.last = max(self.last, event.stamp)
        if event.kind is TopicKind.SCAN:
            self._scans = True
        elif event.kind in _KEPT and isinstance(event.record, OdometryReading):
            if event.kind is TopicKind.ODOMETRY:
                self._recorder.add_odometry(event.vehicle, event.record)
            else:
                self._recorder.add_truth(event.vehicle, event.stamp, event.record.pose)

    def tick(self, stamp: float) -> None:
        """Keep the keyframes since the last time, and now and then the area that is known."""
        for event in self._agent.take_events():
            self._recorder.add_keyframe(event)
        if self._scans and stamp >= self._next_coverage:
            self._next_coverage = stamp + COVERAGE_PERIOD
            self._recorder.add_coverage(stamp, known_area(self._agent.grid))


def known_area(grid: Any) -> float:
    """Return the area (m²) of the cells that are known."""
    return float(np.count_nonzero(grid.known())) * float(grid.resolution) ** 2


def replay_bag(
    path: Path,
    *,
    config: AgentConfig | None = None,
    options: Mapping[str, Any] | None = None,
    seed: int = 0,
    vehicles: Iterable[str] = (),
    starts: Mapping[str, Pose2] | None = None,
    until: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> RunData:
    """Run a bag through the agent and return the run; see `configuration` for the settings.

    The result depends on the bag, the settings and the seed alone (metrics['timing'] aside).
    """
    effective = configuration(path, config, options)
    with BagReader(path) as bag:
        vision = bag_settings(path).get('vision')
        replay = Replay(bag, vehicles, starts, recorded_starts(path), vision)
        if not _has_odometry(replay):
            return observe_recording(replay, effective, until)
        poses = replay.start_poses()
        agent = Agent(effective, poses, seed)
        recorder = RunRecorder(
            f'Replay of {path.name}', poses, effective.slam.particles, coverage_unit='m²'
        )
        collector = _Collector(agent, recorder)
        begin = time.perf_counter()
        tally = replay.feed(
            agent, also=collector.hear, tick=collector.tick, progress=progress, until=until
        )
        grid = agent.grid
        collector.tick(agent.now)
        wall = time.perf_counter() - begin
    recorded = collector.last - (collector.first or collector.last)
    for warning in (*replay.warnings, *_blind(replay)):
        recorder.add_note(warning)
    return recorder.finish(
        {vehicle: agent.trajectory(vehicle) for vehicle in poses},
        grid=grid if grid.known().any() else None,
        landmarks=agent.landmarks(),
        settings=effective,
        extra={
            'seed': seed,
            'records': dict(sorted(tally.fed.items())),
            'refused': dict(sorted(tally.refused.items())),
            'agent': agent.summary(),
            'timing': {
                'wall_seconds': wall,
                'recorded_seconds': recorded,
                'times_real_time': recorded / wall if wall > 0.0 else None,
            },
        },
    )


def _blind(replay: Replay) -> list[str]:
    """Name the vehicles that see no landmarks."""
    seeing = {TopicKind.COLOR, TopicKind.COLOR_COMPRESSED, TopicKind.LANDMARKS}
    return [
        f'{vehicle} has neither frames nor landmarks: nothing closes its loops, '
        'its map follows odometry and scans'
        for vehicle in replay.vehicles
        if not replay.kinds(vehicle) & seeing
    ]


def _has_odometry(replay: Replay) -> bool:
    """Tell whether anything can be placed in the map; vehicles of which nothing can are named."""
    kinds = {vehicle: replay.kinds(vehicle) for vehicle in replay.vehicles}
    without = [vehicle for vehicle in kinds if TopicKind.ODOMETRY not in kinds[vehicle]]
    frames = any(kinds[v] & {TopicKind.COLOR, TopicKind.COLOR_COMPRESSED} for v in without)
    if len(without) == len(kinds) and not frames:
        raise RecordingError(
            f'{replay.bag.path} holds no odometry (<vehicle>/{TopicKind.ODOMETRY.value}) of '
            f'{without}: nothing in it can be placed in the map'
        )
    for vehicle in without:
        replay.warnings.append(f'{vehicle} has no odometry: what it sees is not placed in the map')
    return len(without) < len(kinds)
