"""`explore_slam benchmark tags`: joins, closures and the map's frame by tags among equal rooms."""

import argparse
import sys
from pathlib import Path

from explore_slam.cli.arguments import (
    add_set_option,
    add_workers_options,
    named_settings,
    whole_numbers,
    workers_of,
)

HELP = 'join vehicles and fix the map by tags in corridors of equal rooms'


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        '--worlds',
        type=whole_numbers,
        default=list(range(12)),
        help='such as 0..11 or 3,5; one run each (default 0..11)',
    )
    parser.add_argument(
        '--surveyed', type=int, default=2, help='tags of known pose: 0, 1 or 2 (default 2)'
    )
    parser.add_argument(
        '--misread',
        type=float,
        default=0.0,
        metavar='SHARE',
        help='share of the tags seen that get the number of another one (default 0)',
    )
    add_workers_options(parser)
    parser.add_argument('--output', type=Path, help='folder for tags.json')
    add_set_option(parser)


def run(arguments: argparse.Namespace) -> int:
    """Make the runs, report each as it ends, print their table, save it with --output."""
    from explore_slam.cli.progress import report_runs
    from explore_slam.studies.tag_study import TagStudy, markdown_table, run_study, save_study

    study = TagStudy(
        arguments.worlds, arguments.surveyed, arguments.misread, named_settings(arguments, ())
    )
    output = arguments.output
    runs = report_runs(
        run_study(study, workers_of(arguments)),
        len(study.worlds),
        lambda one: (
            f'world {one.world}: {one.false_closures} of '
            f'{one.closures} closures false, joined after {one.joined_after_m:.1f} m, map '
            f'{one.frame_m:.3f} m and {one.frame_deg:.3f} degrees off, {one.seconds:.1f} s'
        ),
        output and (lambda so_far: save_study(study, so_far, output)),
    )
    print(markdown_table(runs), end='')
    if arguments.output is not None:
        print(f'written: {arguments.output / "tags.json"}', file=sys.stderr)
    return 0
