"""Graph SLAM by laser on a CARMEN log: front end, loop closing and pose graph, no particle filter.

python benchmarks/laser_graph_slam.py LOG [RELATIONS] [--offset S] [--corrupt SEED] [--map PNG]
                                     [--cut FRACTION]

One vehicle without a filter: every scan is a keyframe of the joint graph. RELATIONS: see
results.relations; time of a relation = time of the log + offset. --corrupt adds scale errors of
turning and of driving, and noise, to the odometry. --cut: the scans after this fraction of the log
are those of a second vehicle that starts at an unknown pose in the map of the first; printed is
when it is joined to that map, and how accurately.
"""

import argparse
import math
import resource
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from explore_slam import registration
from explore_slam.data import LaserScan
from explore_slam.geometry import IDENTITY, Array, Pose2, between, compose, moved_enough, rotated
from explore_slam.recording.carmen_log import read_carmen
from explore_slam.registration import (
    RefusedScan,
    ScanMatch,
    ScanMatcher,
    ScanMatchingConfig,
    scan_cloud,
)
from explore_slam.results.relations import (
    LOOP_SECONDS,
    LoggedOdometry,
    Relations,
    find_offset,
    relation_errors,
)
from explore_slam.results.trajectory import align, position_errors
from explore_slam.slam import graph as graph_package
from explore_slam.slam.closures import (
    Anchor,
    Anchors,
    Closure,
    ClosureConfig,
    GlobalSearch,
    LoopSearch,
    join_transform,
)
from explore_slam.slam.graph import GraphConfig, JointGraph

SEARCH_EVERY = 3  # anchors of a newcomer
# Scale errors of the corrupted odometry (deviations): what badly calibrated wheels have.
TURN_SCALE, DISTANCE_SCALE = 0.05, 0.03
TURN_NOISE, DISTANCE_NOISE = 0.1, 0.1  # rad/rad and rad/m (half of it), m/m


@dataclass(frozen=True)
class Log:
    """Scans with odometry poses (N, 3), true poses (N, 3) where known, and all odometry.

    laser: its pose on the vehicle. All poses are those of the vehicle.
    """

    scans: list[LaserScan]
    odometry: Array
    reference: Array | None
    laser: Pose2
    recorded: LoggedOdometry


def read_log(path: Path) -> Log:
    """Read a CARMEN log with the times that are written in it."""
    log = read_carmen(path)
    times = np.where(np.isfinite(log.times), log.times, log.stamps)
    scans = [
        scan.record(max(float(stamp), 0.0))
        for stamp, scan in zip(times[log.rows], log.scans, strict=True)
    ]
    known = np.array([scan.robot for scan in log.scans]) if log.corrected else None
    recorded = LoggedOdometry(times, log.odometry).sorted()
    return Log(scans, log.odometry[log.rows], known, log.mount, recorded)


def corrupted(log: Log, seed: int) -> Log:
    """Return the log with scale errors and noise on the increments of its odometry."""
    random = np.random.default_rng(seed)
    turn_scale = 1.0 + TURN_SCALE * random.normal()
    distance_scale = 1.0 + DISTANCE_SCALE * random.normal()
    poses = [log.odometry[0]]
    for u in between(log.odometry[:-1], log.odometry[1:]):
        distance, turn = math.hypot(u[0], u[1]), abs(u[2])
        noise = random.normal(size=3)
        worse = np.array(
            [
                u[0] * distance_scale + DISTANCE_NOISE * distance * noise[0],
                u[1] * distance_scale + 0.5 * DISTANCE_NOISE * distance * noise[1],
                u[2] * turn_scale + TURN_NOISE * (turn + 0.5 * distance) * noise[2],
            ]
        )
        poses.append(compose(poses[-1], worse))
    # the evaluation interpolates between scans with the odometry as it was recorded
    return replace(log, odometry=np.array(poses))


def odometry_covariance(increment: Pose2) -> Array:
    """Return a generous covariance (3, 3), in the frame where the increment begins."""
    distance, turn = math.hypot(increment.x, increment.y), abs(increment.theta)
    along, across = 0.1 * distance + 0.02, 0.05 * distance + 0.02
    deviations = [along, across, 0.15 * turn + 0.05 * distance + 0.01]
    return np.diag(deviations) ** 2


@dataclass
class Mapped:
    """Poses (N, 3) of the front end and of the graph, and what they cost (s of CPU)."""

    front_end: Array
    poses: Array
    closures: int
    retracted: int
    refused: int
    seconds: dict[str, float]
    longest: float


