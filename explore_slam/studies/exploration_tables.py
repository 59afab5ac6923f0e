"""Tables and plots of exploration studies."""

import csv
import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from explore_slam.errors import EvaluationError
from explore_slam.files import atomic, write_text
from explore_slam.geometry import Array
from explore_slam.results import tables
from explore_slam.results.coverage import Spread
from explore_slam.results.plots import color_of
from explore_slam.studies.exploration_run import ExplorationRun
from explore_slam.studies.figures import new_figure

HEADER = (
    'strategy', 'vehicles', 'runs', 'time to 90 % (s)', 'time to 99 % (s)', '99 %: x of 1 vehicle',
    '99 %: x of nearest', 'end (s)', 'path per vehicle (m)', 'spread of paths', 'overlap',
    'goals changed', 'contacts', 'ended as',
)  # fmt: skip
Group = tuple[str, int]


def grouped(runs: Iterable[ExplorationRun]) -> dict[Group, list[ExplorationRun]]:
    """Return the runs of each (strategy, team size) in their order."""
    groups: dict[Group, list[ExplorationRun]] = {}
    for run in runs:
        groups.setdefault((run.strategy, run.vehicles), []).append(run)
    return groups


def time_ratio(
    runs: Sequence[ExplorationRun], others: Sequence[ExplorationRun], fraction: float = 0.99
) -> float:
    """Return the ratio of mean times to a coverage, over the seeds that both sets have."""
    seeds = {run.seed for run in runs} & {run.seed for run in others}
    if not seeds:
        raise EvaluationError('time ratio: no seed is in both sets of runs')
    above = [run.curve.time_to(fraction) for run in runs if run.seed in seeds]
    below = [run.curve.time_to(fraction) for run in others if run.seed in seeds]
    if not all(map(math.isfinite, (*above, *below))):
        return math.nan
    return float(np.mean(above) / np.mean(below))


def _ended(runs: Sequence[ExplorationRun]) -> str:
    counts: dict[str, int] = {}
    for run in runs:
        counts[run.status] = counts.get(run.status, 0) + 1
    return ', '.join(f'{count} {status}' for status, count in counts.items())


def _ratio_text(runs: Sequence[ExplorationRun], others: Sequence[ExplorationRun] | None) -> str:
    if not others:
        return ''
    ratio = time_ratio(runs, others)
    return 'not reached' if math.isnan(ratio) else f'{ratio:.2f}'


def table_rows(runs: Iterable[ExplorationRun]) -> list[tuple[str, ...]]:
    """Return one row of text per (strategy, team size), with the columns of HEADER."""
    groups = grouped(runs)
    rows: list[tuple[str, ...]] = []
    for (strategy, size), members in groups.items():
        alone, nearest = groups.get((strategy, 1)), groups.get(('nearest', size))
        rows.append(
            (
                strategy,
                str(size),
                str(len(members)),
                Spread.of(run.curve.time_to(0.9) for run in members).text(0),
                Spread.of(run.curve.time_to(0.99) for run in members).text(0),
                _ratio_text(members, alone),
                _ratio_text(members, nearest),
                Spread.of(run.duration for run in members).text(0),
                Spread.of(float(np.mean(run.paths)) for run in members).text(0),
                Spread.of(run.path_spread for run in members).text(2),
                Spread.of(run.curve.overlap() for run in members).text(2),
                Spread.of(run.goals_changed for run in members).text(0),
                f'{sum(run.vehicle_collisions for run in members)} + '
                f'{sum(run.wall_collisions for run in members)}',
                _ended(members),
            )
        )
    return rows


def markdown_table(runs: Iterable[ExplorationRun]) -> str:
    """Return the table of a study; contacts: with vehicles + with walls."""
    return tables.markdown_table(HEADER, table_rows(runs)) + '\n'


def run_values(run: ExplorationRun) -> dict[str, Any]:
    """Return the metrics of one run by name."""
    return {
        'strategy': run.strategy,
        'vehicles': run.vehicles,
        'seed': run.seed,
        'status': run.status,
        'reason': run.reason,
        'coverage': run.curve.team[-1],
        'unreached_frontiers': run.unreached_frontiers,
        'unreached_m2': run.unreached_m2,
        't90': run.curve.time_to(0.9),
        't99': run.curve.time_to(0.99),
        'end': run.duration,
        'mapped': run.mapped,
        'map_rms': run.map_rms,
        'overlap': run.curve.overlap(),
        'path_mean': float(np.mean(run.paths)),
        'path_longest': run.longest_path,
        'path_spread': run.path_spread,
        'goals_given': run.goals_given,
        'goals_changed': run.goals_changed,
        'vehicle_collisions': run.vehicle_collisions,
        'wall_collisions': run.wall_collisions,
        'stalls': run.stalls,
        'plannings': run.plannings,
    }


