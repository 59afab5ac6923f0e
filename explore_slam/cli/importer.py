"""`explore_slam import`: public data sets as bags in the package's own topics."""

import argparse
from pathlib import Path

HELP = 'write a public data set (MR.CLAM, Intel, TUM RGB-D) as a bag'


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('kind', choices=('mrclam', 'intel', 'tum'), help='which data set it is')
    parser.add_argument('folder', type=Path, help='folder of the data set')
    parser.add_argument('out', type=Path, help='bag to write (a new folder)')
    parser.add_argument(
        '--camera',
        default='freiburg1',
        choices=('freiburg1', 'freiburg2', 'freiburg3'),
        help='which Kinect took a TUM data set (default: %(default)s)',
    )


def run(arguments: argparse.Namespace) -> int:
    """Import and tell what was written."""
    counts = _import(arguments)
    for topic, count in sorted(counts.items()):
        print(f'{count:9d}  {topic}')
    print(f'{sum(counts.values())} messages in {arguments.out}')
    return 0


def _import(arguments: argparse.Namespace) -> dict[str, int]:
    folder, out = arguments.folder, arguments.out
    if arguments.kind == 'mrclam':
        from explore_slam.recording.importers.mrclam import import_mrclam

        return import_mrclam(folder, out)
    if arguments.kind == 'intel':
        from explore_slam.recording.importers.intel import import_intel

        return import_intel(folder, out)
    from explore_slam.recording.importers.tum import import_tum

    return import_tum(folder, out, arguments.camera)
