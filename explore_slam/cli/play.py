"""`explore_slam play`: publish a recorded bag on live topics."""

import argparse
from pathlib import Path

from explore_slam.cli.arguments import add_topic_option

HELP = 'publish a recorded bag on live topics, with /clock (needs ROS)'


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        'bag', type=Path, help='rosbag2 folder, or a .mcap, .db3 or ROS 1 .bag file'
    )
    parser.add_argument(
        '--rate', type=float, default=1.0, help='speed relative to real time (default 1)'
    )
    parser.add_argument('--topics', nargs='+', default=(), help='only these topics')
    parser.add_argument(
        '--vehicles', nargs='+', default=(), help='only the topics of these vehicles'
    )
    add_topic_option(parser)
    parser.add_argument('--until', type=float, metavar='SECONDS', help='stop after this time')
    parser.add_argument('--no-clock', action='store_true', help='do not publish /clock')
    parser.add_argument('--no-progress', action='store_true', help='do not show progress')


def run(arguments: argparse.Namespace) -> int:
    """Play until the end or until Ctrl-C."""
    from explore_slam.cli.progress import progress_bar
    from explore_slam.nodes.player import play
    from explore_slam.recording.topic_selection import topic_choices

    with progress_bar(arguments.bag.name, enabled=not arguments.no_progress) as show:
        counts = play(
            arguments.bag,
            rate=arguments.rate,
            topics=arguments.topics,
            vehicles=arguments.vehicles,
            clock=not arguments.no_clock,
            until=arguments.until,
            choices=topic_choices(arguments.topic),
            progress=show,
        )
    print(f'{sum(counts.values())} messages on {len(counts)} topics')
    return 0
