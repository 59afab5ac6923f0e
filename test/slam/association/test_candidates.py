"""Candidate search against brute force: every landmark near enough with a similar descriptor."""

import numpy as np
import pytest

from explore_slam.data import LandmarkObservations
from explore_slam.geometry import Pose2, to_world
from explore_slam.slam.association.candidates import find_candidates
from explore_slam.slam.config import AssociationConfig
from explore_slam.slam.descriptors.kd_forest import KdForestIndex
from explore_slam.slam.descriptors.kinds import SIFT
from explore_slam.slam.landmarks.landmark_map import LandmarkMap
from explore_slam.slam.storage.ancestry import AncestryTree

CONFIG = AssociationConfig(candidates_per_observation=3, association_gate=2.0)
MINIMUM_RADIUS = 0.5  # m
POSE = Pose2(4.0, 5.0, 0.8)
FAR_ALONG_Y, FAR_ALONG_X = Pose2(4.0, 30.0, 0.8), Pose2(30.0, -5.0, 0.8)
COVARIANCE = np.diag([0.02, 0.05, 0.01])


def unit_rows(random, count, like=None, blur=1.0):
    rows = blur * random.standard_normal((count, 128)) + (0.0 if like is None else like)
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


def map_of(positions, descriptors):
    tree = AncestryTree(4)
    found = LandmarkMap(4, SIFT, KdForestIndex(128, 64))
    addresses = found.rows.allocate(len(positions))
    found.rows.workspace[addresses] = 1.0
    found.add(addresses, descriptors, 0, positions, tree)
    return found


def expected(landmarks, observations, distances, pose):
    """Return the entries (K, J) of CandidateSet by comparing everything with everything."""
    z, R = observations.positions, observations.covariances
    variance = COVARIANCE[0, 0] + COVARIANCE[1, 1] + np.trace(R, axis1=1, axis2=2)
    variance = variance + (z[:, 0] ** 2 + z[:, 1] ** 2) * COVARIANCE[2, 2]
    radius = MINIMUM_RADIUS + CONFIG.association_gate * np.sqrt(variance)
    points = to_world(pose, z)
    off = np.linalg.norm(landmarks.reference[: landmarks.size] - points[:, None], axis=2)
    fits = (off <= radius[:, None]) & (distances <= CONFIG.maximum_descriptor_distance)
    fits &= landmarks.ids[: landmarks.size] >= 0
    wanted = np.full((len(z), CONFIG.candidates_per_observation), -1)
    for k, row in enumerate(fits):
        near = np.flatnonzero(row)
        near = near[np.argsort(distances[k, near], kind='stable')][: wanted.shape[1]]
        wanted[k, : len(near)] = near
    return wanted


@pytest.mark.parametrize('pose', [POSE, FAR_ALONG_X, FAR_ALONG_Y])
@pytest.mark.parametrize('seed', range(3))
def test_candidates_are_those_of_brute_force(seed, pose):
    """Landmarks of few kinds in a box; observations whose errors differ in every direction."""
    random = np.random.default_rng(seed)
    kinds = unit_rows(random, 3)
    positions = np.c_[random.uniform(-2, 5, (60, 2)) + pose[:2], random.uniform(-1.5, 3.0, 60)]
    positions[0] = to_world(pose, np.array([[2.0, 0.0, 0.5]]))[0]
    landmarks = map_of(positions, unit_rows(random, 60, kinds[np.arange(60) % 3], 0.02))
    landmarks.remove(np.array([7, 31]))
    count = 25
    z = np.c_[random.uniform(0.5, 4, count), random.uniform(-2, 2, count)]
    z = np.c_[z, random.uniform(-1.5, 3.0, count)]
    z[0] = [2.1, 0.1, 0.4]
    covariances = np.array([np.diag(random.uniform(0.0, 0.1, 3)) for _ in range(count)])
    vectors = unit_rows(random, count, kinds[np.arange(count) % 3], 0.02)
    observations = LandmarkObservations(0.0, z, covariances, vectors)
    found = find_candidates(landmarks, observations, CONFIG, pose, COVARIANCE, 0.0)
    distances = 2.0 - 2.0 * vectors @ landmarks.index.vectors(np.arange(60)).T
    wanted = expected(landmarks, observations, distances, pose)
    entries = np.where(found.candidates >= 0, found.entries[found.candidates], -1)
    np.testing.assert_array_equal(entries, wanted)
    assert (wanted >= 0).sum() > 20
    assert 0 in wanted  # the first landmark has the id 0
    ids = np.where(wanted >= 0, landmarks.ids[wanted], -1)
    np.testing.assert_array_equal(found.similar_ids[:, : wanted.shape[1]], ids)
    used = wanted >= 0
    at = np.nonzero(used)
    np.testing.assert_allclose(found.distances[used], distances[at[0], wanted[used]], atol=1e-5)


def test_an_empty_map_has_no_candidates():
    landmarks = map_of(np.empty((0, 3)), np.empty((0, 128), np.float32))
    random = np.random.default_rng(0)
    observations = LandmarkObservations(
        0.0, np.ones((2, 3)), np.tile(np.eye(3), (2, 1, 1)), unit_rows(random, 2)
    )
    found = find_candidates(landmarks, observations, CONFIG, POSE, COVARIANCE, 1.0)
    assert (found.candidates == -1).all()
    assert len(found.entries) == 0
    assert not found.is_distinctive.any()


def test_landmarks_far_away_are_noted_up_to_the_distance_asked_for():
    random = np.random.default_rng(1)
    kinds = unit_rows(random, 3)
    at = to_world(POSE, np.array([[1.0, 0.0, 0.0], [1.0, 3.0, 0.0], [1.0, 9.0, 0.0]]))
    landmarks = map_of(at, kinds)
    observations = LandmarkObservations(
        0.0, np.array([[1.0, 0.0, 0.0]] * 3), np.tile(1e-4 * np.eye(3), (3, 1, 1)), kinds
    )
    found = find_candidates(landmarks, observations, CONFIG, POSE, COVARIANCE, 5.0)
    assert found.candidates[:, 0].tolist() == [0, -1, -1]
    assert found.has_similar().tolist() == [True, True, False]


def test_hidden_landmarks_are_no_candidates_near_or_far():
    random = np.random.default_rng(2)
    kinds = unit_rows(random, 2)
    at = to_world(POSE, np.array([[1.0, 4.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.1, 0.0]]))
    landmarks = map_of(at, kinds[[0, 0, 1]])
    observations = LandmarkObservations(
        0.0, np.array([[1.0, 0.0, 0.0]] * 2), np.tile(1e-4 * np.eye(3), (2, 1, 1)), kinds
    )

    def found(*hidden):
        mask = np.isin(np.arange(3), hidden)
        made = find_candidates(landmarks, observations, CONFIG, POSE, COVARIANCE, 9.0, mask)
        return made.entries.tolist(), made.has_similar().tolist()

    assert found() == ([1, 2], [True, True])
    assert found(1) == ([2], [True, True])  # the first landmark, far away, is similar
    assert found(0, 1) == ([2], [False, True])
    assert found(0, 1, 2) == ([], [False, False])
