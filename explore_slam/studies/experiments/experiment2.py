"""Experiment 2: data association with SIFT features; figure 8, tables IV and V of the paper.

Figure 8 on a 10 m path of the simulated Kinect; the tables on real Kinect frames with motion
capture, where the paper counted by eye.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from explore_slam.recording.tum_sequence import TumOptions
from explore_slam.settings import with_values
from explore_slam.studies.experiments.association_study import (
    RULES,
    TOLERANCE,
    MatchCount,
    count_matches,
    distance_shares,
)
from explore_slam.studies.experiments.filter_study import filter_config, run_filter
from explore_slam.studies.experiments.kinect_walks import Walk
from explore_slam.studies.experiments.tables import (
    PAPER_ASSOCIATIONS,
    PAPER_DISTANCES,
    ExperimentReport,
    Table,
    spread,
)
from explore_slam.studies.experiments.tum_frames import DEFAULTS, TumFrame, read_tum
from explore_slam.studies.experiments.walk_trials import (
    CORRIDOR,
    ENGINES,
    WalkOptions,
    record,
    run_walks,
)
from explore_slam.studies.figures import COLORS, new_figure
from explore_slam.vision import VisionConfig

logger = logging.getLogger(__name__)

QUALITIES = (0.3, 0.5, 0.7, 0.8, 0.9, 0.95)
THRESHOLDS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.2)
STRIDES = (1, 3, 6)
PAPER_DESCRIPTORS = 3125  # table IV

Sweep = dict[float, list[int]]


@dataclass(frozen=True)
class Options:
    """Options of the walks; data: folder of TUM RGB-D frames, None to leave the tables out.

    sequence: how its frames are read.
    """

    walks: WalkOptions
    data: Path | None = None
    sequence: TumOptions = DEFAULTS


def run(options: Options) -> ExperimentReport:
    """Evaluate matches on real frames and sweep P0 and E0 on the simulated path."""
    report = ExperimentReport('Experiment 2: association of SIFT features')
    if options.data is not None:
        read = partial(read_tum, options.data, options=options.sequence)
        study_frames(read(_vision(400)), report)
        frames = read(_vision(200))
        report.tables.append(_filter_table(frames, options.walks, report))
    else:
        report.remarks.append('without --data: tables IV and V are left out')
    walks = record(options.walks, {'robot1': CORRIDOR})
    sweep(walks, options.walks, report)
    return report


def _vision(budget: int) -> VisionConfig:
    # A hand-held camera rolls; upright features assume that it does not.
    return with_values(VisionConfig(), {'feature_budget': budget, 'feature_orientation': 'single'})


def study_frames(frames: Sequence[TumFrame], report: ExperimentReport) -> None:
    """Add tables IV and V."""
    descriptors = np.concatenate([frame.descriptors for frame in frames])
    report.tables.append(_distance_table(descriptors))
    counts = {
        stride: count_matches(
            frames, stride, tuple(PAPER_ASSOCIATIONS), np.random.default_rng(stride)
        )
        for stride in STRIDES
    }
    interval = float(np.median(np.diff([frame.stamp for frame in frames])))
    report.tables.append(_association_table(counts, interval))
    report.figures['association'] = _association_figure(counts, interval)
    report.metrics['association'] = {
        f'{rule}, stride {stride}, E0 {e0}': {
            'correct': count.correct[rule, e0],
            'total': count.total[rule, e0],
            'precision': count.precision(rule, e0),
        }
        for stride, count in counts.items()
        for rule in RULES
        for e0 in PAPER_ASSOCIATIONS
    }
    report.remarks += [
        f'{len(frames)} real frames; a match is correct when ground truth places both points '
        f'within {100 * TOLERANCE:.0f} cm; pose uncertainty of one step of table I',
        'descriptor: nearest descriptor (the rule of table V); gated: nearest inside the '
        "Mahalanobis gate; mutual: nearest in both directions; ratio test: Lowe's ratio below 0.8",
        'the frames show the same desk repeatedly, so that more distances are small than on the '
        'path of the paper',
    ]


def _filter_table(
    frames: Sequence[TumFrame], options: WalkOptions, report: ExperimentReport
) -> Table:
    rows = []
    for e0 in PAPER_ASSOCIATIONS:
        config = filter_config(e0, options.particles)
        runs = [run_filter(frames, config, seed) for seed in options.seeds]
        correct, total = sum(run.correct for run in runs), sum(run.total for run in runs)
        report.metrics[f'filter on real frames, E0 {e0}'] = {
            'correct': correct,
            'total': total,
            'precision': correct / max(total, 1),
            'position_rms': [run.position_rms for run in runs],
            'heading_rms': [run.heading_rms for run in runs],
            'odometry_rms': [run.odometry_rms for run in runs],
            'pose_nees': [run.pose_nees for run in runs],
        }
        rows.append(
            (
                f'{e0}', f'{correct}/{total} = {100 * correct / max(total, 1):.1f} %',
                spread(run.position_rms for run in runs), spread(run.heading_rms for run in runs),
                spread(run.odometry_rms for run in runs),
                spread((run.pose_nees for run in runs), 1),
            )
        )  # fmt: skip
    return Table(
        f'Complete filter (fastslam2) on {len(frames)} real frames, {len(options.seeds)} seeds',
        (
            'E0',
            'correct updates',
            'RMS position (m)',
            'RMS heading (rad)',
            'odometry position (m)',
            'NEES of the pose',
        ),
        tuple(rows),
    )


def _distance_table(descriptors: NDArray[np.float32]) -> Table:
    rng = np.random.default_rng(0)
    limits = tuple(PAPER_DISTANCES)
    chosen = rng.choice(len(descriptors), min(PAPER_DESCRIPTORS, len(descriptors)), replace=False)
    few = distance_shares(descriptors[np.sort(chosen)], limits)
    every = distance_shares(descriptors[:: max(1, len(descriptors) // 15000)], limits)
    rows = tuple(
        (f'{limit}', f'{PAPER_DISTANCES[limit]:.3f}', f'{few[limit]:.3f}', f'{every[limit]:.3f}')
        for limit in limits
    )
    many = len(descriptors[:: max(1, len(descriptors) // 15000)])
    return Table(
        'Table IV: percentage of squared descriptor distances below a limit',
        ('limit', 'published (3125 descriptors)', f'{len(chosen)} drawn', f'{many} of all frames'),
        rows,
    )


def _association_table(counts: dict[int, MatchCount], interval: float) -> Table:
    rows = [
        (
            'published', '2 images', *(f'{correct}/{total} = {100 * correct / total:.0f} %'
            for correct, total in PAPER_ASSOCIATIONS.values()),
        )
    ]  # fmt: skip
    for rule in RULES:
        for stride, count in counts.items():
            cells = (
                f'{count.correct[rule, e0]}/{count.total[rule, e0]} = '
                f'{100 * count.precision(rule, e0):.1f} %'
                for e0 in PAPER_ASSOCIATIONS
            )
            rows.append((rule, f'{stride * interval:.2f} s apart', *cells))
    return Table(
        'Table V: correct associations of all associations',
        ('rule', 'images', *(f'E0 = {e0}' for e0 in PAPER_ASSOCIATIONS)),
        tuple(rows),
    )


def _association_figure(counts: dict[int, MatchCount], interval: float) -> Any:
    figure, axes = new_figure(columns=2)
    thresholds = list(PAPER_ASSOCIATIONS)
    published = [100 * correct / total for correct, total in PAPER_ASSOCIATIONS.values()]
    colors = dict(zip(RULES, ('#999999', '#d9782d', '#1f6fb4', '#3a9a5b'), strict=True))
    styles = dict(zip(counts, ('-', '--', ':'), strict=True))
    for stride, count in counts.items():
        for rule in RULES:
            label = f'{rule}, {stride * interval:.2f} s apart' if stride == STRIDES[0] else None
            precision = [100 * count.precision(rule, e0) for e0 in thresholds]
            correct = [count.correct[rule, e0] for e0 in thresholds]
            axes[0, 0].plot(thresholds, precision, styles[stride], color=colors[rule], label=label)
            axes[0, 1].plot(thresholds, correct, styles[stride], color=colors[rule])
    axes[0, 0].plot(thresholds, published, 'k^', label='published')
    axes[0, 0].axhline(95.0, color='k', linewidth=0.8)
    axes[0, 0].set(xlabel='E0', ylabel='correct matches (%)', ylim=(0.0, 102.0))
    axes[0, 1].set(xlabel='E0', ylabel='correct matches, all pairs of frames', yscale='log')
    axes[0, 1].set_title(
        ', '.join(f'{styles[s]} {s * interval:.2f} s apart' for s in counts), fontsize=9
    )
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc='outside lower center', ncols=5)
    return figure


def sweep(walks: Sequence[Walk], options: WalkOptions, report: ExperimentReport) -> None:
    """Add figure 8: landmark updates as functions of P0 and E0."""
    by_quality = {engine: _updates(walks, options, engine, QUALITIES, True) for engine in ENGINES}
    by_distance = {
        engine: _updates(walks, options, engine, THRESHOLDS, False) for engine in ENGINES
    }
    # Engine fastslam2 has no P0.
    rows: list[tuple[str, ...]] = [
        ('P0', f'{value}', spread(counts, 0), '') for value, counts in by_quality['paper'].items()
    ]
    rows += [
        ('E0', f'{value}', *(spread(by_distance[engine][value], 0) for engine in ENGINES))
        for value in THRESHOLDS
    ]
    report.tables.append(
        Table(
            'Figure 8: landmark updates on the 10 m path (P0 varied at E0 = 1.2, E0 at P0 = 0.9)',
            ('varied', 'value', *(f'updates, {engine}' for engine in ENGINES)),
            tuple(rows),
        )
    )
    report.metrics['updates'] = {
        'P0': {str(k): v for k, v in by_quality['paper'].items()},
        'E0': {engine: {str(k): v for k, v in by_distance[engine].items()} for engine in ENGINES},
    }
    report.figures['figure8'] = _sweep_figure(by_quality, by_distance)


def _updates(
    walks: Sequence[Walk], options: WalkOptions, engine: str, values: Sequence[float], p0: bool
) -> Sweep:
    if p0 and engine != 'paper':
        return {}
    counts: Sweep = {}
    for value in values:
        settings = {
            'engine': engine,
            'minimum_association_probability': value if p0 else 0.9,
            'maximum_descriptor_distance': 1.2 if p0 else value,
        }
        counts[value] = [
            run_walks(walks, seed, options.particles, settings)[0].updates
            for seed in options.seeds
        ]
        logger.info('experiment 2: %s %s', 'P0' if p0 else 'E0', value)
    return counts


def _sweep_figure(by_quality: dict[str, Sweep], by_distance: dict[str, Sweep]) -> Any:
    figure, axes = new_figure(columns=2)
    for axis, sweeps, name in (
        (axes[0, 0], by_quality, 'P0 (E0 = 1.2)'),
        (axes[0, 1], by_distance, 'E0 (P0 = 0.9)'),
    ):
        for engine, counts in sweeps.items():
            if not counts:
                continue
            values = list(counts)
            means = [np.mean(counts[v]) for v in values]
            deviations = [np.std(counts[v]) for v in values]
            axis.errorbar(
                values,
                means,
                deviations,
                marker='o',
                capsize=3,
                color=COLORS[engine],
                label=engine,
            )
        axis.set(xlabel=name, ylabel='landmark updates', ylim=(0.0, None))
        axis.legend()
    return figure
