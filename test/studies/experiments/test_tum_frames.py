"""Real Kinect frames with ground truth as observations of a planar vehicle."""

import itertools
import math

import numpy as np
import pytest

from explore_slam.errors import EvaluationError, RecordingError
from explore_slam.settings import with_values
from explore_slam.studies.experiments.tum_frames import CameraTruth, read_tum
from explore_slam.vision import VisionConfig


def test_static_points_agree_between_real_frames(recordings):
    frames = read_tum(
        recordings('tum_fr1_rpy'),
        with_values(VisionConfig(), {'feature_budget': 300}),
        every=2,
        limit=4,
    )
    apart = []
    for before, now in itertools.pairwise(frames):
        np.testing.assert_allclose(np.linalg.norm(now.descriptors, axis=1), 1.0, atol=1e-5)
        distance = 2.0 - 2.0 * before.observations.descriptors @ now.observations.descriptors.T
        two_best = np.sort(distance, axis=1)[:, :2]
        rows = np.flatnonzero(two_best[:, 0] < 0.3 * two_best[:, 1])
        columns = distance[rows].argmin(axis=1)
        apart.extend(np.linalg.norm(before.points[rows] - now.points[columns], axis=1))
    assert len(apart) > 30
    assert np.median(apart) < 0.03


def test_planar_vehicle_sees_the_true_points(recordings):
    frame = read_tum(recordings('tum_fr1_rpy'), VisionConfig(), every=40, limit=2)[1]
    c, s = math.cos(frame.pose.theta), math.sin(frame.pose.theta)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    world = frame.observations.positions @ turn.T + (frame.pose.x, frame.pose.y, 0.0)
    np.testing.assert_allclose(world, frame.points, atol=1e-9)
    assert np.linalg.eigvalsh(frame.observations.covariances).min() > 0.0


def test_folder_without_frames_is_refused(tmp_path):
    with pytest.raises(EvaluationError, match=r'associations\.txt'):
        read_tum(tmp_path, VisionConfig())


def test_ground_truth_is_interpolated_and_checked(tmp_path):
    path = tmp_path / 'groundtruth.txt'
    path.write_text('# t tx ty tz qx qy qz qw\n1 0 0 1 0 0 0 1\n2 2 0 1 0 0 0 1\n')
    turn, place = CameraTruth(path).at(1.5)
    np.testing.assert_allclose(place, [1.0, 0.0, 1.0])
    np.testing.assert_allclose(turn @ [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], atol=1e-12)
    with pytest.raises(EvaluationError, match=r'3\.000 s'):
        CameraTruth(path).at(3.0)
    path.write_text('1 2 3\n4 5 6\n')
    with pytest.raises(RecordingError, match='3 columns, expected 8'):
        CameraTruth(path)
