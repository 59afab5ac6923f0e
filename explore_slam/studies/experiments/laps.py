"""Many laps of the crossing paths of experiment 1: accuracy, consistency, and what grows.

Two vehicles drive the same two loops again and again. An exact estimator is as accurate as iSAM2,
its normalized estimation error squared (NEES) has a mean of 3, and what a lap costs does not
depend on how many have been driven before.
"""

import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from explore_slam.geometry import Array, wrap_angle
from explore_slam.results.consistency import CHI_SQUARE_95_2D, nees
from explore_slam.settings import with_values
from explore_slam.slam import FastSlamConfig
from explore_slam.studies.experiments.experiment1 import UNIQUE_DESCRIPTORS
from explore_slam.studies.experiments.scenarios import Scenario, draw_scenario
from explore_slam.studies.experiments.tables import ExperimentReport, Table, spread
from explore_slam.studies.experiments.trials import FilterEstimator, SmootherEstimator, rms
from explore_slam.studies.figures import COLORS, new_figure
from explore_slam.studies.parallel import ALONE, Workers, make_runs

logger = logging.getLogger(__name__)

SCENE = 'crossing'


@dataclass(frozen=True)
class Options:
    """Seeds of data and filter, numbers of laps, particles, iSAM2 or not."""

    seeds: Sequence[int] = tuple(range(10))
    laps: Sequence[int] = (4, 20)
    particles: int = 500
    isam2: bool = True


@dataclass
class Run:
    """One estimator on one scenario, a row for each step of each vehicle.

    errors (m, m, rad) and covariances (3, 3) of the online estimate; seconds of the step; sizes:
    keyframes and landmark observations in the joint graph after it, zero for iSAM2.
    """

    errors: list[Array] = field(default_factory=list)
    covariances: list[Array] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    sizes: list[tuple[int, int]] = field(default_factory=list)

    @property
    def position_rms(self) -> float:
        """RMS position error (m)."""
        return rms(np.hypot(*np.array(self.errors)[:, :2].T))

    @property
    def pose_nees(self) -> float:
        """Mean NEES of the pose, expected 3."""
        return float(nees(np.array(self.errors), np.array(self.covariances)).mean())

    @property
    def position_in_95(self) -> float:
        """Share of the positions inside their 95 % ellipse."""
        errors, covariances = np.array(self.errors), np.array(self.covariances)
        squares = nees(errors[:, :2], covariances[:, :2, :2])
        return float(np.mean(squares <= CHI_SQUARE_95_2D))

    def by_lap(self, laps: int) -> Array:
        """Return (laps, 3): at the end of each lap keyframes and observations, median seconds."""
        sizes = np.array(self.sizes).reshape(laps, -1, 2)[:, -1]
        seconds = np.median(np.array(self.seconds).reshape(laps, -1), axis=1)
        return np.column_stack([sizes, seconds])


def run(options: Options | None = None, workers: Workers = ALONE) -> ExperimentReport:
    """Run the filter, and iSAM2 on the same data, over all numbers of laps and all seeds."""
    options = options or Options()
    tasks = [(options, laps, seed) for laps in options.laps for seed in options.seeds]
    runs: dict[tuple[int, str], list[Run]] = {}
    for (_, laps, seed), found in zip(tasks, make_runs(_run_seed, tasks, workers), strict=True):
        for method, done in found.items():
            runs.setdefault((laps, method), []).append(done)
        logger.info(
            'laps: %d laps, seed %d: %s', laps, seed,
            {
                method: (round(done.position_rms, 4), round(done.pose_nees, 2))
                for method, done in found.items()
            },
        )  # fmt: skip
    return _report(options, runs)


def _run_seed(options: Options, laps: int, seed: int) -> dict[str, Run]:
    """Run the filter and iSAM2 on one scenario; the key is the method."""
    scenario = draw_scenario(SCENE, seed, laps=laps)
    found = {'fastslam2': follow(scenario, _filter(scenario, options, seed))}
    if options.isam2:
        found['iSAM2'] = follow(scenario, SmootherEstimator(scenario.start_poses, 'common'))
    return found


def _filter(scenario: Scenario, options: Options, seed: int) -> FilterEstimator:
    values = {
        'particles': options.particles,
        'maximum_descriptor_distance': UNIQUE_DESCRIPTORS,
        'correlated_observations': False,  # the errors of these observations are independent
    }
    return FilterEstimator(scenario.start_poses, with_values(FastSlamConfig(), values), seed)


