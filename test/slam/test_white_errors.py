"""White errors of measured poses: the next motion takes them back, in filter and graph alike."""

import numpy as np
import pytest
from slam.conftest import unit_rows

from explore_slam.data import InterRobotObservation, LandmarkObservations
from explore_slam.errors import SlamError
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.slam import FastSlam, FastSlamConfig

STEP = Pose2(0.5, 0.0, 0.0)
WALK, WHITE = np.diag([1e-4, 1e-4, 1e-9]), np.diag([9e-4, 4e-4, 1e-9])


def make(particles=400, vehicles=('a',), **settings):
    starts = {name: Pose2(0.0, 2.0 * n, 0.0) for n, name in enumerate(vehicles)}
    config = FastSlamConfig(particles=particles, **settings)
    return FastSlam(starts, config, seed=3)


def seen(stamp, deviation):
    """Four landmarks at the same places in the map, seen from half a metre further each time."""
    random = np.random.default_rng(5)
    points = np.c_[random.uniform(2, 4, (4, 2)) - (0.5 * stamp, 0.0), np.full(4, 0.3)]
    R = np.tile(deviation**2 * np.eye(3), (4, 1, 1))
    return LandmarkObservations(stamp, points, R, unit_rows(random, 4))


def test_without_observations_white_errors_do_not_add_up():
    slam = make()
    for k in range(1, 6):
        slam.predict('a', STEP, WALK, WHITE)
        _, P = slam.estimate('a')
        np.testing.assert_allclose(P[0, 0], k * WALK[0, 0] + WHITE[0, 0], rtol=1e-3)


def test_a_motion_without_white_error_goes_on_from_the_last_measured_pose():
    slam = make()
    slam.predict('a', STEP, WALK, WHITE)
    slam.predict('a', STEP, WALK)
    np.testing.assert_allclose(slam.estimate('a')[1][0, 0], 2 * WALK[0, 0], rtol=1e-3)


def test_a_white_error_turns_with_the_vehicle():
    slam = make()
    slam.predict('a', Pose2(0.0, 0.0, np.pi / 2), np.zeros((3, 3)), WHITE)
    np.testing.assert_allclose(np.diag(slam.estimate('a')[1])[:2], (4e-4, 9e-4), rtol=1e-6)


def test_the_pose_after_an_update_does_not_bind_the_next_more_than_the_walk_does():
    """The white error that the observations have revealed is gone with the next motion."""
    slam = make(2000)
    zero = np.zeros((3, 3))
    slam.predict('a', IDENTITY, zero)
    slam.update('a', seen(0.0, 1e-3))
    slam.predict('a', STEP, WALK, WHITE)
    slam.update('a', seen(1.0, 1e-3))
    assert slam.estimate('a')[1][0, 0] < 1e-5
    slam.predict('a', STEP, WALK, WHITE)
    # of the error until the update, the walk has its share only: c | x with x = c + w
    kept = WALK[0, 0] * WHITE[0, 0] / (WALK[0, 0] + WHITE[0, 0])
    expected = kept + WALK[0, 0] + WHITE[0, 0]
    assert slam.estimate('a')[1][0, 0] == pytest.approx(expected, rel=0.03)


def test_an_observed_shift_is_put_down_to_white_error_and_walk_by_their_variances():
    slam = make(2000)
    slam.predict('a', IDENTITY, np.zeros((3, 3)))
    slam.update('a', seen(0.0, 1e-3))
    slam.predict('a', STEP, WALK, WHITE)
    late = seen(1.0, 1e-3)
    shifted = LandmarkObservations(
        1.0, late.positions - (0.02, 0.0, 0.0), late.covariances, late.descriptors
    )
    slam.update('a', shifted)
    assert slam.estimate('a')[0].x == pytest.approx(0.52, abs=2e-3)
    slam.predict('a', STEP, WALK, WHITE)
    share = WALK[0, 0] / (WALK[0, 0] + WHITE[0, 0])
    assert slam.estimate('a')[0].x == pytest.approx(1.0 + 0.02 * share, abs=2e-3)


