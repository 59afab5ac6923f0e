"""Paths in the simulated office and settings of the filter for experiments 2, 3 and 4."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from explore_slam.settings import with_values
from explore_slam.simulation import world_path
from explore_slam.slam import FastSlamConfig
from explore_slam.studies.experiments.kinect_walks import (
    Walk,
    record_walk,
    scenario_of,
)
from explore_slam.studies.experiments.trials import FilterEstimator, Trial, run_trial

Corners = tuple[tuple[float, float], ...]

ENGINES = ('paper', 'fastslam2')
# Corners (m) in config/worlds/office.yaml, which has the size of the building of the paper.
CORRIDOR: Corners = ((1.0, 5.25), (11.0, 5.25))  # 10 m, experiment 2
_A, _B, _C, _D = (1.9, 7.1), (3.9, 7.1), (3.9, 9.1), (1.9, 9.1)  # a square in a room
ROUNDS: Corners = (_A, _B, _C, _D, _A, _B, _C, _D, _A)  # two rounds in 16 steps, experiment 3
TEAM: dict[str, Corners] = {  # 13 steps each, experiment 4: half a round apart
    'robot1': (_A, _B, _C, _D, _A, _B, _C, (2.9, 9.1)),
    'robot2': (_C, _D, _A, _B, _C, _D, _A, (2.9, 7.1)),
}
STEP = 1.0  # m, as in the paper


@dataclass(frozen=True)
class WalkOptions:
    """Seeds of the odometry noise, particles of both engines, world file (default: the office)."""

    seeds: Sequence[int] = tuple(range(5))
    particles: int = 1000
    world: Path | None = None


def record(options: WalkOptions, paths: dict[str, Corners]) -> list[Walk]:
    """Drive each path alone in the world and return the recorded stops."""
    world = options.world or world_path('office')
    return [record_walk(world, name, corners, STEP) for name, corners in paths.items()]


def run_walks(
    walks: Sequence[Walk], seed: int, particles: int, values: dict[str, Any]
) -> tuple[Trial, FilterEstimator]:
    """Run a filter with the given settings on recorded paths with the odometry noise of a seed.

    Engine paper uses the observation noise of table I, fastslam2 that of the Kinect.
    """
    config = with_values(FastSlamConfig(), {'particles': particles} | values)
    scenario = scenario_of(walks, seed, table_one=config.engine == 'paper')
    estimator = FilterEstimator(scenario.start_poses, config, seed)
    return run_trial(scenario, estimator), estimator
