"""Experiment 1: two vehicles, landmarks with unique descriptors; tables II and III of the paper.

Both engines and iSAM2, with a common map and with dedicated maps, on the same simulated data. All
estimates are online.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from explore_slam.geometry import Array
from explore_slam.settings import with_values
from explore_slam.slam import FastSlamConfig
from explore_slam.studies.experiments.scenarios import (
    HEIGHT,
    PATHS,
    WIDTH,
    Scenario,
    dead_reckoning,
    draw_scenario,
)
from explore_slam.studies.experiments.tables import (
    PAPER_ACCURACY,
    PAPER_TABLE,
    ExperimentReport,
    Table,
    share,
    spread,
)
from explore_slam.studies.experiments.trials import (
    Estimator,
    FilterEstimator,
    SmootherEstimator,
    Trial,
    rms,
    run_trial,
)
from explore_slam.studies.figures import COLORS, new_figure
from explore_slam.studies.parallel import ALONE, Workers, make_runs

logger = logging.getLogger(__name__)

MAPS = ('dedicated', 'common')
# E0 for unique descriptors: 0 in the paper; here the rounding error of float32 distances.
UNIQUE_DESCRIPTORS = 1e-4


@dataclass(frozen=True)
class Options:
    """Seeds of the data, particles of both engines, landmarks in the world, iSAM2 or not.

    Filters are random: each runs filter_runs times on the data of each seed.
    """

    seeds: Sequence[int] = tuple(range(20))
    filter_runs: int = 5
    particles: int = 1000
    paper_particles: int = 2000
    landmarks: int = 60
    isam2: bool = True


Key = tuple[str, str, str]  # scene, method, maps


def run(options: Options | None = None, workers: Workers = ALONE) -> ExperimentReport:
    """Run all methods on both scenes over all seeds."""
    options = options or Options()
    tasks = [(options, scene, seed) for scene in PATHS for seed in options.seeds]
    trials: dict[Key, list[Trial]] = {}
    for (_, scene, seed), found in zip(tasks, make_runs(_run_seed, tasks, workers), strict=True):
        for key, done in found.items():
            trials.setdefault(key, []).extend(done)
        logger.info('experiment 1: %s, seed %d done', scene, seed)
    return _report(options, trials)


def _run_seed(options: Options, scene: str, seed: int) -> dict[Key, list[Trial]]:
    """Run all methods on one scene with one seed."""
    scenario = draw_scenario(scene, seed, landmarks=options.landmarks)
    trials: dict[Key, list[Trial]] = {}
    for maps in MAPS:
        for method in _methods(options):
            for repetition in range(1 if method == 'iSAM2' else options.filter_runs):
                draw = seed + 1000 * repetition
                estimator = make_estimator(method, maps, scenario, options, draw)
                done = run_trial(scenario, estimator)
                trials.setdefault((scene, method, maps), []).append(done)
    return trials


def _methods(options: Options) -> tuple[str, ...]:
    return ('paper', 'fastslam2', 'iSAM2') if options.isam2 else ('paper', 'fastslam2')


def make_estimator(
    method: str, maps: str, scenario: Scenario, options: Options, seed: int
) -> Estimator:
    """Return a filter (as in the paper: σ = 0.5, P0 = 0.9, E0 = 0) or the smoother."""
    if method == 'iSAM2':
        return SmootherEstimator(scenario.start_poses, maps)
    values = {
        'engine': method,
        'maps': maps,
        'particles': options.paper_particles if method == 'paper' else options.particles,
        'maximum_descriptor_distance': UNIQUE_DESCRIPTORS,
        'minimum_association_probability': 0.9,
    }
    return FilterEstimator(scenario.start_poses, with_values(FastSlamConfig(), values), seed)


def _report(options: Options, trials: dict[Key, list[Trial]]) -> ExperimentReport:
    seeds = list(options.seeds)
    report = ExperimentReport(f'Experiment 1: {len(seeds)} seeds, {options.landmarks} landmarks')
    for scene in PATHS:
        report.tables.append(_accuracy_table(scene, options, trials))
    report.tables.append(_summary_table(options, trials))
    report.metrics = _metrics(options, trials)
    scenarios = {
        scene: draw_scenario(scene, seeds[0], landmarks=options.landmarks) for scene in PATHS
    }
    report.figures['paths'] = _path_figure(scenarios, options, seeds[0])
    report.figures['errors'] = _error_figure(options, trials)
    report.figures['effective_particles'] = _effective_figure(trials)
    report.remarks = [
        'mean ± standard deviation over seeds; of ratios, over the '
        f'{options.filter_runs} runs of a filter on the same data; errors of the online estimate '
        'after each step; paper: pose of the best particle, fastslam2: mean, iSAM2: newest pose '
        'after each update',
        f'particles: paper {options.paper_particles}, fastslam2 {options.particles}; the authors '
        'used 2000, and paths whose coordinates the text does not give',
        'the published RMS is of another world: compare the rows of one block with each other',
    ]
    return report


def _accuracy_table(scene: str, options: Options, trials: dict[Key, list[Trial]]) -> Table:
    steps = len(draw_scenario(scene, 0).true_path('robot1')) - 1
    rows: list[tuple[str, ...]] = []
    for (maps, vehicle), (x, y, heading, estimates, of, updates) in PAPER_ACCURACY[scene].items():
        rows.append(
            (
                'published', maps, vehicle, f'{x:.3f}', f'{y:.3f}', f'{heading:.3f}',
                f'{estimates}/{of}', f'{updates}',
            )
        )  # fmt: skip
    for method in _methods(options):
        for maps in MAPS:
            runs = trials[scene, method, maps]
            for vehicle in runs[0].vehicles:
                of_vehicle = [run.vehicles[vehicle] for run in runs]
                errors = np.array([[rms(v.table[:, k]) for k in range(3)] for v in of_vehicle])
                rows.append(
                    (
                        method, maps, vehicle, *(spread(errors[:, k]) for k in range(3)),
                        share(float(np.mean([v.estimates for v in of_vehicle])), steps),
                        spread((v.updates for v in of_vehicle), 0),
                    )
                )  # fmt: skip
    return Table(
        f'{PAPER_TABLE[scene]}: {scene} paths, {steps} steps of 0.5 m',
        ('', 'maps', 'vehicle', 'RMS x (m)', 'RMS y (m)', 'RMS heading (rad)', 'estimates/steps',
         'updates'),
        tuple(rows),
    )  # fmt: skip


def _summary_table(options: Options, trials: dict[Key, list[Trial]]) -> Table:
    rows = []
    for (scene, method, maps), runs in trials.items():
        ratios = ('', '')
        if options.isam2 and method != 'iSAM2':
            of_draws = _ratios(options, runs, trials[scene, 'iSAM2', maps])
            ratios = (spread(of_draws[:, 0], 2), spread(of_draws[:, 1], 2))
        effective = [e for run in runs for e in run.effective]
        rows.append(
            (
                scene, method, maps, spread((run.position_rms for run in runs), 4),
                spread((run.heading_rms for run in runs), 4), *ratios,
                '' if method == 'iSAM2' else f'{np.nanmedian(effective):.0f}',
                f'{1000.0 * np.median([s for run in runs for s in run.seconds]):.1f}',
            )
        )  # fmt: skip
    return Table(
        'RMS over both vehicles, and as a ratio to iSAM2 on the same data',
        ('paths', 'method', 'maps', 'position (m)', 'heading (rad)', 'position / iSAM2',
         'heading / iSAM2', 'effective particles', 'ms per update'),
        tuple(rows),
    )  # fmt: skip


def _mean_errors(runs: Sequence[Trial]) -> tuple[float, float]:
    return (
        float(np.mean([run.position_rms for run in runs])),
        float(np.mean([run.heading_rms for run in runs])),
    )


def _ratios(options: Options, runs: Sequence[Trial], smoother: Sequence[Trial]) -> Array:
    """Return (filter_runs, 2): position and heading error relative to the smoother."""
    draws = [
        _mean_errors(runs[repetition :: options.filter_runs])
        for repetition in range(options.filter_runs)
    ]
    ratios: Array = np.array(draws) / np.array(_mean_errors(smoother))
    return ratios


def _metrics(options: Options, trials: dict[Key, list[Trial]]) -> dict[str, Any]:
    metrics: dict[str, Any] = {'seeds': list(options.seeds), 'landmarks': options.landmarks}
    for (scene, method, maps), runs in trials.items():
        position, heading = _mean_errors(runs)
        entry: dict[str, Any] = {
            'position_rms': position,
            'heading_rms': heading,
            'position_rms_of_seeds': [run.position_rms for run in runs],
            'heading_rms_of_seeds': [run.heading_rms for run in runs],
        }
        if options.isam2:
            of_smoother = _mean_errors(trials[scene, 'iSAM2', maps])
            entry['position_ratio'] = position / of_smoother[0]
            entry['heading_ratio'] = heading / of_smoother[1]
        metrics[f'{scene}/{method}/{maps}'] = entry
    return metrics


def _path_figure(scenarios: dict[str, Scenario], options: Options, seed: int) -> Any:
    figure, axes = new_figure(columns=len(scenarios), width=6.0, height=4.4)
    for axis, (scene, scenario) in zip(axes.flat, scenarios.items(), strict=True):
        axis.plot(*scenario.landmarks[:, :2].T, '.', color='#bbbbbb', label='landmarks')
        estimator = make_estimator('fastslam2', 'common', scenario, options, seed)
        trial = run_trial(scenario, estimator)
        for vehicle in scenario.start_poses:
            true, drift = scenario.true_path(vehicle), dead_reckoning(scenario, vehicle)
            found = true[1:, :2] + trial.vehicles[vehicle].table[:, :2]
            color = COLORS[vehicle]
            axis.plot(
                *true[:, :2].T, color=color, linewidth=3.0, alpha=0.35, label=f'{vehicle}, truth'
            )
            axis.plot(*drift[:, :2].T, ':', color=color, label=f'{vehicle}, odometry')
            axis.plot(*found.T, '.-', color=color, linewidth=1.0, label=f'{vehicle}, fastslam2')
            axis.plot(*true[0, :2], 'o', color=color)
        axis.set(
            title=f'{scene} paths, seed {seed}', xlabel='x (m)', ylabel='y (m)',
            xlim=(-0.5, WIDTH + 0.5), ylim=(-0.5, HEIGHT + 0.5),
        )  # fmt: skip
        axis.set_aspect('equal')
    figure.legend(*axes.flat[0].get_legend_handles_labels(), loc='outside lower center', ncols=4)
    return figure


def _error_figure(options: Options, trials: dict[Key, list[Trial]]) -> Any:
    figure, axes = new_figure(columns=2, rows=len(PATHS), height=3.0)
    methods = _methods(options)
    for row, scene in enumerate(PATHS):
        for column, name in enumerate(('position_rms', 'heading_rms')):
            axis = axes[row, column]
            for number, maps in enumerate(MAPS):
                for place, method in enumerate(methods):
                    values = [getattr(run, name) for run in trials[scene, method, maps]]
                    x = number + 0.25 * (place - 0.5 * (len(methods) - 1))
                    axis.bar(
                        x, np.mean(values), 0.22, color=COLORS[method], alpha=0.5,
                        label=method if number == 0 else None,
                    )  # fmt: skip
                    jitter = np.linspace(-0.07, 0.07, len(values))
                    axis.plot(x + jitter, values, '.', color=COLORS[method], markersize=3)
            axis.set_xticks(range(len(MAPS)), [f'{maps} maps' for maps in MAPS])
            unit = 'position (m)' if column == 0 else 'heading (rad)'
            axis.set(title=f'{scene} paths', ylabel=f'RMS {unit}', yscale='log')
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc='outside lower center', ncols=3)
    return figure


def _effective_figure(trials: dict[Key, list[Trial]]) -> Any:
    figure, axes = new_figure(columns=len(PATHS), width=4.6)
    for axis, scene in zip(axes.flat, PATHS, strict=True):
        for method in ('paper', 'fastslam2'):
            for maps, style in (('dedicated', '--'), ('common', '-')):
                series = np.array([run.effective for run in trials[scene, method, maps]])
                # A step without observations is no update: its sample size is NaN.
                steps = np.flatnonzero(~np.isnan(series).all(axis=0))
                median = np.nanmedian(series[:, steps], axis=0)
                axis.plot(
                    steps, median, style, color=COLORS[method], label=f'{method}, {maps} maps'
                )
                if maps == 'common':
                    low, high = np.nanpercentile(series[:, steps], [10, 90], axis=0)
                    axis.fill_between(steps, low, high, color=COLORS[method], alpha=0.15)
        axis.set(
            title=f'{scene} paths', xlabel='update (both vehicles in turn)',
            ylabel='effective particles', yscale='log', ylim=(0.8, 3000.0),
        )  # fmt: skip
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc='outside lower center', ncols=4)
    return figure
