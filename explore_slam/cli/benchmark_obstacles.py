"""`explore_slam benchmark obstacles`: contacts with what a laser does not see."""

import argparse
import sys
from pathlib import Path

from explore_slam.cli.arguments import (
    add_seeds_option,
    add_set_option,
    add_workers_options,
    named_settings,
    workers_of,
)

HELP = 'count contacts with tables, shelves and steps that a laser does not see'


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        '--world', default='office_tables', help='world file or name (default office_tables)'
    )
    parser.add_argument('--vehicles', type=int, default=2, help='number of vehicles (default 2)')
    parser.add_argument(
        '--depth',
        choices=('with', 'without'),
        default='with',
        help='with the obstacles of depth images in the map, or without (default with)',
    )
    parser.add_argument(
        '--duration',
        type=float,
        default=300.0,
        help='simulated time (s) after which a run ends (default 300)',
    )
    add_seeds_option(parser, range(10))
    add_workers_options(parser)
    parser.add_argument(
        '--output', type=Path, required=True, help='folder for obstacles.json, table and maps'
    )
    add_set_option(parser)


def run(arguments: argparse.Namespace) -> int:
    """Make the runs, report each as it ends, print the table."""
    from explore_slam.simulation import world_path
    from explore_slam.studies.obstacle_study import ObstacleStudy, markdown_table, run_study

    study = ObstacleStudy(
        world_path(arguments.world),
        arguments.vehicles,
        arguments.depth,
        arguments.duration,
        tuple(arguments.seeds),
        named_settings(arguments, ()),
    )
    runs = []
    for found in run_study(study, arguments.output, workers_of(arguments)):
        runs.append(found)
        print(
            f'[{len(runs)}/{len(study.seeds)}] seed {found.seed}: {found.hazards} contacts with '
            f'boards or steps, {found.contacts} others, {found.tops:.1%} of the tops in the map',
            file=sys.stderr,
            flush=True,
        )
    print(markdown_table(runs), end='')
    print(f'written: {arguments.output / "obstacles.json"}', file=sys.stderr)
    return 0
