"""`explore_slam record`: the vehicles' live topics into a bag."""

import argparse
from pathlib import Path

HELP = "record the vehicles' live topics into a bag (needs ROS)"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('out', type=Path, help='bag to write (a new folder)')
    parser.add_argument('--topics', nargs='+', default=(), help='these topics and no others')
    parser.add_argument('--vehicles', nargs='+', default=(), help="these vehicles' topics")
    parser.add_argument('--sim-time', action='store_true', help='log times from /clock')


def run(arguments: argparse.Namespace) -> int:
    """Record until Ctrl-C; tell what is in the bag."""
    from explore_slam.nodes.recorder import record
    from explore_slam.recording.bag import BagReader

    print(f'recording into {arguments.out}; Ctrl-C ends it', flush=True)
    code = record(arguments)
    with BagReader(arguments.out) as bag:
        for topic, count in sorted(bag.counts.items()):
            print(f'{count:9d}  {topic}')
    return code
