"""`explore_slam play`: a recorded bag over live topics."""

import argparse
from pathlib import Path

HELP = 'play a recorded bag over live topics, with /clock (needs ROS)'


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('bag', type=Path, help='rosbag2 folder, or its .mcap or .db3 file')
    parser.add_argument('--rate', type=float, default=1.0, help='times real time (default 1)')
    parser.add_argument('--topics', nargs='+', default=(), help='these topics and no others')
    parser.add_argument('--vehicles', nargs='+', default=(), help="these vehicles' topics")
    parser.add_argument('--until', type=float, metavar='SECONDS', help='stop after this time')
    parser.add_argument('--no-clock', action='store_true', help='do not publish /clock')
    parser.add_argument('--no-progress', action='store_true', help='do not draw the bar')


def run(arguments: argparse.Namespace) -> int:
    """Play to the end or until Ctrl-C."""
    from explore_slam.cli.progress import progress_bar
    from explore_slam.nodes.player import play

    with progress_bar(arguments.bag.name, enabled=not arguments.no_progress) as show:
        counts = play(
            arguments.bag,
            rate=arguments.rate,
            topics=arguments.topics,
            vehicles=arguments.vehicles,
            clock=not arguments.no_clock,
            until=arguments.until,
            progress=show,
        )
    print(f'{sum(counts.values())} messages on {len(counts)} topics')
    return 0
