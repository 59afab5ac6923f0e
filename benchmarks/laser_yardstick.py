"""Laser front end, loop closing and pose graph on a CARMEN log, evaluated by relations.

python benchmarks/laser_yardstick.py LOG [RELATIONS] [--offset S] [--corrupt SEED] [--map PNG]
                                     [--cut SHARE]

One vehicle without a filter: every scan is a keyframe of the joint graph. RELATIONS (Kümmerle et
al., Autonomous Robots 27, 2009): t1 t2 x y z roll pitch yaw; time of a relation = log time +
offset. --corrupt makes the odometry worse: a scale of turning and of driving, and noise.
--cut: the scans after a share of the log are those of a second vehicle that starts in the map of
the first without knowing where; when it is joined to it, and how rightly.
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
from explore_slam.geometry import IDENTITY, Array, Pose2, between, compose, moved_enough
from explore_slam.registration import (
    RefusedScan,
    ScanMatch,
    ScanMatcher,
    ScanMatchingConfig,
    scan_cloud,
)
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

INTEL_OFFSET = 976052857.337  # s, of data/carmen/intel.relations
NO_RETURN = 79.0  # m
LOOP_TIME = 20.0  # s; relations farther apart in time are loops
SEARCH_EVERY = 3  # anchors of a newcomer
NEAREST_SCAN = 6.0  # s; relations farther from any scan are left out
# Scale errors of the corrupted odometry (deviations): what badly calibrated wheels have.
TURN_SCALE, WAY_SCALE = 0.05, 0.03
TURN_NOISE, WAY_NOISE = 0.1, 0.1  # rad/rad and rad/m (half of it), m/m


@dataclass(frozen=True)
class Log:
    """Scans with odometry poses (N, 3), reference poses (N, 3) or None, and all odometry."""

    scans: list[LaserScan]
    odometry: Array
    reference: Array | None
    odometry_times: Array
    odometry_poses: Array

    @property
    def times(self) -> Array:
        """Times (N,) s of the scans."""
        return np.array([scan.stamp for scan in self.scans])


def read_log(path: Path) -> Log:
    """Read a CARMEN log: FLASER with corrected poses, or ROBOTLASER1 with raw odometry."""
    scans: list[LaserScan] = []
    poses: list[Pose2] = []
    reference: list[list[float]] = []
    stream: list[tuple[float, Pose2]] = []
    raw, last = IDENTITY, None
    restarts = False
    for line in path.read_text(errors='replace').splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == 'ODOM':
            told = Pose2.from_array([float(word) for word in words[1:4]])
            if last is not None and not restarts:
                raw = raw.compose(last.between(told))
            last, restarts = told, False
            stream.append((float(words[-1]), raw))
        elif words[0] == 'FLASER':
            count = int(words[1])
            step = math.pi / (180 if count in (180, 181) else 360)
            ranges = np.array(words[2 : 2 + count], np.float32)
            at = [float(word) for word in words[2 + count : 5 + count]]
            scans.append(_scan(float(words[-1]), -math.pi / 2, step, ranges))
            poses.append(raw)
            reference.append(at)
            last, restarts = Pose2.from_array(at), True
        elif words[0] == 'ROBOTLASER1':
            count = int(words[8])
            ranges = np.array(words[9 : 9 + count], np.float32)
            scans.append(_scan(float(words[-1]), float(words[2]), float(words[4]), ranges))
            poses.append(Pose2.from_array([float(word) for word in words[-11:-8]]))
            stream.append((scans[-1].stamp, poses[-1]))
    odometry_poses = np.array([pose for _, pose in stream])
    times = np.array([stamp for stamp, _ in stream])
    known = np.array(reference) if reference else None
    return Log(scans, np.array(poses), known, times, odometry_poses)


def _scan(stamp: float, start: float, step: float, ranges: Array) -> LaserScan:
    ranges[ranges >= NO_RETURN] = np.inf
    return LaserScan(max(stamp, 0.0), start, step, ranges, 0.0, NO_RETURN)


def corrupted(log: Log, seed: int) -> Log:
    """Return the log with scale errors and noise on the increments of its odometry."""
    random = np.random.default_rng(seed)
    turn_scale = 1.0 + TURN_SCALE * random.normal()
    way_scale = 1.0 + WAY_SCALE * random.normal()
    poses = [log.odometry[0]]
    for u in between(log.odometry[:-1], log.odometry[1:]):
        way, turn = math.hypot(u[0], u[1]), abs(u[2])
        noise = random.normal(size=3)
        worse = np.array(
            [
                u[0] * way_scale + WAY_NOISE * way * noise[0],
                u[1] * way_scale + 0.5 * WAY_NOISE * way * noise[1],
                u[2] * turn_scale + (TURN_NOISE * turn + 0.5 * TURN_NOISE * way) * noise[2],
            ]
        )
        poses.append(compose(poses[-1], worse))
    # the evaluation interpolates between scans with the odometry as it was recorded
    return replace(log, odometry=np.array(poses))


def odometry_covariance(increment: Pose2) -> Array:
    """Return a generous covariance (3, 3), in the frame where the increment begins."""
    way, turn = math.hypot(increment.x, increment.y), abs(increment.theta)
    deviations = [0.1 * way + 0.02, 0.05 * way + 0.02, 0.15 * turn + 0.05 * way + 0.01]
    return np.diag(deviations) ** 2


def turned(covariance: Array, angle: float) -> Array:
    """Return a covariance (3, 3) in axes from which its own are turned by an angle (rad)."""
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    result: Array = turn @ covariance @ turn.T
    return result


@dataclass
class Mapped:
    """Poses (N, 3) of the front end and of the graph, and what they cost (s of CPU)."""

    front_end: Array
    poses: Array
    closures: int
    taken_back: int
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
    front, refused, made, way, longest = [IDENTITY], 0, 0, 0.0, 0.0
    last_anchor: Pose2 | None = None
    pose = IDENTITY
    for k, scan in enumerate(log.scans):
        begun = time.process_time()
        increment = IDENTITY
        if k:
            increment = Pose2.from_array(between(log.odometry[k - 1], log.odometry[k]))
        Q = odometry_covariance(increment)
        cloud = scan_cloud(scan, IDENTITY, config.matching_range)
        result = matcher.match_cloud(cloud, pose.compose(increment), turned(Q, -increment.theta))
        moved = pose.between(result.pose)
        pose = result.pose
        matched = time.process_time()
        seconds['front end'] += matched - begun
        if k == 0:
            graph.add_start(0, 0, np.zeros(3))
        elif isinstance(result, ScanMatch):
            drift = turned(result.drift, moved.theta)
            graph.add_keyframe(0, k, np.asarray(moved), drift, result.white)
        else:
            refused += isinstance(result, RefusedScan)
            graph.add_keyframe(0, k, np.asarray(moved), Q)
        if k:
            front.append(pose)
            way += math.hypot(moved.x, moved.y)
        new = []
        if (k == 0 or isinstance(result, ScanMatch)) and (
            last_anchor is None or moved_enough(last_anchor.between(pose), 0.2, 0.2)
        ):
            last_anchor = pose
            search.add_anchor(k, 0, cloud, way, scan.stamp)
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

    They are believed at first and robust afterwards: from a start that is far off, the robust
    kernel would take new closures for outliers, however many of them agree.
    """

    def add(*, robust: bool) -> list[int]:
        return [
            graph.add_relative_pose(
                c.keyframe_a, c.keyframe_b, np.asarray(c.pose), c.information, robust=robust
            )
            for c in closures
        ]

    believed = add(robust=False)
    graph.optimize()
    for factor in believed:
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
    """When a newcomer was joined to the map (m of its way), and its error there (m, rad)."""

    way: float
    distance: float
    turn: float
    searches: int
    seconds: float
    longest_slice: float


