"""Experiment 4: two vehicles with a Kinect, 13 steps each; table VII and figure 14 of the paper.

With a common map, a vehicle inserts landmarks only where no other vehicle has mapped.
"""

import logging
from collections.abc import Sequence
from typing import Any

import numpy as np

from explore_slam.studies.experiments.kinect_walks import Walk, scenario_of
from explore_slam.studies.experiments.scenarios import dead_reckoning
from explore_slam.studies.experiments.tables import (
    PAPER_TEAM,
    ExperimentReport,
    Table,
    share,
    spread,
)
from explore_slam.studies.experiments.trials import FilterEstimator, Trial, rms
from explore_slam.studies.experiments.walk_trials import (
    ENGINES,
    TEAM,
    WalkOptions,
    record,
    run_walks,
)
from explore_slam.studies.figures import COLORS, new_figure

logger = logging.getLogger(__name__)

STEPS, E0 = 13, 0.5
# Case a; case b as in the paper; case b with unrestricted insertion, to show what the rule does.
CASES = (('dedicated', 'always'), ('common', 'unmapped_region'), ('common', 'always'))

Key = tuple[str, str, str]  # engine, maps, insertion policy


def run(options: WalkOptions | None = None) -> ExperimentReport:
    """Record both paths once, then run the joint filter with each case, engine and seed."""
    options = options or WalkOptions()
    return evaluate(record(options, TEAM), options)


def evaluate(walks: Sequence[Walk], options: WalkOptions) -> ExperimentReport:
    """Run the joint filter on the recorded paths with each case, engine and seed."""
    trials: dict[Key, list[Trial]] = {}
    last: dict[Key, FilterEstimator] = {}
    for seed in options.seeds:
        for engine in ENGINES:
            for maps, policy in CASES:
                settings = {
                    'engine': engine,
                    'maps': maps,
                    'insertion_policy': policy,
                    'maximum_descriptor_distance': E0,
                    'minimum_association_probability': 0.9,
                }
                key = (engine, maps, policy)
                trial, last[key] = run_walks(walks, seed, options.particles, settings)
                trials.setdefault(key, []).append(trial)
        logger.info('experiment 4: seed %d done', seed)
    return _report(options, walks, trials, last)


def _report(
    options: WalkOptions,
    walks: Sequence[Walk],
    trials: dict[Key, list[Trial]],
    last: dict[Key, FilterEstimator],
) -> ExperimentReport:
    report = ExperimentReport(
        f'Experiment 4: two vehicles, {STEPS} steps each, {options.particles} particles, '
        f'{len(options.seeds)} seeds'
    )
    report.tables = [_team_table(trials), _map_table(trials)]
    report.figures['figure14'] = _map_figure(walks, last)
    report.metrics = {
        ', '.join(key): {
            'updates': {
                name: [run.vehicles[name].updates for run in runs] for name in runs[0].vehicles
            },
            'landmarks': [run.landmarks[-1] for run in runs],
            'position_rms': [run.position_rms for run in runs],
            'heading_rms': [run.heading_rms for run in runs],
        }
        for key, runs in trials.items()
    }
    drift = []
    for seed in options.seeds:
        scenario = scenario_of(walks, seed)
        for name in scenario.start_poses:
            off = dead_reckoning(scenario, name)[1:] - scenario.true_path(name)[1:]
            drift.append(rms(np.hypot(off[:, 0], off[:, 1])))
    report.remarks = [
        f'E0 = {E0}, P0 = 0.9 (engine paper); odometry alone: RMS {spread(drift)} m',
        'estimates count the 13 steps and the first frame at the start',
    ]
    return report


def _team_table(trials: dict[Key, list[Trial]]) -> Table:
    rows = [
        (
            'published', maps, 'unmapped_region' if maps == 'common' else 'always', vehicle,
            f'{estimates}/{STEPS}', f'{updates}', f'{60 * minutes:.0f}', '', '',
        )
        for (maps, vehicle), (estimates, updates, minutes) in PAPER_TEAM.items()
    ]  # fmt: skip
    for (engine, maps, policy), runs in sorted(trials.items(), key=lambda i: i[0][0] != 'paper'):
        for name in runs[0].vehicles:
            mine = [run.vehicles[name] for run in runs]
            rows.append(
                (
                    engine, maps, policy, name,
                    share(float(np.mean([v.estimates for v in mine])), STEPS),
                    spread((v.updates for v in mine), 0),
                    spread((sum(run.seconds) for run in runs), 2),
                    spread(rms(np.hypot(*v.table[:, :2].T)) for v in mine),
                    spread(rms(v.table[:, 2]) for v in mine),
                )
            )  # fmt: skip
    return Table(
        'Table VII: dedicated maps (case a) and a common map (case b)',
        ('', 'maps', 'insertion', 'vehicle', 'estimates/steps', 'updates',
         'filter time, both (s)', 'RMS position (m)', 'RMS heading (rad)'),
        tuple(rows),
    )  # fmt: skip


def _map_table(trials: dict[Key, list[Trial]]) -> Table:
    rows = [('published', '0.57')]
    for engine in ENGINES:
        apart = [run.landmarks[-1] for run in trials[engine, 'dedicated', 'always']]
        for policy in ('unmapped_region', 'always'):
            joint = [run.landmarks[-1] for run in trials[engine, 'common', policy]]
            ratio = float(np.mean(joint) / np.mean(apart))
            rows.append((f'{engine}, {policy}', f'{ratio:.2f}'))
    return Table(
        'Landmarks of the common map relative to those of both dedicated maps',
        ('', 'N common / (N 1 + N 2)'),
        tuple(rows),
    )


def _map_figure(walks: Sequence[Walk], last: dict[Key, FilterEstimator]) -> Any:
    cases = [('paper', *CASES[1]), ('fastslam2', *CASES[1]), ('fastslam2', *CASES[2])]
    figure, axes = new_figure(columns=len(cases), width=4.4, height=4.2)
    for axis, key in zip(axes.flat, cases, strict=True):
        landmarks = last[key].belief.landmarks()
        repeated = landmarks.counts > 1
        axis.plot(
            *landmarks.means[~repeated, :2].T,
            '.',
            color='#cccccc',
            markersize=3,
            label='observed once',
        )
        axis.plot(
            *landmarks.means[repeated, :2].T,
            '.',
            color='#3a9a5b',
            markersize=4,
            label='observed again',
        )
        for walk in walks:
            path = np.array([stop.pose for stop in walk.stops])
            style = '-' if walk is walks[0] else '--'  # paths may coincide
            label = f'{walk.vehicle}, truth'
            axis.plot(*path[:, :2].T, style, color=COLORS[walk.vehicle], label=label)
            axis.plot(*path[0, :2], 'o', color=COLORS[walk.vehicle])
        axis.set(title=f'{key[0]}, {key[2]}', xlabel='x (m)', ylabel='y (m)')
        axis.set_aspect('equal')
    figure.legend(*axes.flat[0].get_legend_handles_labels(), loc='outside lower center', ncols=4)
    return figure
