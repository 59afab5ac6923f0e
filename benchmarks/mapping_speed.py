"""Speed of the grid map: insertion of a 361-beam scan at 0.05 m, redraw of many keyframes.

python benchmarks/mapping_speed.py [--keyframes 5000]
"""

import argparse
import math
import time

import numpy as np

from explore_slam.data import LaserScan
from explore_slam.geometry import Array, Pose2
from explore_slam.mapping import GridConfig, LaserMap, OccupancyGrid, warm_up

BEAMS = 361
HALLS = 12.0  # m, side of the square halls that the vehicle drives through


def room_scan(x: float, y: float, theta: float) -> LaserScan:
    """Simulate a scan in a square hall; every 50th beam has no return."""
    angles = -math.pi / 2 + math.pi / (BEAMS - 1) * np.arange(BEAMS) + theta
    left, low = math.floor(x / HALLS) * HALLS, math.floor(y / HALLS) * HALLS
    with np.errstate(divide='ignore', invalid='ignore'):
        to_x = np.where(np.cos(angles) > 0, left + HALLS - x, left - x) / np.cos(angles)
        to_y = np.where(np.sin(angles) > 0, low + HALLS - y, low - y) / np.sin(angles)
    ranges = np.fmin(to_x, to_y)
    ranges[::50] = np.inf
    return LaserScan(
        0.0, -math.pi / 2, math.pi / (BEAMS - 1), ranges.astype(np.float32), 0.02, 30.0
    )


def drive(count: int) -> Array:
    """Return a path (K, 3) through the halls with a keyframe every 0.3 m."""
    at = 0.3 * np.arange(count)
    lane = np.floor(at / 60.0)
    along = np.where(lane % 2 == 0, at % 60.0, 60.0 - at % 60.0)
    theta = np.where(lane % 2 == 0, 0.0, math.pi)
    return np.stack([1.0 + along, 3.0 + 1.5 * (lane % 30), theta], axis=1)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--keyframes', type=int, default=5000)
    arguments = parser.parse_args()
    begun = time.perf_counter()
    warm_up()
    print(f'warm-up (kernels from the cache or compiled): {time.perf_counter() - begun:.2f} s')
    path = drive(arguments.keyframes)
    scans = [room_scan(*pose) for pose in path]
    grid = OccupancyGrid(GridConfig(resolution=0.05))
    wall, cpu = [], []
    for pose, scan in zip(path[:500], scans, strict=False):
        begun, used = time.perf_counter(), time.process_time()
        grid.insert_scan(Pose2(*pose.tolist()), scan)
        wall.append(1e3 * (time.perf_counter() - begun))
        cpu.append(1e3 * (time.process_time() - used))
    print(
        f'insert one scan of {BEAMS} beams at 0.05 m: median {np.median(wall):.2f} ms; '
        f'CPU time p95 {np.quantile(cpu, 0.95):.2f} ms, growth of the grid included '
        '(required: 2 ms)'
    )
    laser_map = LaserMap(GridConfig(resolution=0.05))
    for number, scan in enumerate(scans):
        laser_map.add(number, 'robot1', scan)
    begun = time.perf_counter()
    laser_map.redraw(path)
    shape = laser_map.grid.shape
    print(f'draw {len(path)} keyframes from scratch: {time.perf_counter() - begun:.2f} s, {shape}')
    for share in (0.0, 0.5, 0.9, 0.99):
        first = int(share * len(path))
        path = path.copy()
        path[first:, 0] += 0.01
        begun = time.perf_counter()
        summary = laser_map.redraw(path)
        seconds = time.perf_counter() - begun
        print(f'redraw from keyframe {first}: {seconds:.3f} s, {summary.drawn} scans drawn')


if __name__ == '__main__':
    main()
