"""No input that is accepted brings a NaN into the filter."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from explore_slam.data import InterRobotObservation, LandmarkObservations
from explore_slam.errors import SlamError
from explore_slam.geometry import Pose2
from explore_slam.settings import with_values
from explore_slam.slam import FastSlam, FastSlamConfig

NAMES = ('a', 'b')
DESCRIPTORS = np.eye(20, 128, dtype=np.float32)


def matrix(random, size):
    scale = 10.0 ** random.uniform(-6, 1.5)
    A = random.standard_normal((size, size)) * scale
    if random.random() < 0.2:
        A[:, 0] = 0.0
    return A @ A.T


def act(slam, random, stamp):
    name = NAMES[random.integers(0, 2)]
    kind = random.integers(0, 6)
    if kind <= 1:
        step = random.standard_normal(3) * 10.0 ** random.uniform(-4, 1.5)
        slam.predict(name, Pose2(*step), matrix(random, 3))
    elif kind == 2:
        observation = InterRobotObservation(
            stamp, NAMES[random.integers(0, 2)], random.normal(0, 5, 2), matrix(random, 2)
        )
        slam.update_inter_robot(name, [observation])
    elif kind == 3 and random.random() < 0.3:
        slam.set_pose(name, Pose2(*random.normal(0, 3, 3)), matrix(random, 3))
    else:
        count = int(random.integers(0, 12))
        which = random.integers(0, 20, count)
        slam.update(
            name,
            LandmarkObservations(
                stamp,
                random.normal(0, 4, (count, 3)),
                np.array([matrix(random, 3) for _ in range(count)]).reshape(-1, 3, 3),
                DESCRIPTORS[which],
            ),
        )
        slam.add_keyframe(name, stamp)


@pytest.mark.parametrize('engine', ['fastslam2', 'paper'])
@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 10**6))
def test_the_filter_never_holds_a_nan(engine, seed):
    values = {'particles': 20, 'engine': engine, 'maximum_descriptor_distance': 0.0}
    config = with_values(FastSlamConfig(), values)
    slam = FastSlam(dict.fromkeys(NAMES, Pose2(0.0, 0.0, 0.0)), config, seed)
    random = np.random.default_rng(seed)
    for step in range(25):
        try:
            act(slam, random, float(step))
        except SlamError:
            continue
    for name, value in slam.state_dict().items():
        if value.dtype == np.float64 and name != 'stamps':
            assert np.isfinite(value).all(), name
    landmarks = slam.landmarks()
    assert np.isfinite(landmarks.means).all()
    assert np.isfinite(landmarks.covariances).all()
    for name in NAMES:
        pose, covariance = slam.estimate(name)
        assert pose.is_finite()
        assert np.isfinite(covariance).all()
