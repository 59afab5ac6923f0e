"""Errors that all observations of one frame share."""

import numpy as np
import pytest

from explore_slam.errors import ConfigError
from explore_slam.geometry import Pose2, compose
from explore_slam.slam.config import FrameErrorConfig

SHARED = {'frame_position_deviation': 0.03, 'frame_heading_deviation': 0.02}
START = {'a': Pose2(0.0, 3.0, 0.0)}
STEP = 0.05**2 * np.diag([1.0, 0.25, 1.0])


def see_with_shared_error(world, stamp, random):
    """Observe from a pose that the error of the frame displaces."""
    true = world.true['a']
    error = random.normal(0.0, [0.03, 0.03, 0.02])
    world.true['a'] = Pose2.from_array(compose(np.asarray(true), error))
    found = world.see('a', stamp)
    world.true['a'] = true
    return found


def drive(make_world, make_slam, seed, **values):
    """Return the NEES of the pose along a circle."""
    world, random = make_world(seed=seed, deviation=0.01), np.random.default_rng(seed)
    slam = make_slam(world.start(**START), seed, **values)
    nees = []
    for step in range(40):
        world.drive('a', Pose2(0.1, 0.0, 0.1))
        slam.predict('a', Pose2(0.1, 0.0, 0.1), np.diag([0.02, 0.01, 0.03]) ** 2)
        slam.update('a', see_with_shared_error(world, float(step), random))
        pose, covariance = slam.estimate('a')
        error = world.error('a', pose)
        nees.append(error @ np.linalg.solve(covariance, error))
    return np.array(nees)


def test_a_pose_is_consistent_although_frames_err_as_a_whole(make_world, make_slam):
    told = np.mean([drive(make_world, make_slam, s, **SHARED).mean() for s in range(3)])
    untold = np.mean([drive(make_world, make_slam, s).mean() for s in range(3)])
    assert told < 6.0  # 3 is expected
    assert untold > 2.5 * told


def test_a_frame_never_adds_more_information_than_its_own_error_allows(make_world, make_slam):
    world = make_world(seed=1, deviation=0.001)
    slam = make_slam(world.start(**START), **SHARED)
    slam.predict('a', Pose2(0.0, 0.0, 0.0), np.zeros((3, 3)))
    slam.update('a', world.see('a', 0.0))
    slam.predict('a', Pose2(0.0, 0.0, 0.0), np.diag([1.0, 1.0, 0.01]))
    slam.update('a', world.see('a', 1.0))
    deviations = np.sqrt(np.diag(slam.estimate('a')[1]))
    assert (deviations[:2] > 0.8 * 0.03).all()
    assert deviations[2] > 0.8 * 0.02


@pytest.mark.parametrize('name', SHARED)
def test_half_a_frame_error_is_refused(name):
    with pytest.raises(ConfigError, match='expected both'):
        FrameErrorConfig(**{name: 0.01})


def test_no_frame_error_is_the_default():
    assert FrameErrorConfig().covariance() is None
    np.testing.assert_allclose(
        FrameErrorConfig(**SHARED).covariance(), np.diag([0.03, 0.03, 0.02]) ** 2
    )
