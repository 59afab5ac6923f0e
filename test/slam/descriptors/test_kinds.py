"""Kinds of descriptors: floats of any length and bits, through the whole filter."""

import numpy as np
import pytest

from explore_slam.data import LandmarkObservations
from explore_slam.errors import ConfigError, SlamError
from explore_slam.geometry import Pose2
from explore_slam.settings import with_values
from explore_slam.slam import FastSlam, FastSlamConfig
from explore_slam.slam.descriptors.kinds import KINDS, ORB, DescriptorKind

FLOATS = DescriptorKind('floats64', 64, 'euclidean', same=0.02, ratio=0.64)
STILL = Pose2(0.0, 0.0, 0.0)
STEP = Pose2(0.2, 0.0, 0.1)
NOISE = np.diag([0.01, 0.005, 0.01]) ** 2


@pytest.fixture(autouse=True)
def floats64(monkeypatch):
    monkeypatch.setitem(KINDS, FLOATS.name, FLOATS)


def unit(rows):
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


def drawn(kind, random, count):
    """Return descriptors of random landmarks."""
    if kind.metric == 'hamming':
        return random.integers(0, 256, (count, kind.length), dtype=np.uint8)
    return unit(random.standard_normal((count, kind.length)))


def seen_again(kind, random, descriptors):
    """Return descriptors as other views of the same landmarks have them."""
    if kind.metric == 'hamming':
        flips = random.random((len(descriptors), 8 * kind.length)) < 0.05
        return descriptors ^ np.packbits(flips, axis=1)
    deviation = 0.3 / np.sqrt(kind.length)
    return unit(descriptors + deviation * random.standard_normal(descriptors.shape))


@pytest.mark.parametrize('index', ['forest', 'kd_tree', 'brute_force'])
@pytest.mark.parametrize('name', ['sift', 'orb', 'superpoint', 'floats64'])
def test_a_vehicle_maps_and_localizes_with_any_kind(name, index, tmp_path):
    random = np.random.default_rng(3)
    kind = KINDS[name]
    points = np.c_[random.uniform(-3, 3, (40, 2)), random.uniform(0, 1, 40)]
    descriptors = drawn(kind, random, 40)
    values = {'descriptor_kind': name, 'descriptor_index': index, 'particles': 100}
    if kind.metric == 'hamming':
        values['maximum_descriptor_distance'] = 0.8  # 51 of 256 bits
    slam = FastSlam({'a': STILL}, with_values(FastSlamConfig(), values), seed=1)
    true = STILL
    for step in range(20):
        noise = NOISE if step else np.zeros((3, 3))
        moved = np.asarray(STEP) + random.standard_normal(3) * np.sqrt(np.diag(noise))
        true = true.compose(Pose2(*moved))
        local = np.array([true.inverse().compose(Pose2(x, y, 0.0))[:2] for x, y, _ in points])
        positions = np.c_[local, points[:, 2]] + 0.01 * random.standard_normal((40, 3))
        covariances = np.tile(1e-4 * np.eye(3), (40, 1, 1))
        slam.predict('a', STEP, noise)
        slam.update(
            'a',
            LandmarkObservations(
                float(step), positions, covariances, seen_again(kind, random, descriptors)
            ),
        )
    pose = slam.estimate('a')[0]
    assert np.hypot(pose.x - true.x, pose.y - true.y) < 0.05
    landmarks = slam.landmarks()
    assert len(landmarks) == 40
    assert landmarks.descriptors.dtype == descriptors.dtype
    assert landmarks.descriptors.shape == descriptors.shape
    slam.save(tmp_path / 'slam.npz')
    again = FastSlam.load(tmp_path / 'slam.npz').landmarks()
    np.testing.assert_array_equal(again.descriptors, landmarks.descriptors)


def test_bits_survive_and_their_distance_counts_the_differing_ones():
    random = np.random.default_rng(0)
    bits = drawn(ORB, random, 5)
    vectors = ORB.vectors(bits)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1.0, atol=1e-6)
    np.testing.assert_array_equal(ORB.descriptors(vectors), bits)
    hamming = np.unpackbits(bits[0] ^ bits[1]).sum()
    squared = ((vectors[0] - vectors[1]) ** 2).sum()
    assert squared == pytest.approx(4.0 * hamming / 256, rel=1e-5)


def observations(descriptors):
    count = len(descriptors)
    return LandmarkObservations(
        0.0, np.ones((count, 3)), np.tile(np.eye(3), (count, 1, 1)), descriptors
    )


@pytest.mark.parametrize(
    ('name', 'descriptors', 'message'),
    [
        (
            'sift',
            np.eye(3, 64, dtype=np.float32),
            r'float32 \(K, 64\), expected float32 \(K, 128\)',
        ),
        ('sift', np.eye(3, 128, dtype=np.uint8), 'uint8 .* expected float32'),
        ('orb', np.eye(3, 32, dtype=np.float32), r'expected uint8 \(K, 32\) of kind orb'),
        ('floats64', 2.0 * np.eye(3, 64, dtype=np.float32), 'descriptor 0 has length 2'),
    ],
)
def test_descriptors_of_another_kind_are_rejected(name, descriptors, message):
    config = with_values(FastSlamConfig(), {'descriptor_kind': name, 'particles': 5})
    slam = FastSlam({'a': STILL}, config)
    slam.predict('a', STILL, NOISE)
    with pytest.raises(SlamError, match=message):
        slam.update('a', observations(descriptors))


def test_unknown_and_impossible_kinds_are_named():
    with pytest.raises(ConfigError, match="descriptor_kind is 'surf', expected one of"):
        with_values(FastSlamConfig(), {'descriptor_kind': 'surf'})
    with pytest.raises(ConfigError, match='488 dimensions'):
        DescriptorKind('akaze', 61, 'hamming', same=0.1, ratio=0.75)
    with pytest.raises(ConfigError, match=r'ratio 1\.5'):
        DescriptorKind('bad', 64, 'euclidean', same=0.1, ratio=1.5)
