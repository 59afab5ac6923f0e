"""Tags in corridors of equal rooms: joins, closures and the frame of the map.

The worlds, paths, lasers and drifting wheels are those of the twin study, with a tag at each room
and a camera on each vehicle. Both starts are unknown. Images of the tags are drawn, and the tags
found in them by the detector that the agent has; some numbers are then replaced by those of other
tags of the site, as if they had been misread.
"""

import math
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from explore_slam.agent import Agent, AgentConfig, warm_up
from explore_slam.data import Intrinsics, TagObservations
from explore_slam.errors import EvaluationError
from explore_slam.files import write_text
from explore_slam.geometry import Array, Pose2, compose, wrap_angle
from explore_slam.results import tables
from explore_slam.settings import with_values
from explore_slam.simulation.worlds.tagged_rooms import (
    SIZE,
    RoomTag,
    tags_in_view,
    tags_of_rooms,
)
from explore_slam.simulation.worlds.twin_corridors import TwinCorridors, twin_corridors
from explore_slam.studies.parallel import ALONE, Workers, make_runs
from explore_slam.studies.twin_study import NAMES, PERIOD, TwinVehicle, is_wrong, team_paths
from explore_slam.vision import CameraMount, tags_available
from explore_slam.vision.tag_images import draw_view
from explore_slam.vision.tags import TagDetector

FAMILY = 'tag36h11'
# a Kinect, of which the settings give the mount
CAMERA = Intrinsics(640, 480, 525.0, 525.0, 319.5, 239.5)
WRONG_PLACE = 0.6  # m between tags that are not the same; signs are 3 m apart and more


@dataclass(frozen=True)
class TagStudy:
    """Definition of a study; settings: of AgentConfig by name.

    surveyed: how many tags have a known pose. misread: share of the tags seen that get the number
    of another one.
    """

    worlds: Sequence[int] = tuple(range(12))
    surveyed: int = 2
    misread: float = 0.0
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.worlds:
            raise EvaluationError('tag study: no worlds, expected at least one')
        if not 0 <= self.surveyed <= 2:
            raise EvaluationError(f'tag study: surveyed is {self.surveyed}, expected 0, 1 or 2')
        if not 0.0 <= self.misread < 1.0:
            raise EvaluationError(f'tag study: misread is {self.misread}, expected 0 to below 1')
        if not tags_available():
            raise EvaluationError('tag study: OpenCV finds no tags, expected version 4.7 or newer')
        self.config('')

    def config(self, tags_file: str) -> AgentConfig:
        """Return the settings of the agent; ConfigError for a wrong one."""
        return with_values(
            AgentConfig(), {'laser_x': 0.0, 'tags_file': tags_file, **self.settings}
        )


class TagRun(NamedTuple):
    """Figures of a run.

    drift_m: of the odometry over a corridor. tags, misread: seen, and of these misread. closures:
    by laser and by tags, while they lasted. joined_after_m: distance driven by the second vehicle
    until it joined, NaN if it did not. frame_m, frame_deg: by which rigid motion all keyframes of
    the map are off the truth, at their centre; without surveyed tags, relative to the start of the
    first vehicle. error_m: their mean distance from the truth.
    """

    world: int
    period_m: float
    drift_m: float
    tags: int
    misread: int
    closures: int
    tag_closures: int
    false_closures: int
    joined_after_m: float
    false_joins: int
    frame_m: float
    frame_deg: float
    error_m: float
    seconds: float


class _Camera:
    """The camera of a vehicle, and the detector of tags behind it."""

    def __init__(
        self, world: TwinCorridors, tags: list[RoomTag], config: AgentConfig, seed: int
    ) -> None:
        self._world, self._tags = world, tags
        self._mount = CameraMount.from_config(config.vision.mount)
        self._detector = TagDetector(config.vision.tags, self._mount)
        self._random = np.random.default_rng((seed, 2))
        self.seen = self.misread = 0

    def observe(self, pose: Pose2, stamp: float, misread: float) -> TagObservations | None:
        """Return the tags in an image taken at a pose, None without any; misread: share."""
        in_view = tags_in_view(self._world, self._tags, pose, CAMERA, self._mount)
        if not in_view:
            return None
        image = draw_view(FAMILY, in_view, CAMERA, self._random)
        found = self._detector.observe_image(image, CAMERA, stamp, self._mount)
        wrong = self._random.random(len(found)) < misread
        others = self._random.integers(1, len(self._tags), len(found))
        ids = np.where(wrong, (found.ids + others) % len(self._tags), found.ids)
        once = np.array([np.count_nonzero(ids == tag) == 1 for tag in ids], np.bool_)
        self.seen += len(found)
        self.misread += int(wrong.sum())
        if not once.any():
            return None
        return TagObservations(stamp, ids[once], found.poses[once], found.covariances[once])


