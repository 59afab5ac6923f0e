"""False closures and false joins where rooms are equal: drives through twin corridors.

Wheel odometry drifts by up to half a period of the rooms over a corridor, so that the next room is
as near as the right one. One vehicle laps the corridors; a second one starts in the middle of the
second corridor, where nothing but equal rooms is in sight.
"""

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from explore_slam.agent import Agent, AgentConfig, warm_up
from explore_slam.data import LaserScan, OdometryReading
from explore_slam.errors import EvaluationError
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.results import tables
from explore_slam.settings import with_values
from explore_slam.simulation.worlds.twin_corridors import (
    SECOND,
    TwinCorridors,
    along,
    twin_corridors,
)
from explore_slam.studies.parallel import ALONE, Workers, make_runs

STARTS = ('known', 'unknown')
PERIOD = 0.5  # s between scans
STEP, TURN = 0.25, 0.35  # m, rad between scans
FIELD_OF_VIEW, BEAMS, RANGE = math.pi, 181, 20.0  # rad, number, m: a SICK LMS200 indoors
RANGE_DEVIATION = 0.01  # m
# Noise of wheel odometry beside the scale error: deviations per scan (m, m, rad).
WHEEL_DEVIATIONS = np.array([0.003, 0.002, 0.003])
# What is off by more is false: a wrong room is 3 m off, a slide along a wall 0.5 m and more.
WRONG = (0.6, 0.1)  # m, rad
END_REACH = 2.0  # m from a lobby, within which a closure counts as one of the corridors' end
NAMES = ('robot1', 'robot2')


@dataclass(frozen=True)
class TwinStudy:
    """Definition of a study; settings: of AgentConfig by name."""

    worlds: Sequence[int] = tuple(range(12))
    vehicles: int = 1
    starts: str = 'known'
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.worlds:
            raise EvaluationError('twin study: no worlds, expected at least one')
        if self.vehicles not in (1, 2):
            raise EvaluationError(f'twin study: vehicles is {self.vehicles}, expected 1 or 2')
        if self.starts not in STARTS:
            raise EvaluationError(
                f'twin study: starts is {self.starts!r}, expected one of {list(STARTS)}'
            )
        if self.starts == 'unknown' and self.vehicles == 1:
            raise EvaluationError('twin study: unknown starts need 2 vehicles')
        self.config()

    def config(self) -> AgentConfig:
        """Return the settings of the agent; ConfigError for a wrong one."""
        return with_values(AgentConfig(), {'laser_x': 0.0, **self.settings})


class TwinRun(NamedTuple):
    """Figures of a run.

    drift_m: of the odometry over a corridor. ends_revisited: lobbies that a vehicle came back to;
    ends_closed: those with a correct closure. joined_after_m: distance driven by the second
    vehicle when a closure first tied it to the first one, NaN if none did. error_m: mean distance
    of all keyframes in the map from the truth.
    """

    world: int
    period_m: float
    drift_m: float
    closures: int
    false_closures: int
    ends_revisited: int
    ends_closed: int
    joined_after_m: float
    false_joins: int
    error_m: float
    seconds: float


class TwinVehicle:
    """A vehicle on a given path, with wheel odometry and laser."""

    def __init__(self, world: TwinCorridors, path: list[Pose2], scale: float, seed: int) -> None:
        self.world, self.path, self.scale = world, path, scale
        self.random = np.random.default_rng(seed)
        self.wheels = IDENTITY

    def records(self, tick: int) -> tuple[OdometryReading, LaserScan]:
        """Return the odometry and the scan of a tick."""
        true, stamp = self.path[tick], PERIOD * tick
        if tick:
            u = np.asarray(self.path[tick - 1].between(true))
            u[:2] *= self.scale
            u += WHEEL_DEVIATIONS * self.random.normal(size=3)
            self.wheels = self.wheels.compose(Pose2.from_array(u))
        angles = np.linspace(-0.5 * FIELD_OF_VIEW, 0.5 * FIELD_OF_VIEW, BEAMS)
        ranges = self.world.ranges(true, angles) + RANGE_DEVIATION * self.random.normal(size=BEAMS)
        ranges[ranges > RANGE] = np.inf
        scan = LaserScan(
            stamp, angles[0], angles[1] - angles[0], ranges.astype(np.float32), 0.0, RANGE
        )
        return OdometryReading(stamp, self.wheels), scan


def run_world(study: TwinStudy, seed: int) -> TwinRun:
    """Drive through the world of a seed and count what was closed and joined."""
    warm_up()
    begin = time.perf_counter()
    world = twin_corridors(seed)
    random = np.random.default_rng((seed, 1))
    drift = random.uniform(-0.5, 0.5) * world.period
    vehicles = {
        name: TwinVehicle(world, path, 1.0 + drift / world.length, seed + 1000 * number)
        for number, (name, path) in enumerate(team_paths(world).items())
        if number < study.vehicles
    }
    poses: dict[str, Pose2 | None] = {name: item.path[0] for name, item in vehicles.items()}
    if study.starts == 'unknown':
        poses[NAMES[1]] = None
    agent = Agent(study.config(), poses, seed)
    closures: dict[tuple[int, int], Any] = {}
    for tick in range(max(len(item.path) for item in vehicles.values())):
        for name, item in vehicles.items():
            if tick < len(item.path):
                for record in item.records(tick):
                    agent.add(name, record)
        for closure in agent.loops.search.closures:
            closures.setdefault((closure.keyframe_a, closure.keyframe_b), closure)
    paths = {name: item.path for name, item in vehicles.items()}
    return _judged(agent, world, paths, closures, drift, time.perf_counter() - begin)


