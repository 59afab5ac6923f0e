"""Navigators by name; a new one is a module and a line here."""

from importlib import import_module
from typing import TYPE_CHECKING

from explore_slam.errors import ConfigError

if TYPE_CHECKING:
    from explore_slam.nodes.navigators.navigator import MakeNavigator

# name -> module, whose function `make` makes the navigator of a vehicle; imported when it is used,
# because settings that name a navigator can be read without ROS
NAVIGATORS = {
    'follower': 'explore_slam.nodes.navigators.follower',
    'nav2': 'explore_slam.nodes.navigators.nav2',
    'nav2_path': 'explore_slam.nodes.navigators.nav2_path',
}


def maker(name: str) -> 'MakeNavigator':
    """Return the function that makes the navigators of this name; ConfigError if there is none."""
    if name not in NAVIGATORS:
        raise ConfigError(f'navigator is {name!r}, expected one of {list(NAVIGATORS)}')
    make: MakeNavigator = import_module(NAVIGATORS[name]).make
    return make
