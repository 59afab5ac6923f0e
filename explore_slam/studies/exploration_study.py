"""Exploration studies: strategies, team sizes and seeds, run by several workers."""

import functools
import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from explore_slam import agent, exploration, mapping, simulation
from explore_slam.agent import AgentConfig
from explore_slam.errors import EvaluationError
from explore_slam.exploration import ExplorationConfig
from explore_slam.settings import values_of, with_values
from explore_slam.simulation.config import SimulatedOdometryConfig
from explore_slam.simulation.grid.grid_simulator import GridSimulatorConfig
from explore_slam.simulation.grid.scenario import Scenario, load_scenario
from explore_slam.simulation.worlds.grid_world import GridWorld
from explore_slam.simulation.worlds.loading import load_grid_world
from explore_slam.studies.exploration_run import (
    ExplorationRun,
    SlamSettings,
    StudyConfig,
    explore,
)
from explore_slam.studies.parallel import ALONE, Workers, make_runs

logger = logging.getLogger(__name__)

START_SPACING = 0.9  # m between the centres of usual vehicles; that of two is vehicle_separation
# s between scans with SLAM, unless given: an LMS 200 sends 361 ranges in 0.19 s at 38400 Bd. Where
# poses are known, nothing is matched and fewer scans do.
SLAM_SCAN_PERIOD = 0.2
# settings that vehicles have of their own: all but the clock, and the errors that the study sets
_OF_VEHICLES = values_of(GridSimulatorConfig()).keys() - {
    'time_step', 'position_noise', 'heading_noise',
}  # fmt: skip
_OF_PLANNER = values_of(ExplorationConfig()).keys()
_OF_ODOMETRY = values_of(SimulatedOdometryConfig()).keys()
# settings that have an effect with SLAM only, and without it only
_OF_SLAM = values_of(AgentConfig()).keys() - _OF_PLANNER | _OF_ODOMETRY
_OF_KNOWN_POSES = {'position_error', 'heading_error'}


@dataclass(frozen=True)
class Study:
    """Definition of a study: every strategy with every team size and every seed.

    slam: settings of the whole agent, which then runs; None: poses are known.
    """

    map_path: Path
    team_sizes: Sequence[int]
    strategies: Sequence[str]
    seeds: Sequence[int]
    config: StudyConfig = field(default_factory=StudyConfig)
    planner_settings: Mapping[str, Any] = field(default_factory=dict)
    scenario_path: Path | None = None
    vehicle_settings: Mapping[str, Any] = field(default_factory=dict)
    own_settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    slam: SlamSettings | None = None

    def vehicle_configs(self, size: int) -> tuple[GridSimulatorConfig, dict[str, Any]]:
        """Return the settings of all vehicles of a team, and those of vehicles that differ.

        Where disc_radius differs, reach_clearance does as much, unless it is given.
        """
        config = with_values(GridSimulatorConfig(), self.vehicle_settings)
        own = {}
        for name, values in self.own_settings.items():
            if name in vehicle_names(size):
                made = with_values(config, values)
                larger = made.disc_radius - config.disc_radius
                clearance = {'reach_clearance': config.reach_clearance + larger}
                own[name] = with_values(config, clearance | dict(values))
        return config, own

    def scenario(self, size: int) -> Scenario:
        """Read the scenario for a team; SimulationError if it does not fit world and vehicles."""
        if self.scenario_path is None:
            return Scenario()
        return load_scenario(self.scenario_path, _world(self.map_path), vehicle_names(size))

    def tasks(self) -> Iterator[tuple[str, int, int]]:
        """Yield strategy, team size and seed of every run."""
        for seed in self.seeds:
            for size in sorted(self.team_sizes):
                for strategy in self.strategies:
                    yield strategy, size, seed

    def run_one(self, strategy: str, size: int, seed: int) -> ExplorationRun:
        """Make one run; the seed determines the start poses and all noise."""
        world = _world(self.map_path)
        config, own = self.vehicle_configs(size)
        every = [config, *own.values()]
        radius = max(one.reach_clearance for one in every)
        spacing = START_SPACING + 2.0 * max(one.disc_radius - config.disc_radius for one in every)
        poses = world.start_poses(size, seed, radius, spacing)
        starts = dict(zip(vehicle_names(size), poses, strict=True))
        scenario = self.scenario(size)
        settings = self.planner_settings
        run = explore(
            world, starts, strategy, seed, self.config, settings, config, scenario, own, self.slam
        )
        logger.info(
            '%s, %d vehicles, seed %d: %s after %.0f s, 99 %% after %.0f s, %.0f x real time',
            strategy, size, seed, run.status, run.duration, run.curve.time_to(0.99),
            run.real_time_factor,
        )  # fmt: skip
        return run


