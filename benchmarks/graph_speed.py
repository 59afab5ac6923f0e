"""The joint graph alone: how long it takes, and how accurate and consistent it is online.

python benchmarks/graph_speed.py speed             times of one redraw at several sizes
python benchmarks/graph_speed.py study [--laps 4] [--seeds 5] [--isam2]
    two vehicles on crossing loops with the noise of table I: the graph as configured, without
    bound, with heights, with --isam2 GTSAM's iSAM2 (minutes at 20 laps): error and NEES of each
    pose as estimated online. The errors of one run are correlated (what the first lap got wrong
    stays), so that ANEES needs many seeds.
Times are medians in milliseconds of processor time, on one thread.
"""

import argparse
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import LandmarkObservations
from explore_slam.geometry import Array, Pose2, between, wrap_angle
from explore_slam.slam.graph import GraphConfig, JointGraph, fuse_rows, warm_up
from explore_slam.studies.experiments.scenarios import (
    HEIGHT,
    PATHS,
    WIDTH,
    Noise,
    from_polar,
    observe,
    path_poses,
    unique_descriptors,
)
from explore_slam.studies.isam2 import Isam2

LANDMARKS, RANGE = 60, 3.5  # of experiment 1
PARTICLES = 300
REPETITIONS = 15
PACKED = ([0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2])


class Step(NamedTuple):
    """One keyframe of one vehicle."""

    vehicle: int
    true_pose: Pose2
    increment: Pose2
    covariance: Array
    observations: LandmarkObservations
    identities: NDArray[np.int64]


def crossing_loops(laps: int, seed: int) -> tuple[list[Pose2], list[Step]]:
    """Drive both loops for some laps; the vehicles steer by truth, so that they stay on them."""
    noise, random = Noise(), np.random.default_rng([seed, laps])
    low, high = [0.0, 0.0, 0.2], [WIDTH, HEIGHT, 1.8]
    places = random.uniform(low, high, (LANDMARKS, 3))
    descriptors = unique_descriptors(LANDMARKS, random)
    planned = [path_poses(corners) for corners in PATHS['crossing'].values()]
    starts = [poses[0] for poses in planned]
    true, steps = list(starts), []
    for number in range(laps * (len(planned[0]) - 1)):
        for vehicle, poses in enumerate(planned):
            increment = true[vehicle].between(poses[number % (len(poses) - 1) + 1])
            covariance = noise.motion_covariance(increment)
            wander = random.multivariate_normal(np.zeros(3), covariance, method='cholesky')
            true[vehicle] = true[vehicle].compose(Pose2.from_array(np.add(increment, wander)))
            pose = true[vehicle]
            seen, rows = observe(pose, places, descriptors, float(number), RANGE, noise, random)
            seen = with_true_covariances(seen, pose, places[rows], noise)
            steps.append(Step(vehicle, pose, increment, covariance, seen, rows))
    return starts, steps


def with_true_covariances(
    seen: LandmarkObservations, pose: Pose2, places: Array, noise: Noise
) -> LandmarkObservations:
    """Return observations with the covariances of the ranges that they truly have.

    The deviation is a share of the range. Taken from the measured range, too short measurements
    weigh more than too long ones; that bias of 0.5 % shows in the exact estimator, too.
    """
    c, s = np.cos(pose.theta), np.sin(pose.theta)
    dx, dy = (places[:, :2] - [pose.x, pose.y]).T
    forward, left = c * dx + s * dy, c * dy - s * dx
    tau = np.sqrt(dx**2 + dy**2 + places[:, 2] ** 2)
    angles = np.arctan2(left, forward), np.arcsin(places[:, 2] / tau)
    _, covariances = from_polar(tau, *angles, noise)
    return LandmarkObservations(seen.stamp, seen.positions, covariances, seen.descriptors)


