"""`explore_slam benchmark sensors`: accuracy with sensors as people have them."""

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

HELP = 'measure pose and map with spinning lidars on a turning vehicle'


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_seeds_option(parser, range(5))
    parser.add_argument(
        '--case',
        action='append',
        default=[],
        metavar='TEXT',
        help='only cases whose title contains this; may be repeated',
    )
    add_workers_options(parser, 1)
    parser.add_argument('--output', type=Path, help='folder for sensors.json and pictures')
    add_set_option(parser)


def run(arguments: argparse.Namespace) -> int:
    """Make the runs, report each as it ends, print the table."""
    from explore_slam.studies.sensor_study import SensorStudy, markdown_table, run_study

    study = SensorStudy(
        arguments.seeds, titles=arguments.case, settings=named_settings(arguments, ())
    )
    total = len(study.cases()) * len(study.seeds)
    runs = []
    for done in run_study(study, arguments.output, workers_of(arguments)):
        runs.append(done)
        print(
            f'[{len(runs)}/{total}] {done.title}, seed {done.seed}: '
            f'{done.position_rms:.3f} m, {100.0 * done.wrong_cells:.1f} % of the cells off, '
            f'{done.unmatched} scans unmatched, {done.scan_ms:.1f} ms per scan',
            file=sys.stderr,
            flush=True,
        )
    print(markdown_table(runs), end='')
    if arguments.output is not None:
        print(f'written: {arguments.output / "sensors.json"}', file=sys.stderr)
    return 0
