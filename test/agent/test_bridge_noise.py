"""How much odometry errs between two matched scans is learnt from the matches."""

import numpy as np
import pytest

from explore_slam.agent.bridge_noise import BridgeNoise
from explore_slam.geometry import Pose2

P = np.array([[4e-4, 1e-4, 2e-5], [1e-4, 2e-4, 0.0], [2e-5, 0.0, 1e-3]])  # by the settings


def matches(random, scale, count):
    """Return by how much matches are off from an odometry whose variances are P times a scale."""
    root = np.linalg.cholesky(scale * P)
    return [Pose2.from_array(root @ random.standard_normal(3)) for _ in range(count)]


def test_the_first_match_counts_little():
    noise = BridgeNoise()
    np.testing.assert_array_equal(noise.scale, [1.0, 1.0])
    scaled = noise.scaled(Pose2(0.0, 0.0, 0.0), P)
    np.testing.assert_allclose(scaled, P, rtol=0.06)


@pytest.mark.parametrize('scale', [0.3, 1.0, 4.0])
def test_the_scale_becomes_that_of_the_odometry(scale):
    found = []
    for seed in range(5):
        noise, random = BridgeNoise(), np.random.default_rng(seed)
        for off in matches(random, scale, 600):
            scaled = noise.scaled(off, P)
        found.append(noise.scale)
        assert np.linalg.eigvalsh(scaled).min() > 0.0
    # what is known beforehand counts as a tenth of the matches remembered
    expected = (1.0 + 9.5 * scale) / 10.5
    np.testing.assert_allclose(np.mean(found, axis=0), [expected] * 2, rtol=0.15)


def test_the_scale_follows_the_floor():
    noise, random = BridgeNoise(), np.random.default_rng(1)
    for off in matches(random, 0.1, 400):
        noise.scaled(off, P)
    assert (noise.scale < 0.3).all()
    for off in matches(random, 4.0, 400):
        noise.scaled(off, P)
    assert (noise.scale > 2.5).all()


def test_position_and_heading_have_scales_of_their_own():
    noise, random = BridgeNoise(), np.random.default_rng(2)
    for off in matches(random, 1.0, 400):
        scaled = noise.scaled(off._replace(theta=0.0), P)
    position, heading = noise.scale
    assert position > 0.8
    assert heading < 0.15
    assert scaled[2, 2] == pytest.approx(heading * P[2, 2])
    assert scaled[0, 2] == pytest.approx(np.sqrt(position * heading) * P[0, 2])


def test_a_slip_widens_its_own_bridge_alone():
    noise, random = BridgeNoise(), np.random.default_rng(3)
    for off in matches(random, 0.1, 400):
        noise.scaled(off, P)
    slipped = noise.scaled(Pose2(0.3, 0.0, 0.0), P)
    assert np.sqrt(slipped[0, 0] + slipped[1, 1]) == pytest.approx(0.1)  # three deviations
    after = noise.scaled(Pose2(0.0, 0.0, 0.0), P)
    assert after[0, 0] < 0.3 * slipped[0, 0]


def test_odometry_that_claims_to_be_exact_is_left_so():
    noise = BridgeNoise()
    exact = noise.scaled(Pose2(0.0, 0.0, 0.0), np.zeros((3, 3)))
    np.testing.assert_array_equal(exact, np.zeros((3, 3)))
    assert np.isfinite(noise.scaled(Pose2(1e-3, 0.0, 1e-3), P)).all()


def test_odometry_that_knew_nothing_shows_nothing():
    noise, other, random = BridgeNoise(), BridgeNoise(), np.random.default_rng(4)
    for _ in range(10):
        noise.scaled(Pose2(0.01, 0.0, 0.0), np.diag([1.0, 1.0, 1.0]))
    for off in matches(random, 1.0, 50):
        np.testing.assert_array_equal(noise.scaled(off, P), other.scaled(off, P))
