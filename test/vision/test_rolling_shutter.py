"""Features seen by a rolling shutter in motion, with and without known moments of exposure."""

from dataclasses import replace

import numpy as np
import pytest

from explore_slam.data import Intrinsics, LandmarkObservations, RgbdFrame
from explore_slam.errors import DataError
from explore_slam.geometry import Pose2
from explore_slam.vision import FeatureExtractor
from explore_slam.vision.rolling_shutter import at_the_stamp, row_delays

READOUT = 0.03
VELOCITY = np.array([0.4, 0.05, 0.8])


def observations():
    random = np.random.default_rng(0)
    places = random.uniform([0.5, -2.0, 0.0], [3.0, 2.0, 1.5], (20, 3))
    covariances = np.broadcast_to(np.diag([4e-4, 1e-4, 1e-4]), (20, 3, 3))
    return LandmarkObservations(1.0, places, covariances, np.zeros((20, 128), np.float32))


def seen_later(positions, delay):
    """Return positions (K, 3) in the frame of a vehicle that has moved on for a time (s)."""
    x, y, theta = VELOCITY * delay
    moved = Pose2(x, y, theta).inverse()
    c, s = np.cos(moved.theta), np.sin(moved.theta)
    later = positions.copy()
    later[:, :2] = positions[:, :2] @ [[c, s], [-s, c]] + [moved.x, moved.y]
    return later


def test_covariances_are_those_of_features_from_any_row():
    seen = observations()
    found = at_the_stamp(seen, VELOCITY, READOUT)
    late = READOUT * (np.linspace(0.0, 1.0, 2001) - 0.5)
    drawn = [seen_later(seen.positions, delay) - seen.positions for delay in late]
    spread = np.einsum('kni,knj->nij', drawn, drawn) / len(drawn)
    np.testing.assert_allclose(found.covariances - seen.covariances, spread, atol=2e-6)
    assert spread.max() > 5e-5  # a turn tells
    np.testing.assert_array_equal(found.positions, seen.positions)


def test_known_delays_are_undone():
    at_stamp = observations()
    delays = READOUT * (np.random.default_rng(1).uniform(0.0, 1.0, 20) - 0.5)
    places = np.concatenate(
        [seen_later(at_stamp.positions[k : k + 1], d) for k, d in enumerate(delays)]
    )
    seen = replace(at_stamp, positions=places, delays=delays)
    found = at_the_stamp(seen, VELOCITY, 0.0)
    assert np.abs(places - at_stamp.positions).max() > 0.02
    np.testing.assert_allclose(found.positions, at_stamp.positions, atol=4e-4)
    assert found.delays is None
    # a fifth of the motion remains in the covariance
    added = np.sqrt(np.trace(found.covariances - seen.covariances, axis1=1, axis2=2))
    displaced = np.linalg.norm(places - at_stamp.positions, axis=1)
    np.testing.assert_allclose(added, 0.2 * displaced, rtol=0.03)
    assert (np.linalg.eigvalsh(found.covariances) > 0.0).all()


def test_at_rest_known_delays_do_not_matter():
    seen = replace(observations(), delays=np.full(20, 0.01))
    found = at_the_stamp(seen, np.zeros(3), READOUT)
    np.testing.assert_array_equal(found.positions, seen.positions)
    np.testing.assert_array_equal(found.covariances, seen.covariances)
    assert found.delays is None


def test_rows_are_exposed_from_the_first_to_the_last():
    np.testing.assert_allclose(
        row_delays(np.array([0.0, 239.5, 479.0]), 480, 0.026), [-0.013, 0, 0.013]
    )


def test_the_extractor_tells_when_features_were_exposed():
    image = np.random.default_rng(0).integers(0, 255, (60, 80), np.uint8).repeat(4, 0).repeat(4, 1)
    intrinsics = Intrinsics(320, 240, 262.0, 262.0, 159.5, 119.5)
    frame = RgbdFrame(1.0, image, np.full((240, 320), 2.0, np.float32), intrinsics)
    found, features = FeatureExtractor().extract_with_pixels(frame)
    assert len(found) > 20
    np.testing.assert_allclose(found.delays, (features.pixels[:, 1] / 239.0 - 0.5) * 0.026)
    # optical frame: rows downwards, so that what is high up is exposed first
    assert np.corrcoef(found.delays, found.positions[:, 2])[0, 1] < -0.95


@pytest.mark.parametrize('delays', [np.zeros(3), np.full(20, np.nan)])
def test_delays_of_another_number_or_none_at_all_are_refused(delays):
    with pytest.raises(DataError, match='delays'):
        replace(observations(), delays=delays)


@pytest.mark.parametrize(('velocity', 'readout'), [(VELOCITY, 0.0), (np.zeros(3), READOUT)])
def test_at_rest_or_with_a_global_shutter_nothing_changes(velocity, readout):
    seen = observations()
    assert at_the_stamp(seen, velocity, readout) is seen


def test_no_features_stay_none():
    assert not len(at_the_stamp(LandmarkObservations.empty(1.0), VELOCITY, READOUT))
