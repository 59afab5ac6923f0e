"""`explore_slam benchmark mapping`: how accurate maps from a laser log are."""

import argparse
import dataclasses
import sys
import tempfile
from pathlib import Path

from explore_slam.cli.arguments import add_seeds_option, add_set_option, named_settings

HELP = 'replay a laser log and measure its map against reference relations'


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('log', type=Path, help='CARMEN log, or a bag')
    parser.add_argument(
        'relations', type=Path, nargs='?', help='reference relations (SLAM benchmark)'
    )
    add_seeds_option(parser, range(5))
    parser.add_argument('--output', type=Path, help='folder for mapping.json, table and maps')
    parser.add_argument(
        '--offset',
        type=float,
        metavar='SECONDS',
        help='time of the relations minus time of the log (default: found)',
    )
    parser.add_argument(
        '--cut',
        type=float,
        metavar='SECONDS',
        help='make two vehicles of the log: before and after this time, driven at the same time',
    )
    parser.add_argument(
        '--starts',
        choices=('known', 'unknown'),
        default='known',
        help='whether the start pose of the second vehicle is given (default known)',
    )
    add_set_option(parser)


def run(arguments: argparse.Namespace) -> int:
    """Make the runs, print their table, save it and the maps with --output."""
    from explore_slam.studies.mapping_log import prepare
    from explore_slam.studies.mapping_study import markdown_table, run_study, save_study

    with tempfile.TemporaryDirectory(prefix='explore_slam_') as scratch:
        task = prepare(
            arguments.log,
            Path(scratch),
            relations=arguments.relations,
            offset=arguments.offset,
            cut=arguments.cut,
            starts=arguments.starts,
            settings=named_settings(arguments, ()),
        )
        for note in task.notes:
            print(f'note: {note}', file=sys.stderr)
        if arguments.output is not None:
            arguments.output.mkdir(parents=True, exist_ok=True)
            task = dataclasses.replace(task, picture_folder=arguments.output)
        runs = []
        for figures in run_study(task, arguments.seeds):
            runs.append(figures)
            print(
                f'[{len(runs)}/{len(arguments.seeds)}] seed {figures["seed"]}: '
                f'{figures["seconds"]:.1f} s',
                file=sys.stderr,
                flush=True,
            )
            if arguments.output is not None:
                save_study(task, runs, arguments.output)
    print(markdown_table(runs))
    if arguments.output is not None:
        print(f'written: {arguments.output}', file=sys.stderr)
    return 0
