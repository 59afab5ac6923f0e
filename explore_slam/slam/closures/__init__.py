"""Loops closed by laser, within and between vehicles."""

import numpy as np

from explore_slam.data import LaserScan
from explore_slam.registration import scan_cloud
from explore_slam.slam.closures.anchors import Anchor, Anchors
from explore_slam.slam.closures.closure import Closure
from explore_slam.slam.closures.closure_thinning import ClosureThinning
from explore_slam.slam.closures.config import ClosureConfig
from explore_slam.slam.closures.global_search import GlobalSearch, join_transform
from explore_slam.slam.closures.loop_search import LoopSearch, RelativeCovariance
from explore_slam.slam.closures.thinning import Thinning

__all__ = [
    'Anchor',
    'Anchors',
    'Closure',
    'ClosureConfig',
    'ClosureThinning',
    'GlobalSearch',
    'LoopSearch',
    'RelativeCovariance',
    'Thinning',
    'join_transform',
    'warm_up',
]


def warm_up() -> None:
    """Compile the kernels that a search uses, so that no later call waits for the compiler."""
    ranges = (3.0 + np.sin(np.arange(361) / 15.0)).astype(np.float32)
    cloud = scan_cloud(LaserScan(0.0, -1.5, 0.01, ranges, 0.0, 10.0))
    search = LoopSearch(ClosureConfig(closure_every=1))
    for keyframe in range(2):
        search.add_anchor(keyframe, 0, cloud, 20.0 * keyframe, float(keyframe))
        search.search(keyframe, np.zeros((2, 3)))
