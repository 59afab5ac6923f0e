"""The command line, `explore_slam COMMAND ...`; each command is a module of this package."""

import argparse
import importlib
import io
import logging
import os
import sys
from collections.abc import Sequence

from explore_slam.environment import (
    prepare_libraries,
    prepare_ros,
    return_large_arrays,
    start_isolated,
)
from explore_slam.failures import run_guarded

# Command -> module with HELP, configure(parser) and run(arguments) -> exit code.
COMMANDS = {
    'demo': 'demo',
    'replay': 'replay',
    'record': 'record',
    'play': 'play',
    'import': 'importer',
    'report': 'report',
    'settings': 'settings',
    'experiment': 'experiment',
    'benchmark': 'benchmark',
}
ROS_COMMANDS = ('play', 'record')  # those that talk to robots, as the shell is set up


def build_parser(wanted: str | None) -> argparse.ArgumentParser:
    """Return the parser; only the wanted command declares its options."""
    parser = argparse.ArgumentParser(
        prog='explore_slam',
        description='Multi-robot exploration with FastSLAM on a common landmark map.',
    )
    parser.add_argument('-v', '--verbose', action='store_true', help='show log messages')
    commands = parser.add_subparsers(dest='command', required=True, metavar='COMMAND')
    for name, module_name in COMMANDS.items():
        module = importlib.import_module(f'explore_slam.cli.{module_name}')
        command = commands.add_parser(name, help=module.HELP, description=module.HELP)
        if name == wanted:
            module.configure(command)
        command.set_defaults(run=module.run)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; what it raises is one line on stderr and exit code 1 (`run_guarded`)."""
    if arguments is None:
        start_isolated()
    words = list(sys.argv[1:] if arguments is None else arguments)
    wanted = next((word for word in words if word in COMMANDS), None)
    return run_guarded(f'explore_slam {wanted or ""}'.strip(), lambda: _run(words, wanted))


def _run(words: list[str], wanted: str | None) -> int:
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors='replace')  # m² on a terminal that cannot show it
    prepare_libraries(os.environ)
    return_large_arrays()
    if wanted in ROS_COMMANDS:
        prepare_ros(os.environ)
    elif wanted != 'demo':  # which names what it does not use
        os.environ.pop('RMW_IMPLEMENTATION', None)  # nothing is sent, but rclpy may be imported
    parsed = build_parser(wanted).parse_args(words)
    level = logging.INFO if parsed.verbose else logging.WARNING
    logging.basicConfig(level=level, format='%(levelname)s %(name)s: %(message)s')
    return int(parsed.run(parsed))


if __name__ == '__main__':
    sys.exit(main())
