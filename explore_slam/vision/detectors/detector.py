"""What a feature detector finds, and what it offers."""

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array


class Features(NamedTuple):
    """Features of one image: pixels (K, 2) (u, v), sizes (K,) px, responses (K,), descriptors."""

    pixels: Array
    sizes: Array
    responses: Array
    descriptors: NDArray[Any]

    def take(self, rows: NDArray[Any]) -> 'Features':
        """Return the features of the given rows or mask."""
        return Features(*(column[rows] for column in self))


class Keypoint(Protocol):
    """A place in an image: cv2.KeyPoint."""

    @property
    def pt(self) -> tuple[float, float]:
        """Pixel (u, v)."""

    @property
    def size(self) -> float:
        """Diameter (pixels)."""

    @property
    def response(self) -> float:
        """Strength."""


class Detector(Protocol):
    """Finds features in grey images (H, W); the results depend on the image alone."""

    def find(self, grey: NDArray[np.uint8], mask: NDArray[np.bool_] | None) -> Sequence[Keypoint]:
        """Return the keypoints within a mask (H, W), in a fixed order."""

    def describe(self, grey: NDArray[np.uint8], keypoints: Sequence[Keypoint]) -> Features:
        """Return the features of keypoints in their order; those without texture are left out."""
