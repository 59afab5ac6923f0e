"""`explore_slam settings`: every setting with its default, meaning, unit and range."""

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from explore_slam.settings import Section

HELP = 'list all settings as a ROS parameter file'
PARTS = ('agent', 'driver', 'follower', 'simulator')


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        'part', nargs='?', default='agent', choices=PARTS, help='whose settings (default agent)'
    )
    parser.add_argument(
        '--tier', choices=('basic', 'advanced'), help='only those of this tier (default: all)'
    )


def run(arguments: argparse.Namespace) -> int:
    """Print the settings with their defaults."""
    from explore_slam.settings import settings_text

    print(settings_text(_defaults(arguments.part), arguments.tier), end='')
    return 0


def _defaults(part: str) -> 'Section':
    if part == 'agent':
        from explore_slam.nodes.agent_parameters import AgentNodeConfig

        return AgentNodeConfig()
    if part == 'driver':
        from explore_slam.nodes.driver_parameters import DriverNodeConfig

        return DriverNodeConfig()
    if part == 'simulator':
        from explore_slam.simulation import SimulationConfig

        return SimulationConfig()
    from explore_slam.vehicle import PathFollowerConfig

    return PathFollowerConfig()
