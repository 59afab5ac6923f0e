"""Between keyframes, poses follow odometry."""

import numpy as np
import pytest

from explore_slam.geometry import between, compose
from explore_slam.results.keyframe_interpolation import calibrated_path, extrapolate, interpolate
from explore_slam.results.trajectory import Trajectory
from explore_slam.slam import OdometryCalibration

STAMPS = np.arange(0.0, 10.01, 0.05)


def circle(stamps) -> np.ndarray:
    angle = 0.4 * np.asarray(stamps)
    return np.column_stack([np.sin(angle), 1.0 - np.cos(angle), angle])


def odometry() -> Trajectory:
    """True motion, in an odometry frame of its own."""
    return Trajectory.of(STAMPS, compose(np.array([3.0, 1.0, -0.7]), circle(STAMPS)))


def test_with_true_odometry_and_keyframes_everything_is_true():
    keyframes = Trajectory.of([0.0, 3.0, 8.0], circle([0.0, 3.0, 8.0]))
    for made, end in (
        (extrapolate(keyframes, odometry()), 10.0),
        (interpolate(keyframes, odometry()), 8.0),
    ):
        assert made.stamps[-1] == pytest.approx(end)
        assert np.diff(made.stamps).max() <= 0.4
        assert set(keyframes.stamps) <= set(made.stamps)
        np.testing.assert_allclose(made.poses[:, :2], circle(made.stamps)[:, :2], atol=1e-3)


def test_wheels_that_are_calibrated_lead_to_the_true_path():
    true = odometry()
    steps = between(true.poses[:-1], true.poses[1:])
    poses = [true.poses[0]]
    for dx, dy, turn in steps:  # as measured by wheels that turn too far and drift
        wrong = [dx / 1.1, dy / 1.1, (turn - 0.2 * dx / 1.1) / 0.7]
        poses.append(compose(poses[-1], np.array(wrong)))
    wheels = Trajectory.of(STAMPS, np.array(poses))
    found = calibrated_path(wheels, OdometryCalibration(0.7, 0.01, 1.1, 0.01, 0.2, 0.01))
    np.testing.assert_allclose(found.poses[:, :2], true.poses[:, :2], atol=1e-9)
    assert np.abs(wheels.poses[:, :2] - true.poses[:, :2]).max() > 0.5


def test_a_correction_shows_at_its_keyframe_online_and_is_shared_out_afterwards():
    poses = circle([0.0, 5.0])
    poses[1] += [0.5, 0.0, 0.0]
    keyframes = Trajectory.of([0.0, 5.0], poses)
    online, final = extrapolate(keyframes, odometry()), interpolate(keyframes, odometry())
    before = int(np.searchsorted(online.stamps, 5.0)) - 1
    expected = circle([online.stamps[before]])[0, :2]
    assert online.poses[before, :2] == pytest.approx(expected, abs=1e-9)
    assert online.poses[before + 1] == pytest.approx(poses[1])
    middle, _ = final.at([2.5])
    assert middle[0, 0] - circle([2.5])[0, 0] == pytest.approx(0.25, abs=0.01)
    assert final.poses[-1] == pytest.approx(poses[1])


def test_without_odometry_only_the_keyframes_are_known():
    keyframes = Trajectory.of([0.0, 3.0], circle([0.0, 3.0]))
    nothing = Trajectory.of([], [])
    assert extrapolate(keyframes, nothing) is keyframes
    assert interpolate(keyframes, nothing) is keyframes
    assert extrapolate(nothing, odometry()) is nothing


def test_dense_keyframes_are_kept_as_they_are():
    keyframes = Trajectory.of(STAMPS, circle(STAMPS))
    np.testing.assert_array_equal(extrapolate(keyframes, odometry()).stamps, keyframes.stamps)
    same = interpolate(keyframes, odometry()).poses
    np.testing.assert_allclose(same[:, :2], keyframes.poses[:, :2], atol=1e-9)