def run_world(study: TagStudy, seed: int) -> TagRun:
    """Drive through the world of a seed and count what was closed and joined."""
    warm_up()
    begin = time.perf_counter()
    world = twin_corridors(seed)
    random = np.random.default_rng((seed, 1))
    drift = random.uniform(-0.5, 0.5) * world.period
    paths = team_paths(world)
    vehicles = {
        name: TwinVehicle(world, path, 1.0 + drift / world.length, seed + 1000 * number)
        for number, (name, path) in enumerate(paths.items())
    }
    tags = tags_of_rooms(world)
    with tempfile.TemporaryDirectory() as folder:
        config = study.config(str(_write_tags(Path(folder), tags, study.surveyed)))
        agent = Agent(config, dict.fromkeys(NAMES), seed)
        cameras = {
            name: _Camera(world, tags, config, seed + 1000 * number)
            for number, name in enumerate(vehicles)
        }
    log = _Log(agent, paths)
    for tick in range(max(len(item.path) for item in vehicles.values())):
        for name, item in vehicles.items():
            if tick >= len(item.path):
                continue
            for record in item.records(tick):
                agent.add(name, record)
            seen = cameras[name].observe(item.path[tick], PERIOD * tick, study.misread)
            if seen is not None:
                agent.add(name, seen)
        log.note()
    figures = log.figures(study.surveyed > 0)
    return TagRun(
        world=seed,
        period_m=world.period,
        drift_m=drift,
        tags=sum(camera.seen for camera in cameras.values()),
        misread=sum(camera.misread for camera in cameras.values()),
        **figures,
        seconds=time.perf_counter() - begin,
    )


