"""`explore_slam benchmark exploration`: how fast the planner explores a map with teams."""

import argparse
import sys
from pathlib import Path

from explore_slam.cli.arguments import whole_numbers

HELP = 'measure the planner on a map, over team sizes, strategies and seeds'


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    kinds = parser.add_subparsers(dest='kind', required=True, metavar='KIND')
    exploration = kinds.add_parser(
        'exploration',
        help='explore a map in the light 2-D simulator',
        description='Explore a map in the light 2-D simulator; a table, runs.csv and plots.',
    )
    exploration.add_argument(
        '--map', type=Path, required=True, help='map_server map (YAML or PGM) or a world file'
    )
    exploration.add_argument(
        '--vehicles', type=whole_numbers, default=[1, 2, 4], help='team sizes: 1..8 or 1,2,4'
    )
    exploration.add_argument(
        '--strategy',
        action='append',
        metavar='NAME',
        help='exploration strategy; may be repeated (default: default and nearest)',
    )
    exploration.add_argument(
        '--seeds', type=whole_numbers, default=list(range(10)), help='0..9 or 3,5; one run each'
    )
    exploration.add_argument('--output', type=Path, help='folder for table, runs and plots')
    exploration.add_argument(
        '--workers', type=int, default=2, help='processes that make runs at the same time'
    )
    exploration.add_argument(
        '--set',
        action='append',
        default=[],
        metavar='NAME=VALUE',
        help='another value for a setting of the planner or of the study',
    )


def run(arguments: argparse.Namespace) -> int:
    """Make the runs, print their table, save it with --output."""
    from explore_slam.studies.exploration_study import make_study, run_study
    from explore_slam.studies.exploration_tables import markdown_table, save_study

    study = make_study(
        arguments.map,
        arguments.vehicles,
        arguments.strategy or ['default', 'nearest'],
        arguments.seeds,
        arguments.set,
    )
    total = sum(1 for _ in study.tasks())
    runs = []
    for done in run_study(study, arguments.workers):
        runs.append(done)
        print(
            f'[{len(runs)}/{total}] {done.strategy}, {done.vehicles} vehicles, seed {done.seed}: '
            f'{done.status} after {done.duration:.0f} s, 99 % after '
            f'{done.curve.time_to(0.99):.0f} s, {done.real_time_factor:.0f} x real time',
            file=sys.stderr,
            flush=True,
        )
    print(markdown_table(runs))
    if arguments.output is not None:
        for path in save_study(runs, arguments.output):
            print(f'written: {path}', file=sys.stderr)
    return 0
