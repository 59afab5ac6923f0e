"""Loops closed by laser, within and between vehicles."""

from explore_slam.slam.closures.anchors import Anchor, Anchors
from explore_slam.slam.closures.closure import Closure
from explore_slam.slam.closures.config import ClosureConfig
from explore_slam.slam.closures.loop_search import LoopSearch

__all__ = ['Anchor', 'Anchors', 'Closure', 'ClosureConfig', 'LoopSearch']