def record(graph: JointGraph, step: Step, keyframe: int) -> None:
    """Add a step to a graph."""
    graph.add_keyframe(step.vehicle, keyframe, step.increment, step.covariance)
    R = step.observations.covariances[:, PACKED[0], PACKED[1]]
    graph.add_observations(keyframe, step.identities, step.observations.positions, R)


class Errors:
    """Errors and NEES of the poses as they were estimated online."""

    def __init__(self) -> None:
        self.squared: list[float] = []
        self.nees: list[float] = []

    def add(self, true: Pose2, estimate: Array, covariance: Array) -> None:
        """Add an estimate (3,) with its covariance (3, 3) in the axes of the map."""
        e = np.subtract(estimate, true)
        e[2] = wrap_angle(e[2])
        self.squared.append(float(e[0] ** 2 + e[1] ** 2))
        self.nees.append(float(e @ np.linalg.solve(covariance, e)))

    def __str__(self) -> str:
        inside = np.mean(np.array(self.nees) < 7.815)  # 95 % of χ² with three degrees of freedom
        rms = 1e3 * np.sqrt(np.mean(self.squared))
        return f'RMS {rms:5.1f} mm, ANEES {np.mean(self.nees):5.2f}, in 95 % {inside:.3f}'


def run_graph(starts: list[Pose2], steps: list[Step], config: GraphConfig) -> tuple[Errors, str]:
    """Drive a graph through a run; returns its errors and what it had become lap by lap."""
    graph, errors, sizes = JointGraph(config), Errors(), []
    for vehicle, pose in enumerate(starts):
        graph.add_start(vehicle, vehicle, pose)
    lap = len(steps) // max(1, round(len(steps) / 56))
    for keyframe, step in enumerate(steps, start=len(starts)):
        record(graph, step, keyframe)
        summary = graph.optimize(step.vehicle)
        errors.add(step.true_pose, graph.estimate(keyframe), graph.covariance(keyframe))
        if (keyframe - len(starts) + 1) % lap == 0:
            sizes.append(f'{summary.keyframes}/{summary.factors}')
    return errors, ' '.join(sizes)


def run_isam2(starts: list[Pose2], steps: list[Step]) -> Errors:
    """Drive iSAM2 through a run."""
    smoother = Isam2({str(vehicle): pose for vehicle, pose in enumerate(starts)})
    errors = Errors()
    for step in steps:
        smoother.predict(str(step.vehicle), step.increment, step.covariance)
        smoother.update(str(step.vehicle), step.observations, step.identities.tolist())
        pose, covariance = smoother.estimate(str(step.vehicle))
        errors.add(step.true_pose, np.array(pose), covariance)
    return errors


def study(laps: int, seeds: int, *, isam2: bool) -> None:
    """Compare the graph with the exact answer on the same runs."""
    exact = GraphConfig(
        graph_minimum_observations=2, graph_bounded=False, graph_landmark_heights=True
    )
    configs = {
        'default': GraphConfig(),
        'unbounded': GraphConfig(graph_bounded=False),
        'heights': GraphConfig(graph_landmark_heights=True),
        'exact': exact,
    }
    names = [*configs, *(['iSAM2'] if isam2 else [])]
    totals = {name: Errors() for name in names}
    for seed in range(seeds):
        starts, steps = crossing_loops(laps, seed)
        for name in names:
            if name in configs:
                errors, sizes = run_graph(starts, steps, configs[name])
            else:
                errors, sizes = run_isam2(starts, steps), ''
            print(f'seed {seed} {name:10}', errors, sizes, flush=True)
            totals[name].squared += errors.squared
            totals[name].nees += errors.nees
    for name, errors in totals.items():
        ratio = np.sqrt(np.mean(errors.squared) / np.mean(totals[names[-1]].squared))
        print(f'all    {name:10} {errors}, RMS {ratio:.3f} x {names[-1]}')


def timed(call: Callable[[], object]) -> float:
    """Return the median processor time of a call (ms)."""
    times = []
    for _ in range(REPETITIONS):
        begin = time.process_time()
        call()
        times.append(1e3 * (time.process_time() - begin))
    return float(np.median(times))