def timing_values(run: ExplorationRun) -> dict[str, Any]:
    """Return what depends on the computer and on what else it did, by name."""
    return {
        'strategy': run.strategy,
        'vehicles': run.vehicles,
        'seed': run.seed,
        'planning_seconds': run.planning_seconds,
        'real_time_factor': run.real_time_factor,
    }


def save_study(runs: Sequence[ExplorationRun], folder: Path) -> list[Path]:
    """Write the results of a study into a folder; return the paths.

    runs.csv, curves.json and table.md are the same byte for byte wherever the runs were made;
    timings.csv holds what is not.
    """
    if not runs:
        raise EvaluationError('study: no runs to save')
    folder.mkdir(parents=True, exist_ok=True)
    table, curves = folder / 'table.md', folder / 'curves.json'
    write_text(table, markdown_table(runs))
    rows = [run_values(run) for run in runs]
    _write_csv(folder / 'runs.csv', rows)
    _write_csv(folder / 'timings.csv', [timing_values(run) for run in runs])
    content = [
        {**row, 'stamps': run.curve.stamps, 'team': run.curve.team, 'paths': list(run.paths)}
        for row, run in zip(rows, runs, strict=True)
    ]
    write_text(curves, json.dumps(content, default=str))
    pictures = [folder / 'coverage.png', folder / 'times.png']
    plot_coverage(runs, pictures[0])
    plot_times(runs, pictures[1])
    return [table, folder / 'runs.csv', folder / 'timings.csv', curves, *pictures]


def _write_csv(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    with atomic(path) as partial, partial.open('w', newline='', encoding='utf-8') as stream:
        writer = csv.DictWriter(stream, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def _colors(groups: Iterable[Group]) -> dict[str, str]:
    """Return a colour for each strategy, in the order in which they occur."""
    names = dict.fromkeys(strategy for strategy, _ in groups)
    return {name: color_of(index) for index, name in enumerate(names)}


def _mean_curve(runs: Sequence[ExplorationRun]) -> tuple[Array, Array, Array, Array]:
    """Return stamps, and mean, minimum and maximum coverage of the team over runs."""
    end = max(run.curve.stamps[-1] for run in runs)
    stamps = np.linspace(0.0, end, 400)
    shares = np.stack([run.curve.at(stamps) for run in runs])
    return stamps, shares.mean(axis=0), shares.min(axis=0), shares.max(axis=0)


def plot_coverage(runs: Sequence[ExplorationRun], path: Path) -> None:
    """Plot coverage over time: one panel per team size, mean and range over seeds."""
    groups = grouped(runs)
    colors = _colors(groups)
    sizes = sorted({size for _, size in groups})
    figure, axes = new_figure(columns=len(sizes), width=5.0, height=4.0)
    for axis, size in zip(axes[0], sizes, strict=True):
        for (strategy, count), members in groups.items():
            if count != size:
                continue
            stamps, mean, low, high = _mean_curve(members)
            color = colors[strategy]
            axis.plot(stamps / 60.0, 100.0 * mean, color=color, label=strategy)
            axis.fill_between(
                stamps / 60.0, 100.0 * low, 100.0 * high, color=color, alpha=0.15, linewidth=0.0
            )
        axis.axhline(99.0, color='black', linewidth=0.6, linestyle=':')
        axis.set_title(f'{size} vehicle' + ('s' if size > 1 else ''))
        axis.set_xlabel('time (min)')
        axis.set_ylabel('coverage of the reachable area (%)')
        axis.set_ylim(0.0, 101.0)
        axis.set_xlim(left=0.0)
        axis.legend(loc='lower right')
    figure.savefig(path, dpi=110)


def plot_times(runs: Sequence[ExplorationRun], path: Path) -> None:
    """Plot time to 99 % and path length over team size: mean and deviation over seeds."""
    groups = grouped(runs)
    colors = _colors(groups)
    figure, axes = new_figure(columns=2, width=5.0, height=4.0)
    measures = (
        ('time to 99 % (min)', lambda run: run.curve.time_to(0.99) / 60.0),
        ('path per vehicle (m)', lambda run: float(np.mean(run.paths))),
    )
    for axis, (label, measure) in zip(axes[0], measures, strict=True):
        for strategy in dict.fromkeys(name for name, _ in groups):
            sizes = sorted(size for name, size in groups if name == strategy)
            spreads = [Spread.of(map(measure, groups[strategy, size])) for size in sizes]
            kept = [(n, s) for n, s in zip(sizes, spreads, strict=True) if math.isfinite(s.mean)]
            if kept:
                axis.errorbar(
                    [n for n, _ in kept],
                    [s.mean for _, s in kept],
                    [s.deviation for _, s in kept],
                    color=colors[strategy],
                    marker='o',
                    capsize=3,
                    label=strategy,
                )
                axis.legend()
        axis.set_xlabel('vehicles')
        axis.set_ylabel(label)
        axis.set_xticks(sorted({size for _, size in groups}))
        axis.set_ylim(bottom=0.0)
    figure.savefig(path, dpi=110)
