"""The reference method iSAM2 on exact and noisy data."""

import math
import sys

import numpy as np
import pytest

from explore_slam.data import LandmarkObservations
from explore_slam.errors import EvaluationError
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.studies.experiments.scenarios import unique_descriptors
from explore_slam.studies.isam2 import Isam2

START = Pose2(1.0, 2.0, 0.5)


def seen_from(pose, places, stamp):
    c, s = math.cos(pose.theta), math.sin(pose.theta)
    back = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    positions = (places - (pose.x, pose.y, 0.0)) @ back.T
    count = len(places)
    covariances = np.tile(np.diag([1e-3, 2e-4, 3e-4]), (count, 1, 1))
    return LandmarkObservations(
        stamp, positions, covariances, unique_descriptors(count, np.random.default_rng(0))
    )


PLACES = np.array([[3.0, 1.0, 0.5], [2.0, 4.0, 1.0], [4.0, 3.0, 0.2]])


def test_isam2_corrects_odometry_by_landmarks():
    graph = Isam2({'a': START})
    noise = np.diag([0.01, 0.01, 0.01])
    graph.predict('a', IDENTITY, 1e-10 * np.eye(3))
    graph.update('a', seen_from(START, PLACES, 0.0), [5, 6, 7])
    true = START.compose(Pose2(0.5, 0.0, 0.1))
    graph.predict('a', Pose2(0.7, 0.1, 0.2), noise)
    before, _ = graph.estimate('a')
    graph.update('a', seen_from(true, PLACES, 1.0), [5, 6, 7])
    after, covariance = graph.estimate('a')
    assert math.dist(before[:2], true[:2]) > 0.2
    assert math.dist(after[:2], true[:2]) < 0.05
    assert np.linalg.eigvalsh(covariance).min() > 0.0
    identities, positions = graph.landmarks()
    assert identities.tolist() == [5, 6, 7]
    np.testing.assert_allclose(positions, PLACES, atol=0.1)


def test_isam2_exact_data_gives_exact_poses():
    graph = Isam2({'a': START, 'b': Pose2(5.0, 5.0, -2.0)})
    pose = dict(zip('ab', (START, Pose2(5.0, 5.0, -2.0)), strict=True))
    for number in range(1, 6):
        for name, increment in (('a', Pose2(0.4, 0.0, 0.3)), ('b', Pose2(0.3, 0.0, -0.4))):
            pose[name] = pose[name].compose(increment)
            graph.predict(name, increment, 0.01 * np.eye(3))
            graph.update(name, seen_from(pose[name], PLACES, float(number)), [0, 1, 2])
    for name in 'ab':
        np.testing.assert_allclose(graph.estimate(name)[0], pose[name], atol=1e-6)
        stamps, poses = graph.trajectory(name)
        assert stamps.tolist() == [0, 1, 2, 3, 4, 5]
        np.testing.assert_allclose(poses[-1], pose[name], atol=1e-6)


def test_isam2_jacobians_are_right_for_turned_vehicles():
    """A wrong derivative would keep the smoother from the minimum that exact data have."""
    rng = np.random.default_rng(1)
    graph = Isam2({'a': Pose2(0.0, 0.0, 2.5)})
    pose = Pose2(0.0, 0.0, 2.5)
    for number in range(8):
        increment = Pose2(0.3, 0.1, 0.7)
        pose = pose.compose(increment)
        wrong = Pose2(*(np.array(increment) + rng.normal(0.0, 0.1, 3)))
        graph.predict('a', wrong, 0.01 * np.eye(3))
        graph.update('a', seen_from(pose, PLACES, float(number)), [0, 1, 2])
    stamps, poses = graph.trajectory('a')
    assert len(stamps) == 9
    # landmarks were seen from an uncertain first pose: what is exact is how they lie to the pose
    _, positions = graph.landmarks()
    last = Pose2(*poses[-1])
    seen = seen_from(last, positions, 0.0).positions
    np.testing.assert_allclose(seen, seen_from(pose, PLACES, 0.0).positions, atol=0.03)


def test_isam2_refuses_what_it_does_not_know():
    graph = Isam2({'a': START})
    with pytest.raises(EvaluationError, match="'z'"):
        graph.update('z', seen_from(START, PLACES, 0.0), [0, 1, 2])
    with pytest.raises(EvaluationError, match='2 identities for 3'):
        graph.update('a', seen_from(START, PLACES, 0.0), [0, 1])


def test_without_gtsam_the_error_says_what_to_do(monkeypatch):
    monkeypatch.setitem(sys.modules, 'gtsam', None)
    with pytest.raises(EvaluationError, match='gtsam'):
        Isam2({'a': START})
