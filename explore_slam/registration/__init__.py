"""Scan registration without a filter: clouds, local maps, correlation, alignment, matching."""

import numpy as np

from explore_slam.data import LaserScan
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.registration.alignment import Alignment, Prior, align
from explore_slam.registration.cloud import PointCloud, merged, scan_cloud, thinned
from explore_slam.registration.config import ScanMatchingConfig
from explore_slam.registration.correlation import Peak, SearchWindow
from explore_slam.registration.local_map import LocalMap
from explore_slam.registration.scan_matcher import (
    Refusal,
    RefusedScan,
    ScanMatch,
    ScanMatcher,
)

__all__ = [
    'Alignment',
    'LocalMap',
    'Peak',
    'PointCloud',
    'Prior',
    'Refusal',
    'RefusedScan',
    'ScanMatch',
    'ScanMatcher',
    'ScanMatchingConfig',
    'SearchWindow',
    'align',
    'merged',
    'scan_cloud',
    'thinned',
    'warm_up',
]


def warm_up() -> None:
    """Compile every kernel of the package, so that no later call waits for the compiler."""
    ranges = np.full(361, 2.0, np.float32)
    scan = LaserScan(0.0, -1.5, 0.01, ranges, 0.0, 10.0)
    matcher = ScanMatcher(ScanMatchingConfig())
    for x in (0.0, 0.0, 0.5):
        matcher.match(scan, IDENTITY, Pose2(x, 0.0, 0.0), 1e-4 * np.eye(3))
    cloud = scan_cloud(scan)
    window = SearchWindow(IDENTITY, 1.0, 0.1)
    local_map = LocalMap([cloud])
    local_map.find_other_mode(cloud.query_points, window, IDENTITY, (0.5, 0.1), 0.1)
    local_map.score_profile(cloud.query_points, IDENTITY, (1.0, 0.0), np.zeros(1))
    local_map.align(cloud, IDENTITY, 0.4)