def follow(scenario: Scenario, estimator: FilterEstimator | SmootherEstimator) -> Run:
    """Run an estimator on a scenario; its online estimate is compared with truth at each step."""
    found = Run()
    for step in scenario.steps:
        began = time.perf_counter()
        estimator.predict(step.vehicle, step.increment, step.covariance)
        if len(step.observations):
            estimator.update(step.vehicle, step.observations, step.identities)
        found.seconds.append(time.perf_counter() - began)
        pose, covariance = estimator.estimate(step.vehicle)
        error = np.subtract(pose, step.true_pose)
        error[2] = wrap_angle(error[2])
        found.errors.append(error)
        found.covariances.append(covariance)
        found.sizes.append(_graph_size(estimator))
    return found


def _graph_size(estimator: FilterEstimator | SmootherEstimator) -> tuple[int, int]:
    if isinstance(estimator, SmootherEstimator) or estimator.belief.filters[0].joint is None:
        return 0, 0
    graph = estimator.belief.filters[0].joint.graph
    vehicles = range(len(estimator.belief.vehicles))
    return len(graph.live_keyframes()), len(graph.observations_from(vehicles)[1].z)


def _report(options: Options, runs: dict[tuple[int, str], list[Run]]) -> ExperimentReport:
    report = ExperimentReport(
        f'Laps of the crossing paths: {len(options.seeds)} seeds, {options.particles} particles'
    )
    report.tables.append(_accuracy_table(runs))
    report.tables += [_growth_table(laps, runs[laps, 'fastslam2']) for laps in options.laps]
    report.figures['growth'] = _growth_figure(options, runs)
    report.metrics = {
        f'{laps} laps/{method}': {
            'position_rms': float(np.mean([run.position_rms for run in of])),
            'position_rms_of_seeds': [run.position_rms for run in of],
            'pose_nees_of_seeds': [run.pose_nees for run in of],
            'position_in_95_of_seeds': [run.position_in_95 for run in of],
            'keyframes_observations_seconds_of_laps': np.mean(
                [run.by_lap(laps) for run in of], axis=0
            ).tolist(),
        }
        for (laps, method), of in runs.items()
    }
    report.remarks = [
        'online estimate after each step; noise of table I, covariances at the true ranges',
        'NEES of the pose, expected 3; inside the 95 % ellipse of the position, expected 0.95',
    ]
    return report


def _accuracy_table(runs: dict[tuple[int, str], list[Run]]) -> Table:
    rows = []
    for (laps, method), of in runs.items():
        mean = np.mean([run.position_rms for run in of])
        reference = runs.get((laps, 'iSAM2'))
        ratio = ''
        if reference and method != 'iSAM2':
            ratio = f'{mean / np.mean([run.position_rms for run in reference]):.3f}'
        rows.append(
            (
                str(laps), method, spread((run.position_rms for run in of), 4), ratio,
                spread((run.pose_nees for run in of), 2),
                spread((run.position_in_95 for run in of), 3),
            )
        )  # fmt: skip
    header = ('laps', 'method', 'RMS position (m)', 'ratio to iSAM2', 'mean NEES', 'inside 95 %')
    return Table('Accuracy and consistency', header, tuple(rows))


def _growth_table(laps: int, of: Sequence[Run]) -> Table:
    table = np.mean([run.by_lap(laps) for run in of], axis=0)
    rows = tuple(
        (str(lap + 1), f'{keyframes:.0f}', f'{observations:.0f}', f'{1000.0 * seconds:.1f}')
        for lap, (keyframes, observations, seconds) in enumerate(table)
    )
    header = ('lap', 'keyframes in the graph', 'observations in the graph', 'ms per update')
    return Table(f'Growth over {laps} laps', header, rows)


def _growth_figure(options: Options, runs: dict[tuple[int, str], list[Run]]) -> Any:
    figure, axes = new_figure(columns=3)
    laps = max(options.laps)
    titles = ('keyframes in the graph', 'observations in the graph', 'update (ms)')
    for column, (axis, title) in enumerate(zip(axes.flat, titles, strict=True)):
        for run in runs[laps, 'fastslam2']:
            values = run.by_lap(laps)[:, column] * (1000.0 if column == 2 else 1.0)
            axis.plot(range(1, laps + 1), values, color=COLORS['fastslam2'], alpha=0.5)
        axis.set(title=title, xlabel='lap', ylim=(0.0, None))
    return figure