def team_paths(world: TwinCorridors) -> dict[str, list[Pose2]]:
    """Return a lap and three quarters, and a lap from the middle of the second corridor."""
    west, east, back, home = world.ring()
    middle = (0.5 * world.length, SECOND)
    first = [
        (west[0], 0.75 * SECOND),
        west,
        east,
        back,
        home,
        west,
        east,
        (east[0], 0.75 * SECOND),
    ]
    second = [middle, home, west, east, back, middle]
    return {
        name: along(corners, STEP, TURN)
        for name, corners in zip(NAMES, (first, second), strict=True)
    }


def _judged(
    agent: Agent,
    world: TwinCorridors,
    paths: Mapping[str, list[Pose2]],
    closures: Mapping[tuple[int, int], Any],
    drift: float,
    seconds: float,
) -> TwinRun:
    """Compare closures, joins and paths with the truth."""
    true: dict[int, tuple[str, Pose2]] = {}
    errors: list[float] = []
    for name in agent.vehicles:
        stamps, estimated = agent.trajectory(name)
        numbers = agent.belief.keyframes_of(name)
        for number, stamp, pose in zip(numbers, stamps, estimated, strict=True):
            at = paths[name][round(stamp / PERIOD)]
            true[int(number)] = name, at
            if agent.is_in_map(name):
                errors.append(math.dist(at[:2], pose[:2]))
    false, closed = 0, set()
    for (a, b), closure in closures.items():
        (owner_a, pose_a), (owner_b, pose_b) = true[a], true[b]
        if is_wrong(pose_a.between(pose_b), closure.pose):
            false += 1
        elif owner_a == owner_b:
            closed.add((owner_a, world.near_end(pose_b.x, END_REACH)))
    revisited = {
        (name, end) for name, path in paths.items() for end in _revisited_ends(world, path)
    }
    joins = agent.take_joins()
    wrong = [
        join
        for join in joins
        if is_wrong(
            paths[join.other][round(join.other_stamp / PERIOD)].between(
                paths[join.vehicle][round(join.stamp / PERIOD)]
            ),
            join.relative,
        )
    ]
    return TwinRun(
        world=agent.seed,
        period_m=world.period,
        drift_m=drift,
        closures=len(closures),
        false_closures=false,
        ends_revisited=len(revisited),
        ends_closed=len(revisited & closed),
        joined_after_m=joins[0].distance_driven if joins else math.nan,
        false_joins=len(wrong),
        error_m=float(np.mean(errors)),
        seconds=seconds,
    )


def is_wrong(true: Pose2, found: Pose2) -> bool:
    """Return whether a relative pose that was found is off by more than WRONG."""
    off = true.between(found)
    return math.hypot(off.x, off.y) > WRONG[0] or abs(off.theta) > WRONG[1]


def _revisited_ends(world: TwinCorridors, path: Sequence[Pose2]) -> set[int]:
    """Return the lobbies that a path leads to twice or more."""
    visits = [world.near_end(pose.x, 0.0) for pose in path]
    entered = [
        end
        for before, end in zip([None, *visits[:-1]], visits, strict=True)
        if end is not None and end != before
    ]
    return {end for end in entered if entered.count(end) > 1}


def run_study(study: TwinStudy, workers: Workers = ALONE) -> Iterator[TwinRun]:
    """Yield the run of every world, in order."""
    yield from make_runs(run_world, [(study, seed) for seed in study.worlds], workers)


HEADER = (
    'world', 'period (m)', 'drift (m)', 'closures', 'false', 'ends closed', 'joined after (m)',
    'false joins', 'error (m)', 'seconds',
)  # fmt: skip


def markdown_table(runs: Sequence[TwinRun]) -> str:
    """Return the table of a study, one row per world, and the sums."""
    rows = [
        (
            str(run.world),
            f'{run.period_m:g}',
            f'{run.drift_m:.2f}',
            str(run.closures),
            str(run.false_closures),
            f'{run.ends_closed} of {run.ends_revisited}',
            '-' if math.isnan(run.joined_after_m) else f'{run.joined_after_m:.1f}',
            str(run.false_joins),
            f'{run.error_m:.3f}',
            f'{run.seconds:.1f}',
        )
        for run in runs
    ]
    total = {
        name: sum(getattr(run, name) for run in runs)
        for name in ('closures', 'false_closures', 'ends_closed', 'ends_revisited', 'false_joins')
    }
    joined = sum(not math.isnan(run.joined_after_m) for run in runs)
    rows.append(
        (
            'all',
            '',
            '',
            str(total['closures']),
            str(total['false_closures']),
            f'{total["ends_closed"]} of {total["ends_revisited"]}',
            f'{joined} of {len(runs)}',
            str(total['false_joins']),
            '',
            '',
        )
    )
    return tables.markdown_table(HEADER, rows) + '\n'


def save_study(study: TwinStudy, runs: Sequence[TwinRun], folder: Path) -> Path:
    """Write twins.json into a folder; return its path. A figure that is not finite is null."""
    content = {
        'vehicles': study.vehicles,
        'starts': study.starts,
        'settings': dict(study.settings),
        'runs': [run._asdict() for run in runs],
    }
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / 'twins.json'
    tables.write_json(path, content)
    return path
