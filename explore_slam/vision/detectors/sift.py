"""SIFT features (D. Lowe, "Distinctive image features from scale-invariant keypoints", 2004)."""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from explore_slam.data import DESCRIPTOR_LENGTH
from explore_slam.vision.detectors.detector import Features, Keypoint
from explore_slam.vision.sections import FeatureConfig

_OCTAVE_LAYERS = 3  # per octave of the scale space (Lowe, 2004, section 3.2)
_SMALLEST = np.float32(1e-12)  # divisor in place of 0
_UNIT_LENGTH = 0.5  # descriptors of textureless patches have length 0, all others 1
# px, in x and y, by which OpenCV places every keypoint too far to the right and down: it doubles
# the image to a scale space in which pixel x lies at 2 x + 0.5, and halves the coordinates again.
# Versions that can avoid it (`enable_precise_upscale`) do so on request only.
_OFFSET = 0.25


class Sift:
    """SIFT of OpenCV, with a fixed order of keypoints and descriptors of unit length."""

    def __init__(self, config: FeatureConfig) -> None:
        self._config = config
        # its type stub comes and goes with the version of OpenCV
        create: Any = vars(cv2)['SIFT_create']
        # 0 features: with a limit OpenCV would keep the strongest of the image, whatever their
        # depth
        self._sift = create(
            0, _OCTAVE_LAYERS, config.sift_contrast_threshold, config.sift_edge_threshold
        )

    def find(self, grey: NDArray[np.uint8], mask: NDArray[np.bool_] | None) -> Sequence[Keypoint]:
        """See Detector.find; the orientations are those of the settings."""
        config = self._config
        found = self._sift.detect(grey, None if mask is None else mask.astype(np.uint8))
        for keypoint in found:
            keypoint.pt = (keypoint.pt[0] - _OFFSET, keypoint.pt[1] - _OFFSET)
            if config.feature_orientation == 'upright':
                keypoint.angle = 0.0
        ordered: list[Any] = sorted(
            (k for k in found if k.size >= config.minimum_feature_size),
            key=lambda k: (*k.pt, k.size, k.angle, k.response),
        )
        if config.feature_orientation == 'all':
            return ordered
        # of several orientations at one place, keep the first
        return list({(k.pt, k.size): k for k in reversed(ordered)}.values())[::-1]

    def describe(self, grey: NDArray[np.uint8], keypoints: Sequence[Keypoint]) -> Features:
        """See Detector.describe."""
        # as OpenCV knows them
        found: Sequence[Any] = keypoints
        shifted = [
            cv2.KeyPoint(
                k.pt[0] + _OFFSET, k.pt[1] + _OFFSET, k.size, k.angle, k.response, k.octave
            )
            for k in found
        ]
        described, raw = self._sift.compute(grey, shifted) if shifted else ((), None)
        if raw is None or not len(described):
            none = np.empty(0)
            return Features(
                np.empty((0, 2)), none, none, np.empty((0, DESCRIPTOR_LENGTH), np.float32)
            )
        table = np.array([(*k.pt, k.size, k.response) for k in described])
        unit = normalise(raw, root=self._config.root_sift)
        textured = np.linalg.norm(unit, axis=1) > _UNIT_LENGTH
        pixels = table[:, :2] - _OFFSET
        return Features(pixels, table[:, 2], table[:, 3], unit).take(textured)


def normalise(descriptors: NDArray[np.float32], *, root: bool) -> NDArray[np.float32]:
    """Return descriptors (K, 128) of unit length.

    root: of RootSIFT (R. Arandjelović and A. Zisserman, "Three things everyone should know to
    improve object retrieval", CVPR 2012).
    """
    raw = np.asarray(descriptors, dtype=np.float32)
    if root:
        sums = np.abs(raw).sum(axis=1, keepdims=True)
        raw = np.sqrt(np.abs(raw) / np.maximum(sums, _SMALLEST), dtype=np.float32)
    lengths = np.linalg.norm(raw, axis=1, keepdims=True)
    return (raw / np.maximum(lengths, _SMALLEST)).astype(np.float32)
