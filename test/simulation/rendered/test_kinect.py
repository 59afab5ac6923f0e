"""The simulated Kinect: depth noise as of its matching window, and a rolling shutter."""

import numpy as np
import pytest

from explore_slam.settings import with_values
from explore_slam.simulation.config import SimulatedKinectConfig
from explore_slam.simulation.rendered.kinect import KinectSensor

WALL = 2.0  # m


def sensor(seed=0, **values):
    config = with_values(SimulatedKinectConfig(), values)
    return KinectSensor(config, np.random.default_rng(seed))


def wall():
    color = np.full((480, 640, 3), 90, np.uint8)
    color[:, 320:] = 160
    return color, np.full((480, 640), WALL, np.float32)


def depth_errors(frames):
    """Return the errors of depth (frames, H, W) at a wall, in deviations of the settings."""
    kinect = sensor()
    errors = [kinect.measure(0.1 * k, *wall()).depth * 1e-3 - WALL for k in range(frames)]
    return np.array(errors) / (0.003 * WALL**2)


def test_depth_noise_has_its_deviation_and_is_shared_by_neighbours():
    """Windows of 9 x 9 that are shifted by k have (9 - k) / 9 of their pixels in common."""
    errors = depth_errors(12)
    assert errors.mean() == pytest.approx(0.0, abs=0.03)
    assert errors.std() == pytest.approx(1.0, rel=0.03)
    for axis in (1, 2):
        for lag in (1, 4, 9, 15):
            one = np.take(errors, np.arange(lag, errors.shape[axis]), axis)
            other = np.take(errors, np.arange(errors.shape[axis] - lag), axis)
            expected = max(0.0, (9 - lag) / 9)
            assert (one * other).mean() == pytest.approx(expected, abs=0.06)


def test_noise_of_frames_is_independent_and_repeats_with_the_seed():
    first, second = depth_errors(2)
    assert (first * second).mean() == pytest.approx(0.0, abs=0.06)
    np.testing.assert_array_equal(depth_errors(1)[0], first)


@pytest.mark.parametrize('turn_rate', [0.0, 0.8, -0.8])
def test_rows_of_a_turning_camera_are_exposed_one_after_another(turn_rate):
    """Turning left, the scene moves to the right: more so, the later a row is exposed."""
    kinect = sensor(simulated_color_noise=0.0, simulated_readout_time=0.03)
    frame = kinect.measure(0.0, *wall(), turn_rate)
    edges = (frame.rgb[:, :, 0] > 125).argmax(axis=1)
    shift = kinect.intrinsics.fx * turn_rate * 0.03
    assert edges[-1] - edges[0] == pytest.approx(shift, abs=1.0)
    assert edges[240] == pytest.approx(320, abs=1)


def test_depth_shifts_as_colour_does():
    kinect = sensor(simulated_color_noise=0.0, simulated_depth_noise=0.0)
    color, depth = wall()
    depth[:, 320:] = 3.0
    frame = kinect.measure(0.0, color, depth, 1.5)
    np.testing.assert_allclose(
        (frame.depth > 2500).argmax(axis=1), (frame.rgb[:, :, 0] > 125).argmax(axis=1), atol=1
    )
    assert set(np.unique(frame.depth)) == {2000, 3000}  # none in between at the edge
