"""The belief: FastSLAM over several vehicles and one landmark map."""

from explore_slam.slam.config import FastSlamConfig
from explore_slam.slam.fast_slam import FastSlam, UpdateSummary
from explore_slam.slam.landmark_map import Landmarks
from explore_slam.slam.motion import OdometryNoise, compound
from explore_slam.slam.team_belief import TeamBelief

__all__ = [
    'FastSlam',
    'FastSlamConfig',
    'Landmarks',
    'OdometryNoise',
    'TeamBelief',
    'UpdateSummary',
    'compound',
    'warm_up',
]


def warm_up() -> None:
    """Compile all kernels of the room (seconds the first time, then read from the cache)."""
    import numpy as np

    from explore_slam.data import LandmarkObservations
    from explore_slam.geometry import Pose2

    descriptors = np.eye(4, 128, dtype=np.float32)
    positions = np.array([[2.0, 0.5, 0.1], [2.0, -0.5, 0.2], [3.0, 0.0, 0.3], [1.0, 0.0, 0.0]])
    seen = LandmarkObservations(0.0, positions, np.tile(0.01 * np.eye(3), (4, 1, 1)), descriptors)
    for engine in ('fastslam2', 'paper'):
        slam = FastSlam({'a': Pose2(0.0, 0.0, 0.0)}, FastSlamConfig(particles=8, engine=engine))
        for _ in range(3):
            slam.predict('a', Pose2(0.01, 0.0, 0.0), 0.01 * np.eye(3))
            slam.update('a', seen)
            slam.add_keyframe('a', 0.0)
        slam.best_path()
        slam.landmarks()