def run(log: Log, *, calibrated: bool = False) -> Mapped:
    """Map a log: match every scan, search loops at the anchors, optimize after closures."""
    matcher, config = ScanMatcher(ScanMatchingConfig()), ScanMatchingConfig()
    search = LoopSearch(ClosureConfig())
    graph = JointGraph(GraphConfig(graph_bounded=False))
    factors: list[int] = []
    seconds = dict.fromkeys(('front end', 'search', 'graph'), 0.0)
    front, refused, made, driven, longest = [IDENTITY], 0, 0, 0.0, 0.0
    last_anchor: Pose2 | None = None
    pose = IDENTITY
    for k, scan in enumerate(log.scans):
        begun = time.process_time()
        increment = IDENTITY
        if k:
            increment = Pose2.from_array(between(log.odometry[k - 1], log.odometry[k]))
        Q = odometry_covariance(increment)
        cloud = scan_cloud(scan, log.laser, config.matching_range)
        result = matcher.match_cloud(cloud, pose.compose(increment), rotated(Q, increment.theta))
        moved = pose.between(result.pose)
        pose = result.pose
        matched = time.process_time()
        seconds['front end'] += matched - begun
        if k == 0:
            graph.add_start(0, 0, np.zeros(3))
        elif isinstance(result, ScanMatch):
            drift = rotated(result.drift, -moved.theta)
            graph.add_keyframe(0, k, np.asarray(moved), drift, result.white)
        else:
            refused += isinstance(result, RefusedScan)
            graph.add_keyframe(0, k, np.asarray(moved), Q)
        if k:
            front.append(pose)
            driven += math.hypot(moved.x, moved.y)
        new = []
        if (k == 0 or isinstance(result, ScanMatch)) and (
            last_anchor is None or moved_enough(last_anchor.between(pose), 0.2, 0.2)
        ):
            last_anchor = pose
            search.add_anchor(k, 0, cloud, driven, scan.stamp)
            covariance = graph.relative_covariance if calibrated else None
            new = search.search(k, graph.path(), covariance)
        searched = time.process_time()
        seconds['search'] += searched - matched
        if new:
            made += len(new)
            factors += close(graph, new)
            factors = take_back(graph, search, factors)
        done = time.process_time()
        seconds['graph'] += done - searched
        longest = max(longest, done - begun)
    graph.optimize()
    kept = len(search.closures)
    return Mapped(np.array(front), graph.path(), kept, made - kept, refused, seconds, longest)


def close(graph: JointGraph, closures: list[Closure]) -> list[int]:
    """Add closures, optimize, and return their factors.

    They get a robust kernel only afterwards: from a start that is far off, it
    would take new closures for outliers, however many of them agree.
    """

    def add(*, robust: bool) -> list[int]:
        return [
            graph.add_relative_pose(
                c.keyframe_a, c.keyframe_b, np.asarray(c.pose), c.information, robust=robust
            )
            for c in closures
        ]

    certain = add(robust=False)
    graph.optimize()
    for factor in certain:
        graph.remove_factor(factor)
    factors = add(robust=True)
    graph.optimize()
    return factors


def take_back(graph: JointGraph, search: LoopSearch, factors: list[int]) -> list[int]:
    """Remove the closures that have become inconsistent; return the factors of the others."""
    numbers, distances = graph.closure_residuals()
    at = dict(zip(numbers.tolist(), distances.tolist(), strict=True))
    of_closure = {id(c): f for c, f in zip(search.closures, factors, strict=True)}
    for closure in search.recheck(np.array([at[factor] for factor in factors])):
        graph.remove_factor(of_closure[id(closure)])
    return [of_closure[id(closure)] for closure in search.closures]


@dataclass(frozen=True)
class Joined:
    """After which distance driven (m) a newcomer was joined to the map; its error (m, rad)."""

    driven: float
    position_error: float
    heading_error: float
    searches: int
    seconds: float
    longest_slice: float


def join(log: Log, fraction: float) -> Joined | None:
    """Map the log up to a fraction of it, then let the rest find its place in that map.

    The error is that of the joined frame against the log's own poses, at the newest scan.
    """
    cut = int(fraction * len(log.scans))
    first = run(replace(log, scans=log.scans[:cut], odometry=log.odometry[:cut]))
    second = run(replace(log, scans=log.scans[cut:], odometry=log.odometry[cut:]))
    poses = np.concatenate([first.poses, second.poses])
    anchors, driven, last = Anchors(), 0.0, None
    search, searches, seconds, longest = GlobalSearch(ClosureConfig(), anchors), 0, 0.0, 0.0
    for k, scan in enumerate(log.scans):
        if k == cut:
            driven, last = 0.0, None
        pose = Pose2.from_array(poses[k])
        moved = IDENTITY if last is None else last.between(pose)
        if last is not None and not moved_enough(moved, 0.2, 0.2):
            continue
        driven, last = driven + math.hypot(moved.x, moved.y), pose
        cloud = scan_cloud(scan, log.laser, 40.0)
        anchors.add(Anchor(k, int(k >= cut), driven, scan.stamp, cloud))
        if k < cut or anchors.number_added(1) % SEARCH_EVERY:
            continue
        searches += 1
        begun = time.process_time()
        for closures in search.search(k, poses, [0]):
            done = time.process_time()
            longest, seconds, begun = max(longest, done - begun), seconds + done - begun, done
            if not closures:
                continue
            joined = np.asarray(join_transform(closures, poses).compose(pose))
            off = np.full(3, np.nan)
            if log.reference is not None:
                at = closures[-1].keyframe_a
                true = between(log.reference[at], log.reference[k])
                off = between(true, between(poses[at], joined))
            position, heading = math.hypot(off[0], off[1]), abs(float(off[2]))
            return Joined(driven, position, heading, searches, seconds, longest)
    return None


