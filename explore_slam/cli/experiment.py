"""`explore_slam experiment 1|2|3|4|laps`: the experiments of the paper, and laps of the first."""

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from explore_slam.cli.arguments import (
    add_section_options,
    add_workers_options,
    section_of,
    whole_numbers,
    workers_of,
)
from explore_slam.errors import EvaluationError

if TYPE_CHECKING:
    from explore_slam.studies.experiments.tables import ExperimentReport

HELP = 'repeat an experiment of the paper and print it beside the published tables'


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        'name', choices=('1', '2', '3', '4', 'laps'),
        help='1: common and dedicated maps; 2: association; 3: time per step; 4: two vehicles; '
        'laps: many laps of the crossing paths of 1, consistency and growth',
    )  # fmt: skip
    parser.add_argument(
        '--seeds',
        type=whole_numbers,
        help='such as 0..19 or 3,5; default 0..19 (experiment 1), 0..9 (laps) or 0..4 (2, 3, 4)',
    )
    parser.add_argument(
        '--particles', type=int, help='number of particles (default 1000; laps: 500)'
    )
    parser.add_argument(
        '--laps', type=whole_numbers, help='experiment laps: numbers of laps (default 4,20)'
    )
    parser.add_argument(
        '--landmarks', type=int, default=60, help='experiment 1: number of landmarks (default 60)'
    )
    parser.add_argument(
        '--without-isam2',
        action='store_true',
        help='experiments 1 and laps: leave out the reference method (needs gtsam)',
    )
    parser.add_argument(
        '--data',
        type=Path,
        help='experiment 2: folder of TUM RGB-D frames (default $EXPLORE_SLAM_DATA/tum_fr1_rpy)',
    )
    from explore_slam.studies.experiments.tum_frames import DEFAULTS

    add_section_options(
        parser.add_argument_group('experiment 2: how the frames of --data are read'), DEFAULTS
    )
    parser.add_argument(
        '--world', type=Path, help='experiments 2, 3, 4: world file of the simulated Kinect'
    )
    add_workers_options(
        parser.add_argument_group('experiments 1 and laps: where their runs are made'), 1
    )
    parser.add_argument(
        '--output', type=Path, default=Path('runs'), help='parent of the run folder (default runs)'
    )


def run(arguments: argparse.Namespace) -> int:
    """Run an experiment, print its tables, write tables and plots."""
    report = _run_named(arguments)
    print(report.markdown())
    folder = report.save(arguments.output)
    print(f'tables and plots: {folder}', file=sys.stderr)
    return 0


def _run_named(arguments: argparse.Namespace) -> 'ExperimentReport':
    if arguments.name == '1':
        from explore_slam.studies.experiments import experiment1

        return experiment1.run(
            experiment1.Options(
                seeds=arguments.seeds or range(20),
                particles=arguments.particles or 1000,
                landmarks=arguments.landmarks,
                isam2=not arguments.without_isam2,
            ),
            workers_of(arguments),
        )
    if arguments.name == 'laps':
        from explore_slam.studies.experiments import laps

        return laps.run(
            laps.Options(
                seeds=arguments.seeds or range(10),
                laps=arguments.laps or (4, 20),
                particles=arguments.particles or 500,
                isam2=not arguments.without_isam2,
            ),
            workers_of(arguments),
        )
    if arguments.cluster or arguments.workers > 1:
        raise EvaluationError(
            f'experiment {arguments.name} runs in one process, because it measures times or '
            'compares runs as it goes; --workers and --cluster are for experiments 1 and laps'
        )
    from explore_slam.studies.experiments import experiment2, experiment3, experiment4
    from explore_slam.studies.experiments.walk_trials import WalkOptions

    options = WalkOptions(
        seeds=arguments.seeds or range(5),
        particles=arguments.particles or 1000,
        world=arguments.world,
    )
    if arguments.name == '2':
        from explore_slam.studies.experiments.tum_frames import DEFAULTS

        data = arguments.data or _recorded_frames()
        sequence = section_of(arguments, DEFAULTS)
        return experiment2.run(experiment2.Options(options, data, sequence))
    if arguments.name == '3':
        return experiment3.run(options)
    return experiment4.run(options)


def _recorded_frames() -> Path | None:
    """Return the folder tum_fr1_rpy in $EXPLORE_SLAM_DATA, None where there is none."""
    root = os.environ.get('EXPLORE_SLAM_DATA')
    folder = Path(root) / 'tum_fr1_rpy' if root else None
    return folder if folder is not None and folder.is_dir() else None