def vehicle_names(size: int) -> list[str]:
    """Return the names of the vehicles of a team."""
    return [f'robot{index + 1}' for index in range(size)]


def make_study(
    map_path: Path,
    team_sizes: Sequence[int],
    strategies: Sequence[str],
    seeds: Sequence[int],
    changes: Sequence[str] = (),
    scenario: Path | None = None,
    slam: bool = False,
) -> Study:
    """Make a study of plain values.

    changes: 'name=value' of settings of study, planner and vehicles, 'robot2.name=value' of those
    of one vehicle. scenario: file with events. slam: let the whole agent run, which has settings
    as well, and measures its motion by simulated wheel odometry.
    """
    for name, values in (('vehicles', team_sizes), ('strategies', strategies), ('seeds', seeds)):
        if not values:
            raise EvaluationError(f'study: no {name}, expected at least one')
    if min(team_sizes) < 1:
        raise EvaluationError(f'study: team of {min(team_sizes)} vehicles, expected at least 1')
    given = _settings_of(changes, vehicle_names(max(team_sizes)), slam)
    for strategy in strategies:  # refuse a wrong setting or strategy at once
        with_values(ExplorationConfig(), given.planner | {'strategy': strategy})
    with_values(AgentConfig(), given.agent)
    usual = {'scan_period': SLAM_SCAN_PERIOD} if slam else {}
    config = with_values(StudyConfig(), usual | given.study)
    odometry = with_values(SimulatedOdometryConfig(), given.odometry)
    study = Study(
        map_path, team_sizes, strategies, seeds, config, given.planner, scenario,
        given.vehicles, given.own, SlamSettings(given.agent, odometry) if slam else None,
    )  # fmt: skip
    study.vehicle_configs(max(team_sizes))  # refuse wrong values
    return study


class _Settings(NamedTuple):
    """Settings by name: of study, planner, all vehicles, single vehicles, agent and odometry."""

    study: dict[str, Any]
    planner: dict[str, Any]
    vehicles: dict[str, Any]
    own: dict[str, dict[str, Any]]
    agent: dict[str, Any]
    odometry: dict[str, Any]


def _settings_of(changes: Sequence[str], vehicles: Sequence[str], slam: bool) -> _Settings:
    """Sort 'name=value' and 'vehicle.name=value'; EvaluationError for what cannot be."""
    given = _Settings({}, {}, {}, {}, {}, {})
    for change in changes:
        name, equals, text = change.partition('=')
        if not equals:
            raise EvaluationError(f'study: {change!r}, expected name=value')
        value = yaml.safe_load(text)
        vehicle, dot, leaf = name.partition('.')
        if name in (_OF_KNOWN_POSES if slam else _OF_SLAM):
            raise EvaluationError(
                f'study: {change!r} has no effect {"with" if slam else "without"} --slam'
            )
        if not dot and name in values_of(StudyConfig()):
            given.study[name] = value
        elif not dot:
            _group_of(name, given)[name] = value
        elif vehicle not in vehicles:
            raise EvaluationError(f'study: {change!r}, expected one of the vehicles {vehicles}')
        elif leaf not in _OF_VEHICLES:
            raise EvaluationError(f'study: {change!r}, expected one of {sorted(_OF_VEHICLES)}')
        else:
            given.own.setdefault(vehicle, {})[leaf] = value
    return given


def _group_of(name: str, given: _Settings) -> dict[str, Any]:
    """Return the settings to which one that is not of the study belongs."""
    if name in _OF_VEHICLES:
        return given.vehicles
    if name in _OF_ODOMETRY:
        return given.odometry
    return given.agent if name in _OF_SLAM else given.planner


_WORLDS: dict[Path, GridWorld] = {}


def _world(path: Path) -> GridWorld:
    """Return the world of a file, read once per process."""
    if path not in _WORLDS:
        _WORLDS[path] = load_grid_world(path)
    return _WORLDS[path]


@functools.cache
def warm_up() -> None:
    """Compile all kernels of a run, once per process: it does not count as planning time."""
    for package in (simulation, mapping, exploration):
        package.warm_up()


@functools.cache
def warm_up_agent() -> None:
    """Compile all kernels of the agent, once per process."""
    agent.warm_up()


def _run_task(study: Study, strategy: str, size: int, seed: int) -> ExplorationRun:
    warm_up()
    if study.slam is not None:
        warm_up_agent()
    return study.run_one(strategy, size, seed)


def run_study(study: Study, workers: Workers = ALONE) -> Iterator[ExplorationRun]:
    """Yield the runs of a study in order.

    On a cluster, all machines read map and scenario from the same paths.
    """
    for size in study.team_sizes:  # refuse files that cannot be read, or do not fit, at once
        _world(study.map_path)
        study.scenario(size)
    tasks = [(study, *task) for task in study.tasks()]
    yield from make_runs(_run_task, tasks, workers)
