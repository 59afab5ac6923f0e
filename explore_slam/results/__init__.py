"""Results of runs: metrics, run folder, report, figures."""

from explore_slam.results.run_data import Panel, RunData, RunRecorder, Series, VehicleRun
from explore_slam.results.run_folder import RunFolder
from explore_slam.results.trajectory import (
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
