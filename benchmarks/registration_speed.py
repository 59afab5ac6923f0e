"""Time of the parts of scan registration, in CPU time of one thread.

python benchmarks/registration_speed.py [--beams 181] [--repeat 50]
A laser in a furnished room of 14 m x 10 m; maps of 12 scans as the scan matcher keeps them.
"""

import argparse
import math
import time
from collections.abc import Callable

import numpy as np

from explore_slam import registration
from explore_slam.data import LaserScan
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.registration import (
    LocalMap,
    Prior,
    ScanMatcher,
    ScanMatchingConfig,
    SearchWindow,
    merged,
    scan_cloud,
)

# Axis-parallel walls and furniture: x0, y0, x1, y1 (m).
BOXES = np.array(
    [(0, 0, 14, 10), (3, 3, 6.5, 7), (8, 2.8, 11, 6.8), (1, 4, 1.4, 5), (5, 0.3, 5.8, 0.8)]
)
NOISE = 0.01  # m


def scan_at(pose: Pose2, beams: int, random: np.random.Generator) -> LaserScan:
    """Return a scan of 180 degrees of the boxes."""
    angles = np.linspace(-math.pi / 2, math.pi / 2, beams)
    rays = np.stack([np.cos(angles + pose.theta), np.sin(angles + pose.theta)], axis=1)
    ranges = np.full(beams, np.inf)
    for x0, y0, x1, y1 in BOXES:
        for axis, wall, low, high in (
            (0, x0, y0, y1),
            (0, x1, y0, y1),
            (1, y0, x0, x1),
            (1, y1, x0, x1),
        ):
            with np.errstate(divide='ignore', invalid='ignore'):
                far = (wall - pose[axis]) / rays[:, axis]
            across = pose[1 - axis] + far * rays[:, 1 - axis]
            hit = (far > 0.0) & (across >= low) & (across <= high)
            ranges = np.where(hit, np.minimum(ranges, far), ranges)
    ranges += NOISE * random.normal(size=beams)
    step = math.pi / (beams - 1)
    return LaserScan(0.0, -math.pi / 2, step, ranges.astype(np.float32), 0.0, 80.0)


def milliseconds(action: Callable[[], object], repeat: int) -> float:
    """Return the mean CPU time of an action."""
    action()
    begun = time.process_time()
    for _ in range(repeat):
        action()
    return 1e3 * (time.process_time() - begun) / repeat


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--beams', type=int, default=181)
    parser.add_argument('--repeat', type=int, default=50)
    arguments = parser.parse_args()
    registration.warm_up()
    random = np.random.default_rng(0)
    path = [Pose2(1.8 + 0.4 * k, 1.5, 0.05 * math.sin(k)) for k in range(13)]
    scans = [scan_at(pose, arguments.beams, random) for pose in path]
    clouds = [scan_cloud(scan) for scan in scans]
    placed = [cloud.moved(pose) for cloud, pose in zip(clouds[:-1], path[:-1], strict=True)]
    known, newest, here = LocalMap(placed), clouds[-1], path[-1]
    near = SearchWindow(here.compose(Pose2(0.1, -0.1, 0.05)), 0.3, 0.2, math.radians(1.5))
    wide = SearchWindow(here, 4.0, math.pi, math.radians(2.0))
    prior = Prior(near.centre, np.diag([1 / 0.05**2, 1 / 0.05**2, 1 / 0.05**2]))
    query = merged([cloud.moved(here.inverse()) for cloud in placed])

    def drive() -> None:
        matcher = ScanMatcher(ScanMatchingConfig())
        for scan, pose in zip(scans, path, strict=True):
            measured = pose.compose(Pose2(0.03, 0.01, 0.02))
            matcher.match(scan, IDENTITY, measured, np.diag([0.05, 0.05, 0.05]) ** 2)

    def grid() -> None:
        LocalMap(placed).grid.levels(3)

    rows: list[tuple[str, Callable[[], object]]] = [
        ('cloud of a scan with normals', lambda: scan_cloud(scans[0])),
        ('likelihood grid of 12 scans', grid),
        ('surfaces of 12 scans', lambda: LocalMap(placed).surfaces),
        (
            'correlation, 0.3 m, 11 degrees',
            lambda: known.find_peak(newest.query_points, near, 0.1),
        ),
        (
            'correlation of 12 scans, 4 m, 360 degrees',
            lambda: known.find_peak(query.query_points, wide, 0.4),
        ),
        ('alignment of a scan', lambda: known.align(newest, near.centre, 0.4, prior)),
    ]
    for name, action in rows:
        print(f'{name:45s} {milliseconds(action, arguments.repeat):7.3f} ms')
    each = milliseconds(drive, max(arguments.repeat // 10, 1)) / len(scans)
    print(f'{"scan matcher, per scan":45s} {each:7.3f} ms')


if __name__ == '__main__':
    main()
