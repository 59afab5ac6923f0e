"""The registry of feature detectors: another one needs its own module and one line."""

import cv2
import numpy as np
import pytest

from explore_slam.data import Intrinsics, RgbdFrame
from explore_slam.errors import ConfigError
from explore_slam.slam.descriptors.kinds import KINDS
from explore_slam.vision import DETECTORS, FeatureExtractor, Features, VisionConfig
from explore_slam.vision.sections import FeatureConfig


class Orb:
    """ORB of OpenCV: binary descriptors of 32 bytes."""

    def __init__(self, config):
        self._orb = cv2.ORB_create(nfeatures=5 * config.feature_budget)

    def find(self, grey, mask):
        found = self._orb.detect(grey, None if mask is None else mask.astype(np.uint8))
        return sorted(found, key=lambda k: (*k.pt, k.size))

    def describe(self, grey, keypoints):
        described, descriptors = self._orb.compute(grey, keypoints)
        table = np.array([(*k.pt, k.size, k.response) for k in described])
        return Features(table[:, :2], table[:, 2], table[:, 3], descriptors)


def frame():
    rng = np.random.default_rng(0)
    image = cv2.GaussianBlur(rng.standard_normal((240, 320)), (0, 0), 2)
    image = ((image - image.min()) / np.ptp(image) * 255).astype(np.uint8)
    camera = Intrinsics(320, 240, 260.0, 262.0, 158.0, 121.0)
    return RgbdFrame(0.0, image, np.full((240, 320), 2.0, np.float32), camera)


def test_the_setting_offers_what_is_registered():
    assert 'sift' in DETECTORS
    with pytest.raises(ConfigError, match='feature_detector'):
        VisionConfig(feature_detector='surf')


def test_a_registered_detector_is_used_and_fits_a_descriptor_kind_of_the_filter(monkeypatch):
    sift = FeatureExtractor(VisionConfig()).extract(frame())
    monkeypatch.setitem(DETECTORS, 'sift', Orb)
    orb = FeatureExtractor(VisionConfig()).extract(frame())
    assert len(orb) > 50
    np.testing.assert_allclose(orb.positions[:, 0], sift.positions[0, 0], rtol=1e-6)
    KINDS['orb'].check(orb.descriptors)
    KINDS['sift'].check(sift.descriptors)


def test_features_are_found_in_the_mask_only_and_in_a_fixed_order():
    detector = DETECTORS['sift'](FeatureConfig())
    grey = frame().rgb
    mask = np.zeros(grey.shape, bool)
    mask[:, :100] = True
    pixels = [k.pt for k in detector.find(grey, mask)]
    assert len(pixels) > 10
    assert max(u for u, _ in pixels) < 100.5
    assert pixels == sorted(pixels)


@pytest.mark.parametrize('name', DETECTORS)
@pytest.mark.parametrize('axis', [0, 1])
def test_pixels_are_where_the_texture_is_and_not_displaced(name, axis):
    """The features of a mirrored image must be the mirror images of the features."""
    detector = DETECTORS[name](FeatureConfig())
    grey = frame().rgb
    last = grey.shape[::-1][axis] - 1

    def pixels(image):
        return detector.describe(image, detector.find(image, None)).pixels

    plain, mirrored = pixels(grey), pixels(np.ascontiguousarray(np.flip(grey, 1 - axis)))
    mirrored[:, axis] = last - mirrored[:, axis]
    apart = np.linalg.norm(plain[:, None] - mirrored, axis=2)
    same = apart.min(axis=1) < 1.5
    assert np.count_nonzero(same) > 0.7 * len(plain)
    off = plain[same, axis] - mirrored[apart.argmin(axis=1)[same], axis]
    assert abs(np.median(off)) / 2 < 0.05
