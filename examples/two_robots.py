"""Two robots drive side by side through a row of landmarks and share one map (FastSlam).

python examples/two_robots.py [--seed N]

Each robot observes the landmarks around it with noise and drives with noisy wheel odometry. The
filter estimates both poses and one landmark map; odometry alone is printed for comparison.
"""

import argparse
import math

import numpy as np

from explore_slam.data import LandmarkObservations
from explore_slam.geometry import Pose2, to_world
from explore_slam.slam import FastSlam, FastSlamConfig

ROOM = np.array([[-5.0, -3.0, 0.2], [5.0, 7.0, 2.0]])  # corners of the box of landmarks (m)
STEP = Pose2(0.25, 0.0, math.radians(6.0))  # what each robot drives between two observations
ODOMETRY_SIGMA = np.array([0.01, 0.003, math.radians(2.0)])  # m, m, rad per step
SIGHT = 4.0  # m, in all directions
NOISE = 0.02  # m, standard deviation of each coordinate of an observed landmark


def observe(
    random: np.random.Generator, pose: Pose2, landmarks: np.ndarray, descriptors: np.ndarray
) -> LandmarkObservations:
    """Return the landmarks in sight from a true pose, in the frame of the vehicle."""
    local = to_world(pose.inverse(), landmarks)
    seen = np.hypot(local[:, 0], local[:, 1]) < SIGHT
    count = int(seen.sum())
    return LandmarkObservations(
        stamp=0.0,
        positions=local[seen] + NOISE * random.normal(size=(count, 3)),
        covariances=np.tile(NOISE**2 * np.eye(3), (count, 1, 1)),
        descriptors=descriptors[seen],
    )


def main() -> None:
    """Drive, estimate, print the errors."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seed', type=int, default=0)
    random = np.random.default_rng(parser.parse_args().seed)

    landmarks = random.uniform(*ROOM, size=(60, 3))
    descriptors = random.normal(size=(60, 128)).astype(np.float32)
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)

    truth = {'robot1': Pose2(0.0, 0.0, 0.0), 'robot2': Pose2(0.0, -1.0, 0.0)}
    odometry = dict(truth)
    slam = FastSlam(truth, FastSlamConfig(particles=300), seed=7)
    for _ in range(60):
        for robot, previous in list(truth.items()):
            truth[robot] = pose = previous.compose(STEP)
            measured = Pose2(*(np.array(STEP) + ODOMETRY_SIGMA * random.normal(size=3)).tolist())
            odometry[robot] = odometry[robot].compose(measured)
            slam.predict(robot, measured, np.diag(ODOMETRY_SIGMA**2))
            slam.update(robot, observe(random, pose, landmarks, descriptors))

    for robot, true_pose in truth.items():
        pose, covariance = slam.estimate(robot)
        print(
            f'{robot}: estimated at ({pose.x:.2f}, {pose.y:.2f}), '
            f'error {math.dist(pose[:2], true_pose[:2]):.3f} m '
            f'(odometry alone {math.dist(odometry[robot][:2], true_pose[:2]):.3f} m), '
            f'standard deviation {math.sqrt(covariance[0, 0] + covariance[1, 1]):.3f} m'
        )
    print(f'{len(slam.landmarks().means)} landmarks in the common map')


if __name__ == '__main__':
    main()
