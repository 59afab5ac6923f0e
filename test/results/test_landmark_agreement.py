"""Landmark observations without odometry: counts, matches, agreement with the true poses."""

import numpy as np
import pytest

from explore_slam.data import LandmarkObservations
from explore_slam.errors import RecordingError
from explore_slam.geometry import rotation_matrix
from explore_slam.recording.importers.tum import import_tum
from explore_slam.results.landmark_agreement import mutual_matches, observation_metrics
from explore_slam.results.replay_run import replay_bag
from explore_slam.results.spatial_trajectory import SpatialTrajectory

LANDMARKS = np.random.default_rng(0).uniform([1, -2, -1], [4, 2, 1], (30, 3))
DESCRIPTORS = np.eye(30, 128, dtype=np.float32)


def pitched(angle: float) -> np.ndarray:
    return np.array([0.0, np.sin(angle / 2), 0.0, np.cos(angle / 2)])


def observe(stamp: float, rotation: np.ndarray, position: np.ndarray, noise: float, seed: int):
    rng = np.random.default_rng(seed)
    local = (LANDMARKS - position) @ rotation + rng.normal(0, noise, LANDMARKS.shape)
    order = rng.permutation(len(local))
    covariances = np.repeat(noise**2 * np.eye(3)[None], len(local), axis=0)
    return LandmarkObservations(stamp, local[order], covariances, DESCRIPTORS[order])


def moving(noise: float):
    """Observations of a body that turns and moves in space, and its true poses."""
    stamps = np.arange(0.0, 2.0, 0.02)
    quaternions = np.array([pitched(0.3 * stamp) for stamp in stamps])
    quaternions[::7] *= -1.0  # the same rotations
    positions = np.column_stack([0.1 * stamps, -0.2 * stamps, 0.05 * stamps])
    truth = SpatialTrajectory(stamps, positions, quaternions)
    seen = [
        observe(stamp, rotation_matrix(0.0, 0.3 * stamp, 0.0), stamp * np.array([0.1, -0.2, 0.05]),
                noise, index)
        for index, stamp in enumerate(np.arange(0.05, 1.9, 0.1))
    ]  # fmt: skip
    return seen, truth


def test_true_observations_agree_and_their_distance_is_their_noise():
    found = observation_metrics(*moving(0.02), gate=0.4)
    assert found['frames'] == 19
    assert found['observations_mean'] == 30
    assert found['matches_mean'] == 30
    assert found['matches_that_agree'] > 0.98
    # the norm of a difference of two 3-D errors of 0.02 m each: median 1.54 * sqrt(2) * 0.02
    assert found['distance_median'] == pytest.approx(0.0435, rel=0.1)


def test_a_wrong_mounting_shows():
    seen, truth = moving(0.02)
    tilt = rotation_matrix(0.0, 0.0, 0.3)
    tilted = [
        LandmarkObservations(o.stamp, o.positions @ tilt, o.covariances, o.descriptors)
        for o in seen
    ]
    assert observation_metrics(tilted[::6], truth, 0.4)['matches_that_agree'] < 0.8
    assert observation_metrics(seen[::6], truth, 0.4)['matches_that_agree'] > 0.97


def test_without_truth_only_counts_are_reported():
    seen, _ = moving(0.02)
    found = observation_metrics(seen, None, 0.4)
    assert 'matches_that_agree' not in found
    assert found['matches_mean'] == 30


def test_matches_are_mutual_and_within_the_gate():
    first = LandmarkObservations(0.0, LANDMARKS[:3], np.zeros((3, 3, 3)), DESCRIPTORS[:3])
    other = DESCRIPTORS[[2, 5, 0]]
    second = LandmarkObservations(0.1, LANDMARKS[:3], np.zeros((3, 3, 3)), other)
    rows, partners = mutual_matches(first, second, 0.4)
    assert rows.tolist() == [0, 2]
    assert partners.tolist() == [2, 0]
    assert mutual_matches(first, LandmarkObservations.empty(0.2), 0.4)[0].size == 0


@pytest.mark.data
def test_real_frames_agree_with_motion_capture(recordings, tmp_path):
    import_tum(recordings('tum_fr1_rpy'), tmp_path / 'bag')
    data = replay_bag(tmp_path / 'bag', until=4.0)
    found = data.metrics['observations']['robot1']
    assert found['frames'] == 24
    assert found['observations_mean'] > 100
    assert found['frames_without_observations'] == 0
    assert found['matches_mean'] > 40
    assert found['matches_that_agree'] > 0.65
    assert found['distance_median'] < 0.025
    assert 'no odometry' in data.notes[0]
    assert len(data.landmarks.means) > 2000
    with pytest.raises(RecordingError, match='holds no frame'):
        replay_bag(tmp_path / 'bag', until=-1.0)
