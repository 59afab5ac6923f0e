"""Consistency study: published covariances against errors in closed loops over several seeds.

Every run is a closed loop without ROS. Runs of different seeds are made in parallel processes;
results are written as runs end.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from explore_slam.errors import EvaluationError
from explore_slam.results import tables
from explore_slam.results.consistency import EstimationErrors, estimation_errors
from explore_slam.results.plots import color_of
from explore_slam.results.run_data import RunData, VehicleRun
from explore_slam.results.run_folder import RunFolder
from explore_slam.settings import with_values
from explore_slam.studies.closed_loop import ClosedLoop, ClosedLoopConfig
from explore_slam.studies.figures import new_figure
from explore_slam.studies.parallel import ALONE, Workers, make_runs

# Vision in the agent, or none: vehicles without camera, localized by laser and odometry alone.
VISION = ('agent', 'none')
# 2.5 %, mean and 97.5 % of the chi-square distribution with three degrees of freedom.
POSE_NEES_RANGE = (0.216, 3.0, 9.348)


@dataclass(frozen=True)
class ConsistencyStudy:
    """Definition of a study; settings: of ClosedLoopConfig by name."""

    world: Path
    vehicles: int = 2
    vision: str = 'agent'
    duration: float = 300.0
    seeds: Sequence[int] = tuple(range(5))
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.vision not in VISION:
            raise EvaluationError(f'vision is {self.vision!r}, expected one of {list(VISION)}')
        if not self.seeds:
            raise EvaluationError('consistency study: no seeds, expected at least one')
        self.config()  # refuse a wrong setting before the first run

    def config(self) -> ClosedLoopConfig:
        """Return the configuration of its runs."""
        values = dict(self.settings) | {'time_limit': self.duration}
        if self.vision == 'none':
            values['simulated_camera_rate'] = 0.0
        return with_values(ClosedLoopConfig(), values)


@dataclass(frozen=True)
class ConsistencyRun:
    """Figures of one vehicle in one run; NaN where there is no ground truth or no path.

    position_rms: of the online pose (m). best_path_rms: of the most likely path at
    the end (m). duration: simulated time of the run (s). See results.consistency for the others.
    """

    seed: int
    vehicle: str
    pose_nees_mean: float
    pose_nees_median: float
    position_nees_mean: float
    position_in_95: float
    position_rms: float
    best_path_rms: float
    duration: float

    @classmethod
    def of(cls, seed: int, run: VehicleRun, duration: float) -> 'ConsistencyRun':
        """Take the figures of a vehicle from the metrics of its run."""
        metrics = run.metrics()
        online, path = metrics.get('online') or {}, metrics.get('estimated') or {}
        return cls(
            seed=seed,
            vehicle=run.name,
            pose_nees_mean=online.get('pose_nees_mean', math.nan),
            pose_nees_median=online.get('pose_nees_median', math.nan),
            position_nees_mean=online.get('position_nees_mean', math.nan),
            position_in_95=online.get('position_in_95', math.nan),
            position_rms=online.get('position_rms', math.nan),
            best_path_rms=path.get('position_rms', math.nan),
            duration=duration,
        )


@dataclass(frozen=True)
class SeedResult:
    """Results of all vehicles with one seed, and the errors over time by vehicle."""

    seed: int
    runs: list[ConsistencyRun]
    errors: dict[str, EstimationErrors]


def run_seed(study: ConsistencyStudy, seed: int, output: Path) -> SeedResult:
    """Make the run of one seed and write its run folder, `output/seed_N`."""
    loop = ClosedLoop(study.world, study.config(), study.vehicles, seed)
    data = loop.run()
    folder = output / f'seed_{seed}'
    folder.mkdir(parents=True, exist_ok=True)
    RunFolder(folder).write_run(data)
    return seed_result(seed, data)


def seed_result(seed: int, data: RunData) -> SeedResult:
    """Return the results of a run."""
    duration = float(data.metrics['duration'])
    return SeedResult(
        seed,
        [ConsistencyRun.of(seed, run, duration) for run in data.vehicles],
        {run.name: estimation_errors(run.estimates, run.truth) for run in data.vehicles},
    )


def run_study(
    study: ConsistencyStudy, output: Path, workers: Workers = ALONE
) -> Iterator[SeedResult]:
    """Yield the results of each seed in order; consistency.json and plots grow with them.

    On a cluster, all machines read the world from the same path and write their runs to the same
    output folder.
    """
    output.mkdir(parents=True, exist_ok=True)
    results: list[SeedResult] = []
    for result in make_runs(run_seed, [(study, seed, output) for seed in study.seeds], workers):
        results.append(result)
        save_results(study, results, output)
        yield result


def save_results(study: ConsistencyStudy, results: Sequence[SeedResult], output: Path) -> Path:
    """Write consistency.json and nees.png; return the path of the former.

    A figure that is not finite (NEES of a singular covariance) becomes null.
    """
    runs = [asdict(run) for result in results for run in result.runs]
    content = {
        'world': str(study.world),
        'vehicles': study.vehicles,
        'vision': study.vision,
        'duration': study.duration,
        'settings': dict(study.settings),
        'runs': runs,
    }
    path = output / 'consistency.json'
    tables.write_json(path, content)
    plot_nees(results, output / 'nees.png')
    return path


HEADER = (
    'seed', 'vehicle', 'pose NEES mean', 'median', 'position NEES mean', 'inside 95 %',
    'position RMS (m)', 'best path RMS (m)',
)  # fmt: skip


def markdown_table(runs: Sequence[ConsistencyRun]) -> str:
    """Return the table of a study; expected are NEES 3 and 2, and 0.95 inside."""
    rows = [
        (
            str(run.seed),
            run.vehicle,
            f'{run.pose_nees_mean:.2f}',
            f'{run.pose_nees_median:.2f}',
            f'{run.position_nees_mean:.2f}',
            f'{run.position_in_95:.2f}',
            f'{run.position_rms:.4f}',
            f'{run.best_path_rms:.4f}',
        )
        for run in runs
    ]
    return tables.markdown_table(HEADER, rows) + '\n'


def plot_nees(results: Sequence[SeedResult], path: Path) -> None:
    """Plot the NEES of the pose over time, one panel per vehicle, with its 95 % interval."""
    vehicles = list(dict.fromkeys(name for result in results for name in result.errors))
    figure, axes = new_figure(rows=len(vehicles), width=9.0, height=2.8)
    low, mean, high = POSE_NEES_RANGE
    for axis, vehicle in zip(axes.flat, vehicles, strict=True):
        for index, result in enumerate(results):
            errors = result.errors.get(vehicle)
            if errors is None or not len(errors):
                continue
            values = errors.pose_nees
            shown = np.isfinite(values)
            axis.plot(
                errors.stamps[shown],
                values[shown],
                color=color_of(index),
                linewidth=0.8,
                label=f'seed {result.seed}',
            )
        axis.axhspan(low, high, color='#000000', alpha=0.07, linewidth=0)
        axis.axhline(mean, color='#000000', linewidth=0.8, linestyle='--')
        axis.set(title=vehicle, xlabel='time (s)', ylabel='NEES of the pose', yscale='log')
        if axis.get_legend_handles_labels()[0]:
            axis.legend(loc='upper left', ncols=5, fontsize=8)
    figure.savefig(path, dpi=110)
