"""Wheel odometry with systematic errors is calibrated while driving, by landmarks."""

import numpy as np
import pytest

from explore_slam.errors import SlamError
from explore_slam.geometry import Pose2
from explore_slam.slam import OdometryNoise, compound

START = {'a': Pose2(1.0, 1.0, 0.0)}


def drive_wheels(slam, world, steps, *, turn=1.0, distance=1.0, drift=0.0, first=0):
    """Drive a figure of eight by wheels that count this much too far; returns position errors."""
    noise, errors = OdometryNoise(), []
    for step in range(first, first + steps):
        wheel = Pose2(0.3, 0.0, 0.25 if step // 25 % 2 == 0 else -0.25)
        true = np.asarray(wheel) + np.linalg.cholesky(
            noise.covariance(wheel) + 1e-12 * np.eye(3)
        ) @ world.random.standard_normal(3)
        world.true['a'] = world.true['a'].compose(Pose2(*true))
        slam.predict('a', Pose2(distance * wheel.x, 0.0, turn * (wheel.theta + drift * wheel.x)))
        seen = world.see('a', float(step), reach=4.5)
        if len(seen):
            slam.update('a', seen)
        errors.append(np.hypot(*world.error('a', slam.estimate('a')[0])[:2]))
    return np.array(errors)


@pytest.mark.parametrize('seed', [0, 1, 2])
def test_wheels_that_turn_too_far_are_calibrated(make_world, make_slam, seed):
    world = make_world(seed)
    slam = make_slam(world.start(**START), seed)
    errors = drive_wheels(slam, world, 150, turn=1.3)
    mean, covariance = slam.odometry_calibration('a')
    assert mean[0] == pytest.approx(1.0 / 1.3 - 1.0, abs=0.03)
    assert np.sqrt(np.diag(covariance)) == pytest.approx([0.02, 0.02, 0.02], abs=0.02)
    assert errors[75:].max() < 0.3
    # a redraw gives the particles the calibration of the graph: samples around its optimum
    slam.redraw([0])
    found, spread = slam.odometry_calibration('a')
    np.testing.assert_allclose(found, slam.joint.graph.calibration(0), atol=1e-9)
    np.testing.assert_allclose(found, mean, atol=0.02)
    deviations = [np.sqrt(np.diag(matrix)) for matrix in (spread, covariance)]
    np.testing.assert_allclose(*deviations, rtol=0.7)


@pytest.mark.parametrize('seed', [0, 1, 2])
def test_right_wheels_stay_right(make_world, make_slam, seed):
    world = make_world(seed)
    slam = make_slam(world.start(**START), seed)
    drive_wheels(slam, world, 150)
    mean, covariance = slam.odometry_calibration('a')
    assert np.abs(mean[:2]).max() < 0.02
    assert abs(mean[2]) < 0.03
    # and the claimed deviation covers the error
    assert np.abs(mean / np.sqrt(np.diag(covariance))).max() < 3.5


def test_distance_and_drift_are_found_too(make_world, make_slam):
    world = make_world(3)
    slam = make_slam(world.start(**START))
    drive_wheels(slam, world, 200, distance=1.08, drift=0.05)
    mean, _ = slam.odometry_calibration('a')
    assert mean[1] == pytest.approx(1.0 / 1.08 - 1.0, abs=0.02)
    assert mean[2] == pytest.approx(-0.05 / 1.08, abs=0.03)


def test_a_motion_with_a_covariance_is_taken_as_it_is(make_world, make_slam, drive_circles):
    """Scan matching has no wheels: nothing is learned of the calibration beyond its prior."""
    world = make_world()
    slam = make_slam(world.start(**START))
    drive_circles(slam, world, 30)
    assert slam.joint.draws > 1
    mean, covariance = slam.odometry_calibration('a')
    deviations = slam.config.calibration.deviations()
    np.testing.assert_allclose(mean, 0.0, atol=0.3 * deviations.max())
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), deviations, rtol=0.5)
    np.testing.assert_allclose(slam.joint.graph.calibration(0), 0.0, atol=1e-12)


@pytest.mark.parametrize('values', [{'odometry_calibration': False}, {'engine': 'paper'}])
def test_without_calibration_wheel_odometry_is_used_as_it_is(make_slam, values):
    slam = make_slam(START, **values)
    slam.predict('a', Pose2(1.0, 0.0, 0.5))
    pose, covariance = slam.estimate('a')
    assert pose == pytest.approx((2.0, 1.0, 0.5))
    np.testing.assert_allclose(covariance[2, 2], 0.002 + 0.5 * 0.005)
    mean, covariance = slam.odometry_calibration('a')
    assert not mean.any()
    assert not covariance.any()


def test_uncertain_calibration_makes_the_predicted_pose_uncertain(make_slam):
    slam = make_slam(START, particles=1000)
    for _ in range(10):
        slam.predict('a', Pose2(0.0, 0.0, 0.3))
    _, covariance = slam.estimate('a')
    expected = 3.0 * 0.005 + (0.1 * 3.0) ** 2
    assert covariance[2, 2] == pytest.approx(expected, rel=0.1)


def test_unknown_vehicles_are_refused(make_slam):
    with pytest.raises(SlamError, match="no vehicle 'x'"):
        make_slam(START).odometry_calibration('x')


def test_a_motion_that_is_not_predicted_yet_is_calibrated_as_well(make_world, make_slam):
    world = make_world(0)
    slam = make_slam(world.start(**START), 0)
    drive_wheels(slam, world, 100, turn=1.3)
    steps = [(Pose2(0.1, 0.0, 0.1), None)] * 20
    motion, spread = slam.motion('a', steps)
    assert motion.theta == pytest.approx(2.0 / 1.3, abs=0.1)
    before = slam.estimate('a')
    expected, covariance = compound(*before, motion, spread)
    for increment, _ in steps:
        slam.predict('a', increment)
    found, predicted = slam.estimate('a')
    np.testing.assert_allclose(found, expected, atol=0.02)
    np.testing.assert_allclose(np.sqrt(np.diag(predicted)), np.sqrt(np.diag(covariance)), rtol=0.2)
    # steps of known covariance are not of wheels
    known, spread = slam.motion('a', [(Pose2(0.1, 0.0, 0.1), 1e-6 * np.eye(3))])
    np.testing.assert_allclose(known, (0.1, 0.0, 0.1), atol=1e-12)
    np.testing.assert_allclose(spread, 1e-6 * np.eye(3), atol=1e-12)