def test_a_redraw_continues_from_where_the_motion_begins():
    slam = make(4000)
    for k in range(1, 4):
        slam.predict('a', STEP, WALK, WHITE)
        slam.add_keyframe('a', float(k))
    slam.redraw([0])
    poses = slam.particle_poses('a')
    assert poses[:, 0].var() == pytest.approx(3 * 1e-4 + 9e-4, rel=0.1)
    slam.predict('a', STEP, WALK, WHITE)
    assert slam.particle_poses('a')[:, 0].var() == pytest.approx(3 * 1e-4, rel=0.1)
    expected = 4 * WALK[0, 0] + WHITE[0, 0]
    assert slam.estimate('a')[1][0, 0] == pytest.approx(expected, rel=0.05)


def test_a_redraw_between_keyframes_keeps_the_motion_since():
    slam = make(4000)
    slam.predict('a', STEP, WALK, WHITE)
    slam.add_keyframe('a', 1.0)
    slam.predict('a', STEP, WALK, WHITE)
    before = slam.estimate('a')
    slam.redraw([0])
    after = slam.estimate('a')
    np.testing.assert_allclose(after[0], before[0], atol=1e-9)
    np.testing.assert_allclose(np.diag(after[1])[:2], np.diag(before[1])[:2], rtol=0.05)


def test_an_observed_vehicle_takes_its_white_error_back_as_well():
    slam = make(2000, vehicles=('a', 'b'))
    for name in ('a', 'b'):
        slam.predict(name, STEP, WALK if name == 'b' else 1e-10 * WALK, WHITE * (name == 'b'))
    exact = InterRobotObservation(1.0, 'b', np.array([0.0, 2.0]), 1e-8 * np.eye(2))
    slam.update_inter_robot('a', [exact])
    assert slam.estimate('b')[1][0, 0] < 1e-5
    slam.predict('b', STEP, WALK, WHITE)
    kept = WALK[0, 0] * WHITE[0, 0] / (WALK[0, 0] + WHITE[0, 0])
    expected = kept + WALK[0, 0] + WHITE[0, 0]
    assert slam.estimate('b')[1][0, 0] == pytest.approx(expected, rel=0.05)


def test_a_given_pose_ends_the_chain():
    slam = make()
    slam.predict('a', IDENTITY, np.zeros((3, 3)))
    slam.update('a', seen(0.0, 1e-3))
    slam.predict('a', STEP, WALK, WHITE)
    slam.update('a', seen(1.0, 1e-3))
    slam.set_pose('a', Pose2(5.0, 5.0, 0.0), np.zeros((3, 3)))
    slam.predict('a', STEP, WALK)
    pose, P = slam.estimate('a')
    assert pose == pytest.approx((5.5, 5.0, 0.0))
    assert P[0, 0] == pytest.approx(WALK[0, 0], rel=1e-3)


def test_the_state_goes_on_bit_by_bit():
    slam = make(50)
    slam.predict('a', IDENTITY, np.zeros((3, 3)))
    slam.update('a', seen(0.0, 1e-3))
    slam.predict('a', STEP, WALK, WHITE)
    slam.update('a', seen(1.0, 1e-2))
    copy = FastSlam.from_state(slam.state_dict())
    for one in (slam, copy):
        one.predict('a', STEP, WALK, WHITE)
        one.update('a', seen(2.0, 1e-2))
        one.predict('a', STEP, WALK, WHITE)
    np.testing.assert_array_equal(slam.particle_poses('a'), copy.particle_poses('a'))
    np.testing.assert_array_equal(slam.estimate('a')[1], copy.estimate('a')[1])


@pytest.mark.parametrize('white', [np.full((3, 3), np.nan), -np.eye(3), np.eye(2)])
def test_a_bad_white_error_is_refused_and_changes_nothing(white):
    slam = make()
    slam.predict('a', STEP, WALK, WHITE)
    before = slam.estimate('a')
    with pytest.raises(SlamError, match='white'):
        slam.predict('a', STEP, WALK, white)
    np.testing.assert_array_equal(slam.estimate('a')[1], before[1])
