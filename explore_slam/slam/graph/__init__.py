"""The joint graph of keyframes and landmarks, beside the particles of the filter."""

from explore_slam.slam.graph.config import GraphConfig
from explore_slam.slam.graph.joint_graph import JointGraph
from explore_slam.slam.graph.problem import Problem
from explore_slam.slam.graph.rows import StoredObservations, fuse_rows
from explore_slam.slam.graph.solver import Draws, OptimizeSummary, Solution

__all__ = [
    'Draws',
    'GraphConfig',
    'JointGraph',
    'OptimizeSummary',
    'Problem',
    'Solution',
    'StoredObservations',
    'fuse_rows',
]