def evaluation(log: Log, poses: Array, relations: Relations | None, offset: float | None) -> str:
    """Return the errors over relations, and the distances (m) from the log's own poses."""
    parts = []
    if relations is not None:
        times = np.array([scan.stamp for scan in log.scans])
        if offset is None:
            offset = find_offset(relations, log.recorded, log.laser)
        found = relation_errors(relations, times, poses, log.recorded, offset, log.laser)
        near, loops = found.seconds <= LOOP_SECONDS, found.seconds > LOOP_SECONDS
        error = found.translation
        parts.append(
            f'all {error.mean():.4f} ± {error.std():.4f} m, '
            f'{math.degrees(found.rotation.mean()):.2f}°; '
            f'near {error[near].mean():.4f} m; loops {error[loops].mean():.4f} m'
        )
    if log.reference is not None:
        off = position_errors(align(poses, log.reference), log.reference)
        parts.append(f'RMS to the log {np.sqrt((off**2).mean()):.3f} m, most {off.max():.2f} m')
    return '; '.join(parts)


def draw_map(log: Log, poses: Array, path: Path) -> None:
    """Write all returns within 20 m and the path as a picture."""
    from matplotlib import pyplot as plt

    points = np.concatenate(
        [
            scan_cloud(scan, log.laser, 20.0).moved(Pose2.from_array(pose)).points
            for scan, pose in zip(log.scans, poses, strict=True)
        ]
    )
    figure, axes = plt.subplots(figsize=(14, 14), dpi=100)
    axes.plot(points[:, 0], points[:, 1], ',', color='black', alpha=0.4)
    axes.plot(poses[:, 0], poses[:, 1], '-', color='tab:red', linewidth=0.6)
    low, high = np.quantile(points, 0.002, axis=0) - 2.0, np.quantile(points, 0.998, axis=0) + 2.0
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect='equal')
    figure.savefig(path, bbox_inches='tight')


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('log', type=Path)
    parser.add_argument('relations', type=Path, nargs='?')
    parser.add_argument('--offset', type=float, help='s; default: where the times coincide')
    parser.add_argument('--corrupt', type=int, metavar='SEED')
    parser.add_argument('--calibrated', action='store_true', help='windows by the graph')
    parser.add_argument('--map', type=Path)
    parser.add_argument('--cut', type=float, metavar='FRACTION')
    arguments = parser.parse_args()
    registration.warm_up()
    graph_package.warm_up()
    log = read_log(arguments.log)
    if arguments.corrupt is not None:
        log = corrupted(log, arguments.corrupt)
    if arguments.cut is not None:
        found = join(log, arguments.cut)
        print(f'{arguments.log.name}, second part as a newcomer: {found or "not joined"}')
        return
    mapped = run(log, calibrated=arguments.calibrated)
    total = sum(mapped.seconds.values())
    parts = ', '.join(f'{name} {value:.2f}' for name, value in mapped.seconds.items())
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(
        f'{arguments.log.name}: {len(log.scans)} scans, {mapped.refused} refused, '
        f'{mapped.closures} closures ({mapped.retracted} retracted), {total:.2f} s of CPU '
        f'({parts}), longest step {1e3 * mapped.longest:.0f} ms, peak {peak:.0f} MB'
    )
    rows = [
        ('odometry', log.odometry),
        ('front end', mapped.front_end),
        ('loops closed', mapped.poses),
        ("log's own poses", log.reference),
    ]
    relations = None if arguments.relations is None else Relations.load(arguments.relations)
    for name, poses in rows:
        if poses is not None:
            print(f'  {name}: {evaluation(log, poses, relations, arguments.offset)}')
    if arguments.map is not None:
        draw_map(log, mapped.poses, arguments.map)


if __name__ == '__main__':
    main()
