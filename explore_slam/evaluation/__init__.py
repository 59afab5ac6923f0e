"""Metrics of trajectories and runs, run folders and their reports, the experiments."""

from explore_slam.evaluation.run_data import Panel, RunData, RunRecorder, Series, VehicleRun
from explore_slam.evaluation.run_folder import RunFolder
from explore_slam.evaluation.trajectory import (
    ErrorStatistics,
    Trajectory,
    load_tum,
    save_tum,
    trajectory_metrics,
)

__all__ = [
    'ErrorStatistics',
    'Panel',
    'RunData',
    'RunFolder',
    'RunRecorder',
    'Series',
    'Trajectory',
    'VehicleRun',
    'load_tum',
    'save_tum',
    'trajectory_metrics',
]
