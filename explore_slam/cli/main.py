"""The command line, `explore_slam COMMAND ...`; each command is a module of this package."""

import argparse
import importlib
import logging
import sys
from collections.abc import Sequence

from explore_slam.errors import ExploreSlamError

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
    """Run a command; an ExploreSlamError is one line on stderr and exit code 1."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    wanted = next((word for word in words if word in COMMANDS), None)
    parsed = build_parser(wanted).parse_args(words)
    level = logging.INFO if parsed.verbose else logging.WARNING
    logging.basicConfig(level=level, format='%(levelname)s %(name)s: %(message)s')
    try:
        return int(parsed.run(parsed))
    except ExploreSlamError as error:
        print(f'explore_slam {parsed.command}: {error}', file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print('interrupted', file=sys.stderr)
        return 130
    except BrokenPipeError:
        return 1


if __name__ == '__main__':
    sys.exit(main())