def report_times(name: str, graph: JointGraph) -> None:
    """Print what the parts of a redraw take."""
    graph.optimize()
    problem = graph.snapshot(0)
    moved = problem._replace(
        start=problem.start + 1e-3 * np.random.default_rng(0).standard_normal(problem.start.shape)
    )
    solution = graph.solve(moved)
    random = np.random.default_rng(1)
    draws = solution.draw(PARTICLES, random)
    parts = {
        'collect': timed(lambda: graph.snapshot(0)),
        f'optimize ({solution.summary.iterations} iterations)': timed(lambda: graph.solve(moved)),
        f'draw {PARTICLES}': timed(lambda: solution.draw(PARTICLES, random)),
        'covariance of one with all': timed(
            lambda: solution.relative_covariance(int(problem.keyframes[-1]), problem.keyframes)
        ),
    }
    if len(problem.landmarks):
        ids = problem.landmarks[: min(30, len(problem.landmarks))]
        stored = graph.observations_of(ids)
        node = stored.located(draws.keyframes)
        out = np.empty((len(ids), 9, PARTICLES))
        parts[f'fuse {len(ids)} landmarks'] = timed(
            lambda: fuse_rows(
                stored.first, node, stored.z, stored.W, draws.poses, out, 0, PARTICLES
            )
        )
    size = f'{len(problem.keyframes)} poses, {len(problem.factors.kind)} factors'
    print(f'{name} ({size}): ' + ', '.join(f'{n} {ms:.1f} ms' for n, ms in parts.items()))


def laser_chain(keyframes: int, closures: int) -> JointGraph:
    """Return a graph of scan matches round and round a block, closed by laser."""
    random = np.random.default_rng(0)
    walk, white = np.diag([2e-3, 2e-3, 1e-3]) ** 2, np.diag([0.01, 0.01, 0.003]) ** 2
    graph, true = JointGraph(), [Pose2(0.0, 0.0, 0.0)]
    graph.add_start(0, 0, true[0])
    graph.pin(0)
    around = 300  # keyframes of one round
    for keyframe in range(1, keyframes):
        turn = 0.5 * np.pi if keyframe % (around // 4) == 0 else 0.0
        true.append(true[-1].compose(Pose2(0.25, 0.0, turn)))
        drift = random.multivariate_normal(np.zeros(3), walk)
        graph.add_keyframe(0, keyframe, np.add((0.25, 0.0, turn), drift), walk, white)
        graph.pin(keyframe)
    information = np.linalg.inv(np.diag([0.03, 0.03, 0.01]) ** 2)
    for b in np.sort(random.integers(around, keyframes, closures)).tolist():
        a = int(random.integers(0, b // around)) * around + b % around
        z = between(true[a], true[b]) + random.normal(0.0, [0.03, 0.03, 0.01])
        graph.add_relative_pose(a, b, z, information)
    return graph


def speed() -> None:
    """Print the times of a redraw."""
    warm_up()
    for laps in (1, 4, 20):
        graph = JointGraph(GraphConfig(graph_bounded=False))
        starts, steps = crossing_loops(laps, 0)
        for vehicle, pose in enumerate(starts):
            graph.add_start(vehicle, vehicle, pose)
        for keyframe, step in enumerate(steps, start=len(starts)):
            record(graph, step, keyframe)
            if keyframe % 20 == 0:
                graph.optimize()
        report_times(f'{laps} laps', graph)
    report_times('laser chain', laser_chain(1500, 300))


def main() -> None:
    """Run one of the benchmarks."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('what', choices=('speed', 'study'))
    parser.add_argument('--laps', type=int, default=4)
    parser.add_argument('--seeds', type=int, default=5)
    parser.add_argument('--isam2', action='store_true')
    arguments = parser.parse_args()
    if arguments.what == 'speed':
        speed()
    else:
        study(arguments.laps, arguments.seeds, isam2=arguments.isam2)


if __name__ == '__main__':
    main()
