"""Experiment 3: one vehicle with a Kinect, 16 steps; figure 11 and table VI of the paper.

Figure 11 shows the time of a step, table VI the influence of E0.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from explore_slam.slam import warm_up
from explore_slam.studies.experiments.kinect_walks import Walk, scenario_of
from explore_slam.studies.experiments.scenarios import dead_reckoning
from explore_slam.studies.experiments.tables import (
    PAPER_THRESHOLDS,
    ExperimentReport,
    Table,
    share,
    spread,
)
from explore_slam.studies.experiments.trials import Trial, rms
from explore_slam.studies.experiments.walk_trials import (
    ENGINES,
    ROUNDS,
    WalkOptions,
    record,
    run_walks,
)
from explore_slam.studies.figures import COLORS, new_figure

logger = logging.getLogger(__name__)

STEPS = 16
PAPER_SECONDS_PER_STEP = 21.0  # section V: 334 s for 16 steps
PLOTTED_E0 = 0.5  # of figure 11

Key = tuple[str, float]


@dataclass
class Results:
    """Trials by engine and E0; odometry: position RMS (m) of odometry alone, by seed."""

    trials: dict[Key, list[Trial]] = field(default_factory=dict)
    odometry: list[float] = field(default_factory=list)


def run(options: WalkOptions | None = None) -> ExperimentReport:
    """Record the path once, then run the filter with each E0, engine and seed."""
    options = options or WalkOptions()
    return evaluate(record(options, {'robot1': ROUNDS}), options)


def evaluate(walks: Sequence[Walk], options: WalkOptions) -> ExperimentReport:
    """Run the filter on the recorded path with each E0, engine and seed."""
    warm_up()  # compilation is part of start-up, not of a step
    results = Results()
    for seed in options.seeds:
        scenario = scenario_of(walks, seed)
        drift = dead_reckoning(scenario, 'robot1')[1:] - scenario.true_path('robot1')[1:]
        results.odometry.append(rms(np.hypot(drift[:, 0], drift[:, 1])))
        for engine in ENGINES:
            for e0 in PAPER_THRESHOLDS:
                settings = {
                    'engine': engine,
                    'maximum_descriptor_distance': e0,
                    'minimum_association_probability': 0.9,
                }
                trial, _ = run_walks(walks, seed, options.particles, settings)
                results.trials.setdefault((engine, e0), []).append(trial)
        logger.info('experiment 3: seed %d done', seed)
    return _report(options, walks[0], results)


def _report(options: WalkOptions, walk: Walk, results: Results) -> ExperimentReport:
    extraction = [stop.seconds for stop in walk.stops]
    report = ExperimentReport(
        f'Experiment 3: {STEPS} steps with a Kinect, {options.particles} particles, '
        f'{len(options.seeds)} seeds'
    )
    report.tables = [_threshold_table(results), _time_table(results, extraction)]
    report.figures['figure11'] = _time_figure(results, extraction)
    report.metrics = {
        'odometry_position_rms': results.odometry,
        'extraction_seconds': extraction,
        'trials': {
            f'{engine}, E0 {e0}': {
                'updates': [run.updates for run in runs],
                'estimates': [run.estimates for run in runs],
                'position_rms': [run.position_rms for run in runs],
                'landmarks': [run.landmarks[-1] for run in runs],
                'seconds_per_step': [float(np.mean(run.seconds)) for run in runs],
            }
            for (engine, e0), runs in results.trials.items()
        },
    }
    report.remarks = [
        'simulated Kinect in an office of the size of the paper; odometry noise of table I; '
        f'odometry alone: RMS {spread(results.odometry)} m',
        'time of the filter alone (predict, update, estimate); published: 334 s for 16 steps at '
        'E0 = 0.5',
    ]
    return report


def _threshold_table(results: Results) -> Table:
    rows = [
        ('published', f'{e0}', f'{estimates}/{STEPS}', f'{updates}', f'{seconds}', '')
        for e0, (estimates, updates, seconds) in PAPER_THRESHOLDS.items()
    ]
    for (engine, e0), runs in sorted(
        results.trials.items(), key=lambda item: item[0][0] != 'paper'
    ):
        rows.append(
            (
                engine, f'{e0}', share(float(np.mean([run.estimates for run in runs])), STEPS),
                spread((run.updates for run in runs), 0),
                spread((sum(run.seconds) for run in runs), 2),
                spread(run.position_rms for run in runs),
            )
        )  # fmt: skip
    return Table(
        'Table VI: influence of E0 (P0 = 0.9)',
        ('', 'E0', 'estimates/steps', 'updates', 'filter time (s)', 'RMS position (m)'),
        tuple(rows),
    )


def _time_table(results: Results, extraction: Sequence[float]) -> Table:
    median = float(np.median(extraction))
    rows = [('published', f'{1000 * PAPER_SECONDS_PER_STEP:.0f}', '', '', '')]
    for engine in ENGINES:
        runs = results.trials[engine, PLOTTED_E0]
        step = float(np.median([s for run in runs for s in run.seconds]))
        worst = max(s for run in runs for s in run.seconds)
        rows.append(
            (
                engine, f'{1000 * step:.1f}', f'{1000 * worst:.1f}', f'{step / median:.2f}',
                spread((run.landmarks[-1] for run in runs), 0),
            )
        )  # fmt: skip
    return Table(
        f'Time of a step at E0 = {PLOTTED_E0}; SIFT of one frame: {1000 * median:.0f} ms',
        ('', 'median (ms)', 'worst (ms)', 'median / SIFT', 'landmarks at the end'),
        tuple(rows),
    )


def _time_figure(results: Results, extraction: Sequence[float]) -> Any:
    figure, axes = new_figure(columns=2)
    for engine in ENGINES:
        for number, run in enumerate(results.trials[engine, PLOTTED_E0]):
            milliseconds = 1000.0 * np.array(run.seconds)
            label = engine if number == 0 else None
            axes[0, 0].plot(
                run.landmarks, milliseconds, '.-', color=COLORS[engine], alpha=0.6, label=label
            )
            axes[0, 1].plot(
                range(len(milliseconds)), milliseconds, '.-', color=COLORS[engine], alpha=0.6
            )
    sift = 1000.0 * float(np.median(extraction))
    for axis, name in ((axes[0, 0], 'landmarks in the map'), (axes[0, 1], 'step')):
        axis.axhline(sift, color='k', linewidth=0.9, label=f'SIFT of one frame, {sift:.0f} ms')
        axis.axhline(
            1000 * PAPER_SECONDS_PER_STEP, color='#c0392b', linewidth=0.9, label='published, 21 s'
        )
        axis.set(xlabel=name, ylabel='time of a step (ms)', yscale='log')
    axes[0, 0].set_title(f'as figure 11: E0 = {PLOTTED_E0}, P0 = 0.9')
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc='outside lower center', ncols=4)
    return figure