def join(log: Log, share: float) -> Joined | None:
    """Map the log up to a share, then let the rest find its place in that map.

    The error is that of the joined frame against the log's own poses, at the newest scan.
    """
    cut = int(share * len(log.scans))
    first = run(replace(log, scans=log.scans[:cut], odometry=log.odometry[:cut]))
    second = run(replace(log, scans=log.scans[cut:], odometry=log.odometry[cut:]))
    poses = np.concatenate([first.poses, second.poses])
    anchors, way, last = Anchors(), 0.0, None
    search, searches, seconds, longest = GlobalSearch(ClosureConfig(), anchors), 0, 0.0, 0.0
    for k, scan in enumerate(log.scans):
        if k == cut:
            way, last = 0.0, None
        pose = Pose2.from_array(poses[k])
        moved = IDENTITY if last is None else last.between(pose)
        if last is not None and not moved_enough(moved, 0.2, 0.2):
            continue
        way, last = way + math.hypot(moved.x, moved.y), pose
        anchors.add(Anchor(k, int(k >= cut), way, scan.stamp, scan_cloud(scan, farthest=40.0)))
        if k < cut or anchors.number_added(1) % SEARCH_EVERY:
            continue
        searches += 1
        begun = time.process_time()
        for closures in search.search(k, poses, [0]):
            done = time.process_time()
            longest, seconds, begun = max(longest, done - begun), seconds + done - begun, done
            if not closures:
                continue
            told = np.asarray(join_transform(closures, poses).compose(pose))
            off = np.full(3, np.nan)
            if log.reference is not None:
                at = closures[-1].keyframe_a
                true = between(log.reference[at], log.reference[k])
                off = between(true, between(poses[at], told))
            distance = math.hypot(off[0], off[1])
            return Joined(way, distance, abs(float(off[2])), searches, seconds, longest)
    return None


