"""No input that is accepted brings a NaN into the filter, and what is legitimate is accepted."""

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
DESCRIPTORS = np.random.default_rng(0).standard_normal((300, 128)).astype(np.float32)
DESCRIPTORS /= np.linalg.norm(DESCRIPTORS, axis=1, keepdims=True)


def covariance(random, size, *, singular=False):
    """Return a covariance with deviations of 1 µm to 30 m, the largest 1000 times the least."""
    A = np.linalg.qr(random.standard_normal((size, size)))[0]
    deviations = 10.0 ** (random.uniform(-3, 1.5) - random.uniform(0, 3, size))
    if singular:
        deviations[0] = 0.0
    matrix = (A * deviations**2) @ A.T
    return 0.5 * (matrix + matrix.T)


def act(slam, random, stamp):
    """Do something legitimate; returns whether it was an update."""
    name = NAMES[random.integers(0, 2)]
    other = NAMES[1 - NAMES.index(name)]
    kind = random.integers(0, 6)
    if kind <= 1:
        step = Pose2(*(random.standard_normal(3) * 10.0 ** random.uniform(-4, 1.5)))
        given = None if random.random() < 0.3 else covariance(random, 3, singular=stamp % 5 == 0)
        slam.predict(name, step, given)
    elif kind == 2:
        slam.update_inter_robot(
            name,
            [InterRobotObservation(stamp, other, random.normal(0, 5, 2), covariance(random, 2))],
        )
    elif kind == 3 and random.random() < 0.3:
        slam.set_pose(name, Pose2(*random.normal(0, 3, 3)), covariance(random, 3))
    else:
        count = int(random.choice([1, 11, 40, 300]))
        which = random.permutation(300)[:count]
        slam.update(
            name,
            LandmarkObservations(
                stamp,
                random.normal(0, 4, (count, 3)),
                np.array([covariance(random, 3) for _ in range(count)]),
                DESCRIPTORS[which],
            ),
        )
        slam.add_keyframe(name, stamp)


def check_finite(slam):
    for name, value in slam.state_dict().items():
        if value.dtype == np.float64 and name != 'stamps':
            assert np.isfinite(value).all(), name
    landmarks = slam.landmarks()
    assert np.isfinite(landmarks.means).all()
    assert np.isfinite(landmarks.covariances).all()
    for name in NAMES:
        pose, spread = slam.estimate(name)
        assert pose.is_finite()
        assert np.isfinite(spread).all()
    assert np.isfinite(slam.best_path()).all()


@pytest.mark.parametrize('engine', ['fastslam2', 'paper'])
@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 10**6))
def test_legitimate_input_is_accepted_and_leaves_no_nan(engine, seed):
    values = {'particles': 20, 'engine': engine, 'maximum_descriptor_distance': 0.0}
    config = with_values(FastSlamConfig(), values)
    slam = FastSlam(dict.fromkeys(NAMES, Pose2(0.0, 0.0, 0.0)), config, seed)
    random = np.random.default_rng(seed)
    for name in NAMES:
        slam.predict(name, Pose2(0.0, 0.0, 0.0), np.zeros((3, 3)))
    for step in range(20):
        act(slam, random, float(step))
    check_finite(slam)


def observed(z, deviation, stamp):
    count = len(z)
    covariances = np.tile(deviation**2 * np.eye(3), (count, 1, 1))
    return LandmarkObservations(stamp, z, covariances, DESCRIPTORS[:count])


@pytest.mark.parametrize('count', [11, 32, 40, 300])
@pytest.mark.parametrize('first', [1e-3, 0.3, 30.0])
@pytest.mark.parametrize('second', [1e-6, 3e-3, 30.0])
def test_landmarks_seen_again_far_more_or_less_exactly_are_updated(count, first, second):
    """|S|/|2R| of one landmark is (first / second)⁶ / 8, to the power of their number."""
    config = with_values(FastSlamConfig(), {'particles': 20, 'maximum_descriptor_distance': 0.0})
    slam = FastSlam({'a': Pose2(0.0, 0.0, 0.0)}, config, 0)
    random = np.random.default_rng(count)
    z = random.uniform([1, -3, 0], [4, 3, 2], (count, 3))
    slam.predict('a', Pose2(0.0, 0.0, 0.0), 1e-6 * np.eye(3))
    assert slam.update('a', observed(z, first, 0.0)).inserted == count
    summary = slam.update('a', observed(z, second, 1.0))
    assert summary.with_candidates == count
    assert summary.associated == count
    landmarks = slam.landmarks()
    assert len(landmarks) == count
    assert np.linalg.norm(landmarks.means - z, axis=1).max() < 0.1
    # seen 1 s later from the same place: the second time counts (1 + ρ)/(1 − ρ) times less
    rho = np.exp(-0.1)
    variance = 1.0 / (first**-2 + second**-2 * (1.0 - rho) / (1.0 + rho))
    np.testing.assert_allclose(landmarks.covariances[:, 2, 2], variance, rtol=1e-3)
    assert np.isfinite(slam.weights('a')).all()


def test_overflow_is_refused_and_leaves_everything():
    """What no filter can represent is named, and changes neither state nor random stream."""
    config = with_values(FastSlamConfig(), {'particles': 20, 'maximum_descriptor_distance': 0.0})
    slam = FastSlam({'a': Pose2(0.0, 0.0, 0.0)}, config, 0)
    slam.predict('a', Pose2(0.1, 0.0, 0.0), 1e-4 * np.eye(3))
    z = np.random.default_rng(0).uniform([1, -3, 0], [4, 3, 2], (40, 3))
    slam.update('a', observed(z, 0.1, 0.0))
    slam.redraw([0])
    slam.predict('a', Pose2(0.1, 0.0, 0.0), 1e150 * np.eye(3))
    before, landmarks = slam.state_dict(), slam.landmarks()
    for deviation in (0.1, 1e-120):
        with pytest.raises(SlamError, match=r"update\('a'\) at stamp 1.0: numbers overflow"):
            slam.update('a', observed(z, deviation, 1.0))
    after = slam.state_dict()
    changed = [name for name in before if not np.array_equal(before[name], after[name])]
    assert [name for name in changed if not name.startswith('map/rows/')] == []  # free memory
    for name, value in vars(slam.landmarks()).items():
        np.testing.assert_array_equal(value, getattr(landmarks, name))
