"""`explore_slam record`: record the live topics of the vehicles."""

import argparse
from pathlib import Path

from explore_slam.cli.arguments import add_topic_option

HELP = 'record the live topics of the vehicles in a bag (needs ROS)'


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('out', type=Path, help='bag to write (a new folder)')
    parser.add_argument('--topics', nargs='+', default=(), help='only these topics')
    parser.add_argument(
        '--vehicles', nargs='+', default=(), help='only the topics of these vehicles'
    )
    add_topic_option(parser)
    parser.add_argument('--sim-time', action='store_true', help='take log times from /clock')


def run(arguments: argparse.Namespace) -> int:
    """Record until Ctrl-C; print the content of the bag."""
    from explore_slam.nodes.recorder import record
    from explore_slam.recording.bag import BagReader

    print(f'recording to {arguments.out}; stop with Ctrl-C', flush=True)
    code = record(arguments)
    with BagReader(arguments.out) as bag:
        for topic, count in sorted(bag.counts.items()):
            print(f'{count:9d}  {topic}')
    return code
