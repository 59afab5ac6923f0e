import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from explore_slam.geometry import IDENTITY, Pose2, compose, rotated
from explore_slam.slam import OdometryCalibration, OdometryNoise, compound
from explore_slam.slam.particles.motion import (
    PendingMotion,
    Segment,
    calibrated,
    split_heading,
)

NOISE = OdometryNoise(heading_variance_per_metre=0.01)


def measured(increment, covariance):
    return Segment.empty()._replace(mean=increment, covariance=covariance)


def of_wheels(increment, calibration):
    corrected, sensitivity = calibrated(increment, calibration)
    noise = NOISE.covariance(increment)
    return Segment(corrected, noise, sensitivity, sensitivity @ calibration)


def test_a_motion_in_many_steps_is_as_uncertain_as_in_few():
    def drive(steps):
        mean, covariance = IDENTITY, np.zeros((3, 3))
        for _ in range(steps):
            step = Pose2(2.0 / steps, 0.0, 0.0)
            mean, covariance = compound(mean, covariance, step, NOISE.covariance(step))
        return mean, covariance

    (mean, many), (_, more) = drive(100), drive(200)
    assert mean == pytest.approx((2.0, 0.0, 0.0))
    np.testing.assert_allclose(many, more, rtol=0.01, atol=1e-6)
    # heading error of the way becomes lateral error: var = q · L³ / 3 beside what is lateral noise
    lateral = NOISE.lateral_variance_per_metre * 2.0
    assert more[1, 1] - lateral == pytest.approx(0.01 * 2.0**3 / 3, rel=0.02)


def test_compounding_agrees_with_sampling():
    random = np.random.default_rng(0)
    poses = np.zeros((40_000, 3))
    mean, covariance = IDENTITY, np.zeros((3, 3))
    Q = np.diag([0.01, 0.005, 0.02]) ** 2
    for turn in (0.2, -0.4, 0.3, 0.5):
        step = Pose2(0.5, 0.1, turn)
        mean, covariance = compound(mean, covariance, step, Q)
        noise = random.multivariate_normal(np.zeros(3), Q, len(poses))
        poses = compose(poses, np.asarray(step) + noise)
    np.testing.assert_allclose(np.cov((poses - np.asarray(mean)).T), covariance, atol=1.5e-5)


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3))
def test_odometry_noise_is_a_covariance_and_turns_with_the_motion(x, y, theta):
    Q = NOISE.covariance(Pose2(x, y, theta))
    assert np.linalg.eigvalsh(Q)[0] >= -1e-12
    along = NOISE.covariance(Pose2(np.hypot(x, y), 0.0, theta))
    np.testing.assert_allclose(Q, rotated(along, -np.arctan2(y, x)), atol=1e-12)


def test_split_heading_takes_out_what_it_says():
    A = np.array([[0.3, 0.1, 0.0], [0.0, 0.2, 0.1], [0.1, 0.2, 0.5]])
    P = A @ A.T
    direction, rest = split_heading(P, 0.05)
    np.testing.assert_allclose(rest + np.outer(direction, direction), P)
    assert rest[2, 2] == pytest.approx(0.05**2)
    assert np.linalg.eigvalsh(rest)[0] >= -1e-12


def test_long_gap_is_sampled_along_its_bend():
    """Heading uncertain by a radian: samples lie on an arc, not on its tangent."""
    motion = PendingMotion()
    for _ in range(100):
        motion.append(measured(Pose2(0.05, 0.0, 0.0), np.diag([1e-6, 1e-6, 0.01])), 0.1)
    assert motion.total().mean.x == pytest.approx(5.0)
    start = np.zeros((4000, 3))
    poses, left = motion.propagate(start, start, 0.1, np.random.default_rng(0))
    assert np.std(poses[:, 2]) == pytest.approx(1.0, abs=0.05)
    assert left[2, 2] <= 0.1**2
    assert np.hypot(poses[:, 0], poses[:, 1]).max() < 5.3
    # E[cos] of a random walk in heading: mean x = Σ step · exp(-σ²/2)
    expected = sum(0.05 * np.exp(-0.005 * n) for n in range(100))
    assert poses[:, 0].mean() == pytest.approx(expected, abs=0.1)


def test_calibration_corrects_wheels_that_turn_and_drive_too_far():
    """Wheels of 1.3 and 1.1 times the turn and distance, and a drift of 0.02 rad/m."""
    true = Pose2(0.5, 0.1, 0.4)
    seen = Pose2(1.1 * 0.5, 1.1 * 0.1, 1.3 * (0.4 - 0.02 * 1.1 * 0.5))
    right = np.array([1 / 1.3 - 1.0, 1 / 1.1 - 1.0, 0.02])
    assert calibrated(seen, right).increment == pytest.approx(true)
    assert calibrated(seen, np.zeros(3)).increment == seen


def test_sensitivities_are_the_numeric_derivatives_of_a_compounded_motion():
    steps = [Pose2(0.5, 0.02, 0.3), Pose2(0.3, 0.0, -0.5), Pose2(0.6, -0.01, 0.2)]
    at = np.array([0.05, -0.03, 0.02])

    def total(calibration):
        motion = PendingMotion()
        for step in steps:
            motion.append(of_wheels(step, calibration), 0.1)
        return motion.total()

    whole = total(at)
    for i, step in enumerate(1e-6 * np.eye(3)):
        change = np.asarray(total(at + step).mean) - np.asarray(total(at - step).mean)
        np.testing.assert_allclose(change / 2e-6, whole.sensitivity[:, i], atol=1e-8)
    # a particle of another calibration moves as if the steps had been corrected by its own
    other = at + [0.01, -0.01, 0.01]
    np.testing.assert_allclose(
        whole.moves(np.array([at, other])), [whole.mean, total(other).mean], atol=3e-4
    )
    np.testing.assert_allclose(whole.moves(at[None])[0], whole.mean, atol=1e-15)


def test_particles_move_by_their_own_calibration():
    motion = PendingMotion()
    for _ in range(10):
        motion.append(of_wheels(Pose2(0.2, 0.0, 0.1), np.zeros(3)), 0.1)
    poses = motion.apply(np.zeros((2, 3)), np.array([[0.0, 0.0, 0.0], [-0.2, 0.1, 0.0]]))
    assert poses[0, 2] == pytest.approx(1.0)
    assert poses[1, 2] == pytest.approx(0.8)
    assert np.hypot(*poses[1, :2]) > np.hypot(*poses[0, :2])


def test_motion_continues_from_its_saved_state():
    motion, again = PendingMotion(), PendingMotion()
    for _ in range(40):
        motion.append(of_wheels(Pose2(0.2, 0.0, 0.1), np.array([0.01, 0.0, 0.02])), 0.1)
    assert len(motion.segments) > 1
    again.restore(motion.state_dict())
    poses, calibrations = np.zeros((8, 3)), 0.01 * np.ones((8, 3))
    for found, expected in zip(
        again.propagate(poses, calibrations, 0.1, np.random.default_rng(1)),
        motion.propagate(poses, calibrations, 0.1, np.random.default_rng(1)),
        strict=True,
    ):
        np.testing.assert_array_equal(found, expected)


def test_a_calibration_holds_factors_and_their_deviations():
    found = OdometryCalibration.of(np.array([0.1, -0.2, 0.03]), np.diag([0.01, 0.02, 0.04]) ** 2)
    assert found == pytest.approx((1.1, 0.01, 0.8, 0.02, 0.03, 0.04))
