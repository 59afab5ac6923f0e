"""`explore_slam import`: public data sets as bags with the package's own topics."""

import argparse
from pathlib import Path

HELP = 'write a public data set as a bag'


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare a subcommand for each importer, with its options."""
    from explore_slam.recording.importers.registry import importers
    from explore_slam.settings import settings_of

    kinds = parser.add_subparsers(dest='kind', required=True, metavar='KIND')
    for name, importer in importers().items():
        kind = kinds.add_parser(name, help=importer.description, description=importer.description)
        count = '+' if importer.several else 1
        kind.add_argument('sources', type=Path, nargs=count, help=importer.source)
        kind.add_argument('out', type=Path, help='bag to write (a new folder)')
        for info, value in settings_of(importer.options):
            kind.add_argument(
                '--' + info.name.replace('_', '-'),
                type=type(value),
                default=value,
                choices=info.choices or None,
                help=f'{info.doc} (default: %(default)s)',
            )


def run(arguments: argparse.Namespace) -> int:
    """Import the data set and print the messages per topic."""
    from explore_slam.recording.importers.registry import importers
    from explore_slam.settings import values_of, with_values

    importer = importers()[arguments.kind]
    given = {name: getattr(arguments, name) for name in values_of(importer.options)}
    options = with_values(importer.options, given)
    counts = importer.run(arguments.sources, arguments.out, options)
    for topic, count in sorted(counts.items()):
        print(f'{count:9d}  {topic}')
    print(f'{sum(counts.values())} messages in {arguments.out}')
    return 0