def _write_tags(folder: Path, tags: Sequence[RoomTag], surveyed: int) -> Path:
    """Write tags.yaml; the surveyed ones are the second and the last but one of a corridor."""
    known = [1, len(tags) // 2 - 2][:surveyed]
    lines = [f'family: {FAMILY}', f'size: {SIZE}', 'tags:']
    for item in tags:
        pose = f', pose: {[float(part) for part in item.pose]}' if item.tag in known else ''
        lines.append(f'  - {{id: {item.tag}{pose}}}')
    path = folder / 'tags.yaml'
    write_text(path, '\n'.join(lines) + '\n')
    return path


class _Log:
    """What an agent has closed, compared with the true paths by name."""

    def __init__(self, agent: Agent, paths: Mapping[str, Sequence[Pose2]]) -> None:
        self._agent, self._paths = agent, paths
        self._closures: dict[tuple[int, int], Any] = {}
        self._ties: dict[int, bool] = {}  # factor -> whether it ties different places

    def note(self) -> None:
        """Note the closures that are new."""
        for closure in self._agent.loops.search.closures:
            self._closures.setdefault((closure.keyframe_a, closure.keyframe_b), closure)
        by_node = {sighting.node: sighting for sighting in self._agent.tags.sightings}
        for sighting in by_node.values():
            if sighting.tie >= 0 and sighting.tie not in self._ties:
                places = [self._true_place(s) for s in (sighting, by_node[sighting.root])]
                self._ties[sighting.tie] = math.dist(*places) > WRONG_PLACE

    def _true_place(self, sighting: Any) -> Array:
        """Return where (2,) m the tag of a sighting was seen, from the true path."""
        name = self._agent.vehicles[sighting.vehicle]
        at = [
            compose(np.asarray(self._true_pose(name, item.keyframe)), item.pose)[:2]
            for item in sighting.observations
        ]
        place: Array = np.median(at, axis=0)
        return place

    def _true_pose(self, name: str, keyframe: int) -> Pose2:
        return self._paths[name][round(self._agent.belief.stamp_of(keyframe) / PERIOD)]

    def figures(self, is_surveyed: bool) -> dict[str, Any]:
        """Return the figures of a run by name."""
        agent = self._agent
        owners: dict[int, str] = {}
        true, found = [], []
        for name in agent.vehicles:
            numbers = agent.belief.keyframes_of(name)
            owners |= {int(number): name for number in numbers}
            if agent.is_in_map(name):
                true += [self._true_pose(name, int(number)) for number in numbers]
                found += agent.trajectory(name)[1].tolist()
        truth, estimated = np.array(true), np.array(found)
        if not is_surveyed:
            start = self._paths[NAMES[0]][0]
            estimated = compose(np.asarray(start), estimated)
        wrong = [
            is_wrong(
                self._true_pose(owners[a], a).between(self._true_pose(owners[b], b)), closure.pose
            )
            for (a, b), closure in self._closures.items()
        ]
        joins = agent.take_joins()
        false_joins = [
            is_wrong(
                self._paths[join.other][round(join.other_stamp / PERIOD)].between(
                    self._paths[join.vehicle][round(join.stamp / PERIOD)]
                ),
                join.relative,
            )
            for join in joins
        ]
        offset, turn = frame_error(truth, estimated)
        return {
            'closures': len(self._closures) + len(self._ties),
            'tag_closures': len(self._ties),
            'false_closures': sum(wrong) + sum(self._ties.values()),
            'joined_after_m': joins[0].distance_driven if joins else math.nan,
            'false_joins': sum(false_joins),
            'frame_m': offset,
            'frame_deg': math.degrees(turn),
            'error_m': float(np.hypot(*(truth - estimated)[:, :2].T).mean()),
        }


def frame_error(true: Array, estimated: Array) -> tuple[float, float]:
    """Return by how much (m, rad) a rigid motion moves estimated poses (n, 3) to the true ones.

    The motion fits the positions best (least squares); its translation is that of their centre.
    """
    p, q = estimated[:, :2], true[:, :2]
    centre, goal = p.mean(axis=0), q.mean(axis=0)
    a, b = p - centre, q - goal
    turn = math.atan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
    return math.dist(centre, goal), abs(wrap_angle(turn))


def run_study(study: TagStudy, workers: Workers = ALONE) -> Iterator[TagRun]:
    """Yield the run of every world, in order."""
    yield from make_runs(run_world, [(study, seed) for seed in study.worlds], workers)


HEADER = (
    'world', 'period (m)', 'drift (m)', 'tags seen', 'misread', 'closures', 'of tags', 'false',
    'joined after (m)', 'false joins', 'frame (m)', 'frame (°)', 'error (m)', 'seconds',
)  # fmt: skip


def markdown_table(runs: Sequence[TagRun]) -> str:
    """Return the table of a study, one row per world, and sums and largest errors."""
    rows: list[tuple[str, ...]] = [
        (
            str(run.world),
            f'{run.period_m:g}',
            f'{run.drift_m:.2f}',
            str(run.tags),
            str(run.misread),
            str(run.closures),
            str(run.tag_closures),
            str(run.false_closures),
            '-' if math.isnan(run.joined_after_m) else f'{run.joined_after_m:.1f}',
            str(run.false_joins),
            f'{run.frame_m:.3f}',
            f'{run.frame_deg:.3f}',
            f'{run.error_m:.3f}',
            f'{run.seconds:.1f}',
        )
        for run in runs
    ]
    names = ('tags', 'misread', 'closures', 'tag_closures', 'false_closures', 'false_joins')
    total = {name: str(sum(getattr(run, name) for run in runs)) for name in names}
    largest = [max(getattr(run, name) for run in runs) for name in ('frame_m', 'frame_deg')]
    joined = sum(not math.isnan(run.joined_after_m) for run in runs)
    rows.append(
        (
            'all, largest', '', '', *(total[name] for name in names[:5]),
            f'{joined} of {len(runs)}', total['false_joins'],
            f'{largest[0]:.3f}', f'{largest[1]:.3f}',
            f'{max(run.error_m for run in runs):.3f}', '',
        )
    )  # fmt: skip
    return tables.markdown_table(HEADER, rows) + '\n'


def save_study(study: TagStudy, runs: Sequence[TagRun], folder: Path) -> Path:
    """Write tags.json into a folder; return its path. A figure that is not finite is null."""
    content = {
        'surveyed': study.surveyed,
        'misread': study.misread,
        'settings': dict(study.settings),
        'runs': [run._asdict() for run in runs],
    }
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / 'tags.json'
    tables.write_json(path, content)
    return path
