"""SLAM: FastSLAM over several vehicles and one landmark map."""

from explore_slam.slam.config import FastSlamConfig
from explore_slam.slam.fast_slam import FastSlam
from explore_slam.slam.landmarks.landmark_map import Landmarks
from explore_slam.slam.particles.motion import (
    OdometryCalibration,
    OdometryNoise,
    calibrated,
    compound,
)
from explore_slam.slam.posterior.joint_posterior import RelativePose
from explore_slam.slam.summary import UpdateSummary
from explore_slam.slam.team_belief import TeamBelief

__all__ = [
    'FastSlam',
    'FastSlamConfig',
    'Landmarks',
    'OdometryCalibration',
    'OdometryNoise',
    'RelativePose',
    'TeamBelief',
    'UpdateSummary',
    'calibrated',
    'compound',
    'warm_up',
]


def warm_up() -> None:
    """Compile all kernels of the package, or load them from the cache on disk."""
    import numpy as np

    from explore_slam.data import InterRobotObservation, LandmarkObservations
    from explore_slam.geometry import Pose2
    from explore_slam.slam import graph
    from explore_slam.slam.relocalization import relocalizer

    graph.warm_up()
    relocalizer.warm_up()
    random = np.random.default_rng(0)
    count = 10
    positions = random.uniform(1.0, 3.0, (count, 3))
    covariances = np.tile(0.01 * np.eye(3), (count, 1, 1))
    descriptors = np.eye(count, 128, dtype=np.float32)
    observations = LandmarkObservations(0.0, positions, covariances, descriptors)
    still, noise = Pose2(0.0, 0.0, 0.0), 1e-4 * np.eye(3)
    starts = {'a': still, 'b': Pose2(1.0, 0.0, 0.0)}
    measured = InterRobotObservation(0.0, 'b', np.array([1.0, 0.0]), 0.01 * np.eye(2))
    for engine in ('fastslam2', 'paper'):
        slam = FastSlam(starts, FastSlamConfig(particles=16, engine=engine))
        for _ in range(3):
            slam.predict('a', still, noise)
            slam.update('a', observations)
            slam.add_keyframe('a', 0.0)
            slam.update_inter_robot('a', [measured])
            for _ in range(8):
                weights = random.exponential(size=16) ** 3
                slam.resample_now(weights / weights.sum())
        if slam.joint is not None:
            slam.redraw([0])
            slam.update('a', observations)
        slam.best_path()
        slam.landmarks()
        slam.map.index.query(descriptors, 1.0, 8)
        slam.map.remove(slam.map.entries()[:1])
