"""The joint graph of keyframes and landmarks, beside the particles of the filter."""

from explore_slam.slam.graph.config import GraphConfig
from explore_slam.slam.graph.joint_graph import JointGraph
from explore_slam.slam.graph.problem import Problem
from explore_slam.slam.graph.rows import StoredObservations, fuse_rows
from explore_slam.slam.graph.solver import OptimizeSummary, PoseSamples, Solution

__all__ = [
    'GraphConfig',
    'JointGraph',
    'OptimizeSummary',
    'PoseSamples',
    'Problem',
    'Solution',
    'StoredObservations',
    'fuse_rows',
    'warm_up',
]


def warm_up() -> None:
    """Compile all kernels of the graph (seconds the first time, then read from the cache)."""
    import numpy as np

    noise = 1e-4 * np.eye(3)
    config = GraphConfig(graph_minimum_observations=2, graph_recent_keyframes=2)
    graph = JointGraph(config)
    graph.add_start(0, 0, np.zeros(3))
    for keyframe in range(1, 6):
        graph.add_keyframe(0, keyframe, np.array([0.5, 0.0, 0.1]), noise, noise)
    for keyframe in (4, 5):
        graph.add_observations(keyframe, [0], [[2.0, 0.0, 1.0]], [[1.0, 0.0, 0.0, 1.0, 0.0, 1.0]])
    graph.add_relative_pose(0, 5, np.zeros(3), noise)
    for keyframe in range(6, 20):
        graph.add_keyframe(0, keyframe, np.array([0.5, 0.0, 0.1]), noise, noise)
    graph.optimize()
    problem = graph.snapshot(0)
    graph.solve(problem._replace(start=problem.start + 1e-3))
    draws = graph.draw(2, np.random.default_rng(0))
    graph.relative_covariance(0, [5])
    graph.closure_residuals()
    stored = graph.observations_of([0])
    rows = np.empty((1, 9, 2))
    node = stored.located(draws.keyframes)
    fuse_rows(stored.first, node, stored.z, stored.W, draws.poses, rows, 0, 2)