def pose_at(log: Log, poses: Array, at: float) -> tuple[Array, float]:
    """Return the pose (3,) at a time, and the time (s) to the nearest scan.

    The scans before and after are moved by the odometry between and blended by time.
    """
    order = np.argsort(log.times, kind='stable')
    times = log.times[order]
    after = min(max(int(np.searchsorted(times, at)), 1), len(times) - 1)
    before = after - 1
    ordered = np.argsort(log.odometry_times, kind='stable')
    stream, heading = log.odometry_poses[ordered], None
    heading = np.unwrap(stream[:, 2])

    def odometry(moment: float) -> Array:
        columns = (stream[:, 0], stream[:, 1], heading)
        return np.array([np.interp(moment, log.odometry_times[ordered], c) for c in columns])

    told = odometry(at)
    one = compose(poses[order[before]], between(odometry(times[before]), told))
    other = compose(poses[order[after]], between(odometry(times[after]), told))
    share = min(max((at - times[before]) / max(times[after] - times[before], 1e-9), 0.0), 1.0)
    off = between(one, other)
    return compose(one, share * off), min(abs(at - times[before]), abs(at - times[after]))


def relation_errors(log: Log, poses: Array, relations: Array, offset: float) -> str:
    """Return a line with the errors of all relations, and of those near and far in time."""
    errors, turns, spans = [], [], []
    for row in relations:
        a, gap_a = pose_at(log, poses, row[0] - offset)
        b, gap_b = pose_at(log, poses, row[1] - offset)
        if max(gap_a, gap_b) < NEAREST_SCAN:
            off = between(row[[2, 3, 7]], between(a, b))
            errors.append(math.hypot(off[0], off[1]))
            turns.append(abs(math.degrees(off[2])))
            spans.append(abs(row[1] - row[0]))
    e, turn, loops = np.array(errors), np.array(turns), np.array(spans) > LOOP_TIME
    return (
        f'all {e.mean():.4f} ± {e.std():.4f} m, {turn.mean():.2f}°; '
        f'near {e[~loops].mean():.4f} m; loops {e[loops].mean():.4f} m'
    )


def reference_rms(poses: Array, reference: Array) -> tuple[float, float]:
    """Return root mean square and largest distance (m) to a reference after alignment."""
    a, b = poses[:, :2] - poses[:, :2].mean(0), reference[:, :2] - reference[:, :2].mean(0)
    U, _, V = np.linalg.svd(b.T @ a)
    R = U @ np.diag([1.0, np.linalg.det(U @ V)]) @ V
    off = np.hypot(*(a @ R.T - b).T)
    return float(np.sqrt((off**2).mean())), float(off.max())


def draw_map(log: Log, poses: Array, path: Path) -> None:
    """Write all returns within 20 m and the path as a picture."""
    from matplotlib import pyplot as plt

    points = np.concatenate(
        [
            scan_cloud(scan, farthest=20.0).moved(Pose2.from_array(pose)).points
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
    parser.add_argument('--offset', type=float, default=INTEL_OFFSET)
    parser.add_argument('--corrupt', type=int, metavar='SEED')
    parser.add_argument('--calibrated', action='store_true', help='windows by the graph')
    parser.add_argument('--map', type=Path)
    parser.add_argument('--cut', type=float, metavar='SHARE')
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
        f'{mapped.closures} closures ({mapped.taken_back} taken back), {total:.2f} s of CPU '
        f'({parts}), longest step {1e3 * mapped.longest:.0f} ms, peak {peak:.0f} MB'
    )
    rows = [
        ('odometry', log.odometry),
        ('front end', mapped.front_end),
        ('loops closed', mapped.poses),
        ("log's own poses", log.reference),
    ]
    relations = None if arguments.relations is None else np.loadtxt(arguments.relations)
    for name, poses in rows:
        if poses is None:
            continue
        line = (
            '' if relations is None else relation_errors(log, poses, relations, arguments.offset)
        )
        if log.reference is not None:
            rms, most = reference_rms(poses, log.reference)
            line += f'; RMS to the log {rms:.3f} m, most {most:.2f} m'
        print(f'  {name}: {line.removeprefix("; ")}')
    if arguments.map is not None:
        draw_map(log, mapped.poses, arguments.map)


if __name__ == '__main__':
    main()
