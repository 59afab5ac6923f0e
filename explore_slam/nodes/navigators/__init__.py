"""Navigators by name; a new one is a module and a line here."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from explore_slam.nodes.navigators.navigator import MakeNavigator

# name -> module, whose function `make` makes the navigator of a vehicle; imported when it is used,
# because settings that name a navigator can be read without ROS
NAVIGATORS = {'follower': 'explore_slam.nodes.navigators.follower'}


def maker(name: str) -> 'MakeNavigator':
    """Return the function that makes the navigators of this name."""
    make: MakeNavigator = import_module(NAVIGATORS[name]).make
    return make
