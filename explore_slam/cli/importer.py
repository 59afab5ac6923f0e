"""`explore_slam import`: public data sets as bags with the package's own topics."""

import argparse
from pathlib import Path

from explore_slam.cli.arguments import add_section_options, section_of

HELP = 'write a public data set as a bag'


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare a subcommand for each importer, with its options."""
    from explore_slam.recording.importers.registry import importers

    kinds = parser.add_subparsers(dest='kind', required=True, metavar='KIND')
    for name, importer in importers().items():
        kind = kinds.add_parser(name, help=importer.description, description=importer.description)
        count = '+' if importer.several else 1
        kind.add_argument('sources', type=Path, nargs=count, help=importer.source)
        kind.add_argument('out', type=Path, help='bag to write (a new folder)')
        add_section_options(kind, importer.options)


def run(arguments: argparse.Namespace) -> int:
    """Import the data set and print the messages per topic."""
    from explore_slam.recording.importers.registry import importers

    importer = importers()[arguments.kind]
    options = section_of(arguments, importer.options)
    counts = importer.run(arguments.sources, arguments.out, options)
    for topic, count in sorted(counts.items()):
        print(f'{count:9d}  {topic}')
    print(f'{sum(counts.values())} messages in {arguments.out}')
    return 0
